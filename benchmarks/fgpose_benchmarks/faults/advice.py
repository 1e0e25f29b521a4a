"""Following an advice as a user would, where it changes the calibration, the keypoints or the options."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from fgpose.association.common_clock import on_common_clock
from fgpose.calibration.changes.lenses import distortion_of
from fgpose.calibration.self_calibration import calibrate_cameras
from fgpose.diagnosis.body.sides import LIMBS
from fgpose.finding import Code, Finding
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.intrinsics import stretched, zoomed
from fgpose_benchmarks.faults.damage import Damaged, with_points, with_sides_exchanged


def followed(given: Damaged, finding: Finding) -> Damaged | None:
    """The recording after the remedy of a finding; None if it cannot be followed on what was recorded."""
    action = _ACTIONS.get(finding.code)
    if action is None:
        return None
    try:
        return action(given, finding)
    except ValueError:  # refused, and said why
        return None


def _refined(given: Damaged, finding: Finding) -> Damaged | None:
    found = calibrate_cameras(given.observations, given.rig, poses=True, clocks=False)
    return replace(given, rig=found.rig, observations=found.observations)


def _with_clocks(given: Damaged, finding: Finding) -> Damaged | None:
    found = calibrate_cameras(given.observations, given.rig, poses=False, clocks=True)
    return replace(given, rig=found.rig, observations=found.observations)


def _at_its_rate(given: Damaged, finding: Finding) -> Damaged | None:
    """With the clock_drift that is named; drifts of a few per cent are found by the option."""
    if "clock_drift" not in finding.numbers:
        return _with_clocks(given, finding)
    drift = finding.numbers["clock_drift"]
    cameras = [replace(each, clock_drift=drift) if each.name == finding.camera else each for each in given.rig.cameras]
    observations, rig = on_common_clock(given.observations, CameraRig(tuple(cameras)))
    return replace(given, rig=rig, observations=observations)


def _left_out(given: Damaged, finding: Finding) -> Damaged | None:
    kept = [name for name in given.rig.names if name != finding.camera]
    if not finding.camera or len(kept) < 2:
        return None
    return replace(given, rig=given.rig.subset(kept), observations=given.observations.subset(kept))


def _without_its_images(given: Damaged, finding: Finding) -> Damaged | None:
    """Of the time that is named; None if one camera is left then."""
    if given.rig.n_cameras < 3:
        return None
    assert finding.from_s is not None
    assert finding.to_s is not None
    time_s = given.observations.frame_time_s
    named = (time_s >= finding.from_s) & (time_s <= finding.to_s)
    points = given.observations.points2d_px.copy()
    points[named, given.rig.names.index(finding.camera)] = np.nan
    return replace(given, observations=with_points(given.observations, points))


def _exchanged_back(given: Damaged, finding: Finding) -> Damaged | None:
    """Left and right, of arms or legs if these are named; None where it is not said in which camera."""
    if not finding.camera:
        return None
    camera = given.rig.names.index(finding.camera)
    joints = LIMBS.get(finding.joint, ())
    return replace(given, observations=with_sides_exchanged(given.observations, camera, joints))


def _with_its_lens(given: Damaged, finding: Finding) -> Damaged | None:
    """With the focal lengths or the distortion that are named."""
    named = [(change, finding.numbers[name]) for name, change in _OF_LENS.items() if name in finding.numbers]
    if not named:
        return None
    change, number = named[0]
    cameras = [change(each, number) if finding.camera in ("", each.name) else each for each in given.rig.cameras]
    return replace(given, rig=CameraRig(tuple(cameras)))


_OF_LENS: Mapping[str, Callable[[Camera, float], Camera]] = {
    "focal_factor": zoomed,
    "fx_factor": partial(stretched, axis=0),
    "fy_factor": partial(stretched, axis=1),
    "k1": lambda camera, k1: replace(camera, distortion=distortion_of(k1)),
    "distortion_factor": lambda camera, factor: replace(camera, distortion=factor * camera.distortion),
}


def _in_metres(given: Damaged, finding: Finding) -> Damaged | None:
    if finding.numbers["factor_sigma"] > 0:  # a length has to be measured in the room
        return None
    factor = finding.numbers["factor"]
    cameras = []
    for camera in given.rig.cameras:
        pose = camera.world_T_camera.copy()
        pose[:3, 3] *= factor
        cameras.append(replace(camera, world_T_camera=pose))
    return replace(given, rig=CameraRig(tuple(cameras)))


_ACTIONS: Mapping[Code, Callable[[Damaged, Finding], Damaged | None]] = {
    Code.MOVED_CAMERA: _refined,
    Code.BUMPED_CAMERA: _refined,
    Code.LATE_CAMERA: _with_clocks,
    Code.LOST_FRAMES: _with_clocks,
    Code.CLOCK_RATE: _at_its_rate,
    Code.WRONG_CAMERA: _left_out,
    Code.WRONG_LENS: _with_its_lens,
    Code.OTHER_PERSON: _left_out,
    Code.EXCHANGED_SIDES: _exchanged_back,
    Code.FROZEN_CAMERA: _without_its_images,
    Code.HALLUCINATING_CAMERA: _left_out,
    Code.UNIT: _in_metres,
}
"""By code; of the others the advice is to record or to detect again."""
