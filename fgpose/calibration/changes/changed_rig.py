"""The rig with the changes that were found in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fgpose.calibration.changes.change import Change, Kind, pieces
from fgpose.geometry.camera import Camera, CameraRig

# More than the calibration finds from the images that the frames put together (calibration.offset_sigma_s).
_FAR_APART_S = 0.1


def with_changes(rig: CameraRig, changes: Sequence[Change], *, poses: bool, clocks: bool) -> CameraRig:
    """What changes in time: with poses the bumps, with clocks jumps and rates; and of the cameras that they concern
    what was different all the time. The others stay as they are: a constant fault is for the calibration to find,
    unless a clock is so late that its images have to be put together with others first.

    Args:
        rig: with constant clocks and poses.
    """
    kept: list[Change] = []
    for wanted, in_time in ((poses, (Kind.BUMP,)), (clocks, (Kind.JUMP, Kind.RATE))):
        of_clock = Kind.JUMP in in_time
        concerned = {each.camera for each in changes if each.kind in in_time or (of_clock and _is_far_apart(each))}
        kept += [each for each in changes if wanted and each.camera in concerned and each.is_of_clock == of_clock]
    return CameraRig(tuple(_changed(camera, c, kept) for c, camera in enumerate(rig.cameras)))


def _is_far_apart(change: Change) -> bool:
    return change.kind is Kind.OFFSET and abs(change.offset_s) > _FAR_APART_S


def _changed(camera: Camera, c: int, changes: Sequence[Change]) -> Camera:
    own = [each for each in changes if each.camera == c]
    of_clock = [each for each in own if each.is_of_clock]
    first, *later = pieces(own, c, camera)
    return replace(
        camera,
        world_T_camera=first[2],
        moves=tuple((since_s, pose) for since_s, _, pose in later),
        time_offset_s=camera.time_offset_s + sum(each.offset_s for each in of_clock if not np.isfinite(each.at_s)),
        clock_drift=sum((each.rate for each in of_clock), 0.0),
        clock_jumps=tuple(sorted((each.at_s, each.offset_s) for each in of_clock if np.isfinite(each.at_s))),
    )
