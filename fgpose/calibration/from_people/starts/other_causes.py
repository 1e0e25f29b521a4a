"""Why a camera fits the others at no moment: what of it would have to be otherwise for it to fit at one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fgpose.calibration.from_people.body_size import INLIER_SHARE
from fgpose.calibration.from_people.calibrated import CalibrationFinding, Grade
from fgpose.calibration.from_people.rig.resection import resect
from fgpose.calibration.from_people.starts.joining import Joining
from fgpose.calibration.from_people.starts.views import View
from fgpose.calibration.from_people.tracks import no_track
from fgpose.calibration.from_people.walk import Track
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate
from fgpose.sampling import spread_evenly
from fgpose.skeleton import Skeleton

# Images a second of cameras, over those that a file may state instead.
_RATES = (25 / 30, 30 / 25, 24 / 30, 24 / 25, 25 / 24, 50 / 60, 60 / 50)
_FITS = "it fits the others at a moment"
_MAX_IMAGES, _LEAST_POINTS = 200, 30
_SEEN_BY = 2  # cameras: one other alone fits much
Join = Callable[[Sequence[Track], CameraRig], Joining]
"""Find the starts of tracks of all cameras, some of which are known; of a camera without images there is none."""


@dataclass(frozen=True, eq=False)
class _Cause:
    """A track as it would be without the cause."""

    track: Track
    reason: str
    remedy: str


def other_cause(
    camera: int,
    tracks: Sequence[Track],
    offsets_s: Mapping[int, float],
    rig: CameraRig,
    skeleton: Skeleton,
    join: Join,
    join_anywhere: Join | None = None,
) -> CalibrationFinding | None:
    """What is wrong of a camera that joins the others only if that is put right; None: nothing that is known, or there
    are not two others.

    Args:
        camera: its number.
        tracks: of all cameras.
        offsets_s: of those that have joined.
        rig: the cameras; their poses do not matter unless they are placed.
        skeleton: the joints.
        join: how starts are found.
        join_anywhere: the same of placed cameras, wherever they stand; None: they are not placed.
    """
    if len(offsets_s) < _SEEN_BY:
        return None
    known = [track if c in offsets_s else no_track(track.camera, skeleton) for c, track in enumerate(tracks)]
    for cause in _causes(camera, tracks, offsets_s, rig, skeleton):
        tried = [cause.track if c == camera else track for c, track in enumerate(known)]
        if camera in join(tried, rig).offsets_s:
            return CalibrationFinding(rig.names[camera], Grade.FAILED, cause.reason, cause.remedy)
    if join_anywhere is None:
        return None
    tried = [track if c == camera else known[c] for c, track in enumerate(tracks)]
    elsewhere = _placed_anew(camera, tried, join_anywhere(tried, rig).offsets_s, rig)
    if elsewhere is not None and camera in join(tried, elsewhere).offsets_s:
        reason = f"it seems to have been moved or turned since its calibration: with another pose, {_FITS}"
        return CalibrationFinding(rig.names[camera], Grade.FAILED, reason, "calibrate it again")
    return None


def _placed_anew(
    camera: int, tracks: Sequence[Track], offsets_s: Mapping[int, float], rig: CameraRig
) -> CameraRig | None:
    """The rig with a camera where it would have to be to see what the others do; None if it has no start, or no pose
    explains what it saw.

    Args:
        offsets_s: starts of the cameras that have one, with any pose of this camera.
    """
    if camera not in offsets_s:
        return None
    views = {c: View.of(tracks[c], rig.cameras[c], placed=True) for c in offsets_s}
    own, others = views[camera], [(offsets_s[c], view) for c, view in views.items() if c != camera]
    some = spread_evenly(len(own.time_s), _MAX_IMAGES)
    common_s = own.time_s[some] + offsets_s[camera]
    xy = np.stack([view.at(common_s - offset_s) for offset_s, view in others], axis=-2)
    matrices = np.stack([view.projection for _, view in others])
    joints_m = triangulate(xy, np.isfinite(xy).all(axis=-1).astype(float), matrices)
    known = np.isfinite(joints_m).all(axis=-1) & np.isfinite(own.xy[some]).all(axis=-1)
    inlier = INLIER_SHARE * float(np.median(own.radius))
    pose = resect(joints_m[known], own.xy[some][known], np.eye(3), inlier, max(int(known.sum()) // 2, _LEAST_POINTS))
    if pose is None:
        return None
    cameras = [replace(each, world_T_camera=pose) if c == camera else each for c, each in enumerate(rig.cameras)]
    return CameraRig(tuple(cameras))


def _causes(
    camera: int, tracks: Sequence[Track], offsets_s: Mapping[int, float], rig: CameraRig, skeleton: Skeleton
) -> Iterator[_Cause]:
    track, mirror, width_px = replace(tracks[camera], points3d_m=None), skeleton.mirror, rig.cameras[camera].size_px[0]
    mirrored_px = np.stack([width_px - 1 - track.points2d_px[..., 0], track.points2d_px[..., 1]], axis=-1)
    yield _Cause(
        replace(track, points2d_px=mirrored_px[:, mirror], confidence=track.confidence[:, mirror]),
        f"its picture seems to be mirrored: turned round, {_FITS}",
        "switch the mirroring of the camera off",
    )
    for rate in _RATES:
        yield _Cause(
            replace(track, time_s=track.time_s / rate),
            f"its frame rate seems to be {rate:.3g} of what its times say, or images were lost: with that, {_FITS}",
            "give the true frame rate, or the times of the images",
        )
    for other, own in enumerate(tracks):
        if other not in offsets_s and other != camera and len(own.time_s):
            yield _Cause(
                own,
                f"its images seem to be those of {rig.names[other]}: with those, {_FITS}",
                "are the files of two cameras exchanged?",
            )
