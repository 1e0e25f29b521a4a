"""Reading of keypoints of any format into Observations."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from fgpose.association.people import track_people
from fgpose.association.person import NOBODY
from fgpose.geometry.camera import CameraRig
from fgpose.io.camera_names import match_cameras, natural_key
from fgpose.io.keypoints import camera_files, image_files, recording_files
from fgpose.io.keypoints.detections import CameraDetections
from fgpose.io.skeletons import load_skeleton
from fgpose.observations import Observations
from fgpose.skeleton import Skeleton

Points3dFrame = Literal["camera", "world"]
Points3dUnit = Literal["mm", "m"]
Person = Literal["consistent"] | int

_METRES = {"mm": 1e-3, "m": 1.0}
# No camera is faster, nobody's motion can be followed with one that is slower.
_MIN_FPS, _MAX_FPS = 1e-3, 1e5
# Numbers with larger gaps than this between the images are not frame numbers.
_MAX_FRAMES_PER_IMAGE = 1000


def load_observations(
    path: str | Path,
    rig: CameraRig,
    skeleton: str | Path | Skeleton,
    *,
    fps: float | None = None,
    person: Person = "consistent",
    points3d_frame: Points3dFrame = "camera",
    points3d_unit: Points3dUnit = "mm",
) -> Observations:
    """The keypoints of a recording; the format is recognised by its content.

    - A folder with one sub-folder per camera (``cam01_json`` or ``cam01``) and in it one JSON file per image, of
      OpenPose or MMPose; the frame number is the last number in the file name.
    - A folder with one file per camera (``cam01.json``), of MMPose, COCO results or MeTRAbs (JSON or npz).
    - A recording written by save_observations, npz or parquet.

    A frame that one camera lacks was not seen by it; where the numbers leave out a frame in all cameras, nobody saw it.
    Camera names are compared without case, underscores, hyphens and ``_json``.

    Args:
        path: the folder or file.
        rig: the cameras; the result has them in this order.
        skeleton: what the keypoints are: a built-in skeleton, a TOML file or a Skeleton.
        fps: frames per second; needed for every format but our own, whose files contain times. Frame n is at n / fps.
        person: of several people in an image, consistent takes the one that views and frames agree on; a number takes
            that entry of every image.
        points3d_frame: frame of the 3D joints of MeTRAbs: of each camera, or of the world if it was given extrinsics.
        points3d_unit: their unit.

    Raises:
        ValueError: a file is damaged or of no known format, formats are mixed, the keypoints do not fit the skeleton,
            cameras of rig and keypoints differ, a confidence is outside [0, 1], fps is missing. The message names
            file, camera, joint and frame.
        OSError: a file cannot be read.
    """
    path = Path(path)
    if not isinstance(skeleton, Skeleton):
        skeleton = load_skeleton(skeleton)
    _check_options(path, fps, person, points3d_frame, points3d_unit)
    if recording_files.is_recording(path):
        return recording_files.read(path, rig, skeleton)
    cameras = _read_cameras(path, skeleton)
    try:
        matched = match_cameras(cameras, rig.names)
        if fps is None:
            raise ValueError("these keypoints have no times; give the frames per second (fps, or --fps)")
        detections = _stack([cameras[matched[name]] for name in rig.names], rig, skeleton)
        return _observations(detections, rig, skeleton, fps, person, points3d_frame, points3d_unit)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def keypoint_cameras(path: str | Path) -> tuple[str, ...]:
    """The cameras of keypoints of any format that load_observations reads, by the names they have there.

    Raises:
        ValueError: the file is damaged or the folder has no keypoints; the message names it.
        OSError: it cannot be read.
    """
    path = Path(path)
    return recording_files.camera_names(path) if recording_files.is_recording(path) else tuple(_sources(path))


def _check_options(path: Path, fps: float | None, person: Person, frame: str, unit: str) -> None:
    if fps is not None and not (_MIN_FPS <= fps <= _MAX_FPS):
        raise ValueError(f"{path}: fps must be a number from {_MIN_FPS:g} to {_MAX_FPS:g}, got {fps:g}")
    if person != "consistent" and (not isinstance(person, int) or person < 0):
        raise ValueError(f"{path}: person must be consistent or an index from 0, got {person!r}")
    if frame not in ("camera", "world") or unit not in _METRES:
        raise ValueError(
            f"{path}: points3d_frame is camera or world and points3d_unit mm or m, got {frame!r} and {unit!r}"
        )


def _read_cameras(path: Path, skeleton: Skeleton) -> dict[str, CameraDetections]:
    """Everything detected by each camera, by the names of the keypoints, in natural order."""
    cameras: dict[str, CameraDetections] = {}
    formats: dict[str, str] = {}
    for name, source in _sources(path).items():
        reader = image_files if source.is_dir() else camera_files
        cameras[name], format_name = reader.read(source, name, skeleton)
        if format_name:
            formats[name] = format_name
    if len(set(formats.values())) > 1:
        mixture = ", ".join(f"{name}: {format_name}" for name, format_name in formats.items())
        raise ValueError(f"{path}: a mixture of formats ({mixture})")
    return cameras


def _sources(path: Path) -> dict[str, Path]:
    """By camera, in natural order: folders of image files, or files of a whole camera."""
    if not path.is_dir():
        return {path.stem: path}
    folders = [folder for folder in path.iterdir() if folder.is_dir() and any(folder.glob("*.json"))]
    files = [file for file in path.iterdir() if file.is_file() and file.suffix in (".json", ".npz")]
    if folders and files:
        raise ValueError(
            f"{path}: a mixture of files of a whole camera ({min(files).name}) and folders with one file per image "
            f"({min(folders).name})"
        )
    if not folders and not files:
        raise ValueError(
            f"{path}: no keypoints; expected one folder of JSON files per camera, or one JSON or npz file per camera"
        )
    sources: dict[str, Path] = {}
    for source in sorted(folders + files, key=lambda source: natural_key(source.name)):
        name = source.name if source in folders else source.stem
        if name in sources:
            raise ValueError(f"{source}: camera {name} has a second file beside it")
        sources[name] = source
    return sources


@dataclass(frozen=True)
class _Stack:
    """Everybody in every image: T frames, C cameras, at most P people, J joints."""

    frames: np.ndarray
    """(T,) frame numbers."""
    points2d_px: np.ndarray
    """(T, C, P, J, 2)"""
    confidence: np.ndarray
    """(T, C, P, J)"""
    points3d: np.ndarray | None
    """(T, C, P, J, 3) in the unit and frame of the files."""


def _stack(cameras: list[CameraDetections], rig: CameraRig, skeleton: Skeleton) -> _Stack:
    frames = _frame_numbers(cameras, rig)
    position = {int(frame): t for t, frame in enumerate(frames)}
    images = [image for camera in cameras for image in camera.values()]
    n_people = max(1, *(len(image.confidence) for image in images))
    shape = (len(frames), len(cameras), n_people, skeleton.n_joints)
    points2d_px, confidence = np.full((*shape, 2), np.nan), np.zeros(shape)
    has_3d = any(image.points3d is not None for image in images)
    points3d = np.full((*shape, 3), np.nan) if has_3d else None
    for c, camera in enumerate(cameras):
        for frame, image in camera.items():
            t, people = position[frame], slice(0, len(image.confidence))
            points2d_px[t, c, people] = image.points2d_px
            confidence[t, c, people] = image.confidence
            if points3d is not None and image.points3d is not None:
                points3d[t, c, people] = image.points3d
    return _Stack(frames, points2d_px, confidence, points3d)


def _frame_numbers(cameras: list[CameraDetections], rig: CameraRig) -> np.ndarray:
    """The numbers of all frames from the first to the last in the step of the recording."""
    empty = [name for name, camera in zip(rig.names, cameras, strict=True) if not camera]
    if len(empty) == len(cameras):
        raise ValueError("no detection in any camera")
    if len(cameras) > 1 and sum(map(len, cameras)) == len(set().union(*cameras)) and len(empty) < len(cameras) - 1:
        ranges = [f"{name} {min(c)}-{max(c)}" for name, c in zip(rig.names, cameras, strict=True) if c]
        raise ValueError(f"no frame number occurs in two cameras: {', '.join(ranges)}")
    present = np.array(sorted(set().union(*cameras)))
    step = int(np.gcd.reduce(np.diff(present))) if len(present) > 1 else 1
    n_frames = (present[-1] - present[0]) // step + 1
    if n_frames > _MAX_FRAMES_PER_IMAGE * len(present):
        raise ValueError(
            f"the numbers of the images are not frame numbers: {len(present)} images from {present[0]} to {present[-1]}"
        )
    return present[0] + step * np.arange(n_frames)


def _observations(
    stack: _Stack,
    rig: CameraRig,
    skeleton: Skeleton,
    fps: float,
    person: Person,
    points3d_frame: Points3dFrame,
    points3d_unit: Points3dUnit,
) -> Observations:
    chosen = _chosen_people(stack, rig, skeleton, fps, person)
    points3d = None if stack.points3d is None else _pick(stack.points3d, chosen, np.nan)
    if points3d is not None:
        points3d = points3d * _METRES[points3d_unit]
        if points3d_frame == "camera":
            points3d = np.stack([view.to_world_frame(points3d[:, c]) for c, view in enumerate(rig.cameras)], axis=1)
    return Observations(
        skeleton=skeleton,
        time_s=stack.frames / fps,
        points2d_px=_pick(stack.points2d_px, chosen, np.nan),
        confidence=_pick(stack.confidence, chosen, 0.0),
        points3d_m=points3d,
        camera_names=rig.names,
    )


def _chosen_people(stack: _Stack, rig: CameraRig, skeleton: Skeleton, fps: float, person: Person) -> np.ndarray:
    """(T, C) index of the person in each image, NOBODY where it is not there."""
    present = np.asarray((stack.confidence > 0).any(axis=-1))
    if person == "consistent" and present.shape[2] > 1:
        people = track_people(stack.points2d_px, stack.confidence, stack.frames / fps, rig, skeleton)
        return people[0] if people else np.full(present.shape[:2], NOBODY)
    index = 0 if person == "consistent" else person
    if index >= present.shape[2]:
        raise ValueError(f"there is no person {index}: at most {present.shape[2]} in an image, counted from 0")
    return np.where(present[:, :, index], index, NOBODY)


def _pick(array: np.ndarray, chosen: np.ndarray, missing: float) -> np.ndarray:
    """(T, C, J, ...) of the chosen people from (T, C, P, J, ...)."""
    index = np.maximum(chosen, 0).reshape(*chosen.shape, *[1] * (array.ndim - 2))
    picked = np.take_along_axis(array, index, axis=2)[:, :, 0]
    return np.where((chosen == NOBODY).reshape(*chosen.shape, *[1] * (array.ndim - 3)), missing, picked)
