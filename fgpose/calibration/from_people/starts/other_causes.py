"""Why a camera fits the others at no moment: what of it would have to be otherwise for it to fit at one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fgpose.calibration.from_people.calibrated import CalibrationFinding, Grade
from fgpose.calibration.from_people.starts.joining import Joining
from fgpose.calibration.from_people.tracks import no_track
from fgpose.calibration.from_people.walk import Track
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton

# Images a second of cameras, over those that a file may state instead.
_RATES = (25 / 30, 30 / 25, 24 / 30, 24 / 25, 25 / 24, 50 / 60, 60 / 50)
_SEEN_BY = 2  # cameras: one other alone fits much
Join = Callable[[Sequence[Track]], Joining]
"""Find the starts of tracks of all cameras, some of which are known; of a camera without images there is none."""


@dataclass(frozen=True, eq=False)
class _Cause:
    """A track as it would be without the cause."""

    track: Track
    reason: str
    remedy: str


def other_cause(
    camera: int, tracks: Sequence[Track], offsets_s: Mapping[int, float], rig: CameraRig, skeleton: Skeleton, join: Join
) -> CalibrationFinding | None:
    """What is wrong of a camera that joins the others only if that is put right; None: nothing that is known, or there
    are not two others.

    Args:
        camera: its number.
        tracks: of all cameras.
        offsets_s: of those that have joined.
        rig: the cameras; their poses do not matter.
        skeleton: the joints.
        join: how starts are found.
    """
    if len(offsets_s) < _SEEN_BY:
        return None
    known = [track if c in offsets_s else no_track(track.camera, skeleton) for c, track in enumerate(tracks)]
    for cause in _causes(camera, tracks, offsets_s, rig, skeleton):
        tried = [cause.track if c == camera else track for c, track in enumerate(known)]
        if camera in join(tried).offsets_s:
            return CalibrationFinding(rig.names[camera], Grade.FAILED, cause.reason, cause.remedy)
    return None


def _causes(
    camera: int, tracks: Sequence[Track], offsets_s: Mapping[int, float], rig: CameraRig, skeleton: Skeleton
) -> Iterator[_Cause]:
    track, mirror, width_px = replace(tracks[camera], points3d_m=None), skeleton.mirror, rig.cameras[camera].size_px[0]
    mirrored_px = np.stack([width_px - 1 - track.points2d_px[..., 0], track.points2d_px[..., 1]], axis=-1)
    fits = "it fits the other cameras at a moment"
    yield _Cause(
        replace(track, points2d_px=mirrored_px[:, mirror], confidence=track.confidence[:, mirror]),
        f"its picture seems to be mirrored: turned round, {fits}",
        "switch the mirroring of the camera off",
    )
    for rate in _RATES:
        yield _Cause(
            replace(track, time_s=track.time_s / rate),
            f"its frame rate seems to be {rate:.3g} of what its times say, or images were lost: with that rate, {fits}",
            "give the true frame rate, or the times of the images",
        )
    for other, own in enumerate(tracks):
        if other not in offsets_s and other != camera and len(own.time_s):
            yield _Cause(
                own,
                f"its images seem to be those of {rig.names[other]}: with those, {fits}",
                "are the files of two cameras exchanged?",
            )
