"""The detections in the recording of a live system."""

from __future__ import annotations

from pathlib import Path

from fgpose.geometry.camera import CameraRig
from fgpose.io.calibration.live_format import is_live as is_live
from fgpose.io.live.recordings import LiveRecordingFile
from fgpose.io.names import match_cameras
from fgpose.people_observations import Detections, PeopleObservations
from fgpose.plain_files import naming
from fgpose.skeleton import Skeleton


def camera_names(path: Path) -> tuple[str, ...]:
    """The cameras of a recording. Raises ValueError, which names the file, if it is damaged."""
    return LiveRecordingFile(path).start.camera_names


def read(path: Path, rig: CameraRig, skeleton: Skeleton) -> PeopleObservations:
    """Everybody who was detected, those also who were not used for the live estimate. Times count from the beginning
    of the recording. Of images of a camera that have one time only the first is taken.

    Raises:
        ValueError: the file is damaged, of another skeleton or other cameras; the message names the file.

    Warns:
        UserWarning: the recording is not complete, see LiveRecordingFile.
    """
    recording = LiveRecordingFile(path)
    start = recording.start
    with naming(path):
        if start.skeleton.joints != skeleton.joints:
            raise ValueError(
                f"its joints are not those of skeleton {skeleton.name} but those of {start.skeleton.name}: "
                f"{', '.join(start.skeleton.joints)}"
            )
        called = {theirs: ours for ours, theirs in match_cameras(start.camera_names, rig.names).items()}
    images: dict[tuple[str, float], Detections] = {}
    for update in recording.updates():
        for image in update:
            seen = image.detections
            if seen.camera not in called:
                raise ValueError(f"{path}: {seen}: the recording has no such camera")
            ours = _called(seen, called[seen.camera], seen.time_s - start.started_s)
            images.setdefault((ours.camera, ours.time_s), ours)
    with naming(path):
        return PeopleObservations(skeleton, rig.names, tuple(images.values()))


def _called(seen: Detections, camera: str, time_s: float) -> Detections:
    in_3d = seen.points3d_m, seen.covariance3d_m2
    return Detections(camera, time_s, seen.points2d_px, seen.confidence, *in_3d, seen.appearance)
