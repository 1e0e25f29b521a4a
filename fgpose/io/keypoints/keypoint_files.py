"""Reading of keypoints of any format into Observations."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np

from fgpose.association.chosen_person import PersonRegion, chosen_person, main_person
from fgpose.correspondences import NO_IMAGE, MatchedFrames
from fgpose.geometry.camera import CameraRig
from fgpose.io.formats import KeypointFormat, recognised
from fgpose.io.keypoints import camera_files, freemocap, image_files, live_files, people_files, recording_files
from fgpose.io.keypoints.detections import CameraDetections
from fgpose.io.keypoints.networks import network_files, placing
from fgpose.io.keypoints.scores import as_confidences, without_zeros
from fgpose.io.keypoints.sources import filtered_beside, freemocap_file, keypoint_sources
from fgpose.io.keypoints.stated_skeleton import stated_skeleton
from fgpose.io.names import match_cameras
from fgpose.io.skeletons import as_skeleton
from fgpose.observations import Observations
from fgpose.people_observations import Detections, PeopleObservations
from fgpose.plain_files import naming
from fgpose.shown.wrong_types import check_type
from fgpose.skeleton import Skeleton

Points3dFrame = Literal["camera", "world"]
Points3dUnit = Literal["mm", "m"]
Person = Literal["consistent"] | int | PersonRegion

_METRES = {"mm": 1e-3, "m": 1.0}
# No camera is faster, nobody's motion can be followed with one that is slower.
_MIN_FPS, _MAX_FPS = 1e-3, 1e5
# Numbers with larger gaps than this between the images are not frame numbers.
_MAX_FRAMES_PER_IMAGE = 1000
# Longer than some hours, somebody is seen in a part of them.
_MAX_SPARSE, _MAX_SPARSENESS = 1_000_000, 20


def load_observations(
    path: str | Path,
    rig: CameraRig,
    skeleton: str | Path | Skeleton | None = None,
    *,
    fps: float | None = None,
    person: Person = "consistent",
    points3d_frame: Points3dFrame = "camera",
    points3d_unit: Points3dUnit = "mm",
    ignore_other_cameras: bool = False,
) -> Observations:
    """The keypoints of a recording; the format is recognised by its content.

    - A folder with one sub-folder per camera (``cam01_json`` or ``cam01``) and in it one JSON file per image, of
      OpenPose or MMPose; the frame number is that in the file name which counts.
    - A folder with one file per camera (``cam01.json``, or a folder that holds it), of MMPose, COCO results, AlphaPose,
      DeepLabCut (csv) or MeTRAbs (JSON or npz). DeepLabCut's joints are found by their names.
    - Either of these of SAM 3D Body or NLF: npz, JSON, pickle, or a file of torch.save (pt). Nothing in them is run.
      Their 3D becomes absolute by their 2D and the calibration, see fgpose.io.keypoints.networks.placing.
    - FreeMoCap's 2D points (npy), of whose cameras the order is that of the calibration.
    - A recording written by save_observations or save_people_observations, npz or parquet.
    - The recording of a live system; its times count from its beginning.
    - Formats that other packages add (fgpose.io.formats).

    A frame that one camera lacks was not seen by it; where the numbers leave out a frame in all cameras, nobody saw it.
    Camera names are compared as match_cameras does. Of whole bodies with face and hands (COCO-WholeBody, Halpe-136) the
    joints of the skeleton are taken. Scores above 1 become confidences: about 1 they are clipped, those of scales up to
    10 and 100 are divided. Joints at exactly (0, 0) are missing.

    Args:
        path: the folder or file.
        rig: the cameras; the result has them in this order.
        skeleton: a built-in one, a TOML file or a Skeleton; None: as the files say (stated_skeleton).
        fps: frames per second; needed for every format but our own, whose files contain times. Frame n is at n / fps.
        person: of several people, consistent takes the one who is seen most, as views and frames agree; a number
            takes that entry of every image; a region takes the person who is in it.
        points3d_frame, points3d_unit: of the 3D joints of MeTRAbs: the frame of each camera, or of the world if it was
            given extrinsics. Of other networks both are found.
        ignore_other_cameras: whether there may be keypoints of cameras that the rig lacks.

    Raises:
        ValueError: a file is damaged or of no known format, formats are mixed, the keypoints do not fit the skeleton,
            cameras of rig and keypoints differ, a file says that its joints are others or says nothing of them, a
            confidence is impossible, fps is missing. The message names file, camera, joint and frame.
        OSError: a file cannot be read.

    Warns:
        UserWarning: something was changed or left out to read the files; the result has it as remarks.
    """
    _check_person(Path(path), person)
    seen = load_recording(
        path,
        rig,
        skeleton,
        fps=fps,
        points3d_frame=points3d_frame,
        points3d_unit=points3d_unit,
        ignore_other_cameras=ignore_other_cameras,
    )
    return seen if isinstance(seen, Observations) else _person_of(Path(path), seen, rig, person)


def load_people(
    path: str | Path,
    rig: CameraRig,
    skeleton: str | Path | Skeleton | None = None,
    *,
    fps: float | None = None,
    points3d_frame: Points3dFrame = "camera",
    points3d_unit: Points3dUnit = "mm",
    ignore_other_cameras: bool = False,
) -> PeopleObservations:
    """The keypoints of everybody in a recording, of the formats of load_observations; arguments and errors as there.

    A recording written by save_observations is of one person, one written by save_people_observations of everybody.
    """
    seen = load_recording(
        path,
        rig,
        skeleton,
        fps=fps,
        points3d_frame=points3d_frame,
        points3d_unit=points3d_unit,
        ignore_other_cameras=ignore_other_cameras,
    )
    return PeopleObservations.of_one(seen) if isinstance(seen, Observations) else seen


def load_recording(
    path: str | Path,
    rig: CameraRig,
    skeleton: str | Path | Skeleton | None = None,
    *,
    fps: float | None = None,
    points3d_frame: Points3dFrame = "camera",
    points3d_unit: Points3dUnit = "mm",
    ignore_other_cameras: bool = False,
) -> Observations | PeopleObservations:
    """As load_people; of one person where that is all that the file can hold: it takes a sixth of the memory."""
    check_type("load_observations", "rig", rig, CameraRig)
    path = Path(path)
    with naming(path):
        return _read(path, rig, skeleton, fps, points3d_frame, points3d_unit, ignore_other_cameras)


def _read(
    path: Path,
    rig: CameraRig,
    skeleton: str | Path | Skeleton | None,
    fps: float | None,
    points3d_frame: Points3dFrame,
    points3d_unit: Points3dUnit,
    ignore_other_cameras: bool,
) -> Observations | PeopleObservations:
    """Everybody, or the one person whom save_observations wrote."""
    skeleton = stated_skeleton(path) if skeleton is None else as_skeleton(skeleton)
    _check_options(path, fps, points3d_frame, points3d_unit)
    if (other := recognised(KeypointFormat, path)) is not None:
        return other.read(path, rig, skeleton)
    if recording_files.is_recording(path):
        own = people_files if people_files.is_people(path) else recording_files
        return own.read(path, rig, skeleton, ignore_other_cameras=ignore_other_cameras)
    if path.is_file() and live_files.is_live(path):
        return live_files.read(path, rig, skeleton)
    cameras, remarks = _read_cameras(path, skeleton)
    own = _in_order(cameras, rig, ignore_other_cameras) if freemocap_file(path) is None else _by_place(cameras, rig)
    frames_of_file = _matched_frames(own, rig, _needed(fps))
    if placing.is_of_network(own):
        images, of_network = placing.placed(own, rig, skeleton, _needed(fps))
        remarks += tuple(f"{path}: {remark}" for remark in of_network)
    else:
        images = _images(own, rig, _needed(fps), points3d_frame, points3d_unit)
    for remark in remarks:
        warnings.warn(remark, stacklevel=3)
    return PeopleObservations(skeleton, rig.names, images, frames_of_file, remarks=remarks)


def _person_of(path: Path, people: PeopleObservations, rig: CameraRig, person: Person) -> Observations:
    """What the cameras saw of the person wanted, see load_observations. Raises ValueError, which names the file."""
    with naming(path):
        if person == "consistent":
            chosen = main_person(people, rig)
            if chosen.n_people > 1 and people.n_most <= 1:
                warnings.warn(
                    f"{path}: {chosen.n_people} people come one after the other; this is {chosen}. "
                    "load_people and smooth_people take them all",
                    stacklevel=3,
                )
            return people.of_person(chosen.seen)
        if isinstance(person, PersonRegion):
            return people.of_person(chosen_person(people, rig, person).seen)
        if person >= max(people.n_most, 1):
            raise ValueError(f"there is no person {person}: at most {people.n_most} in an image, counted from 0")
        return people.of_person(people.only(person))


def _in_order(cameras: dict[str, CameraDetections], rig: CameraRig, ignore_others: bool) -> list[CameraDetections]:
    """Of the cameras of the rig. Raises ValueError if names do not match."""
    matched = match_cameras(cameras, rig.names, ignore_others=ignore_others)
    return [cameras[matched[name]] for name in rig.names]


def _by_place(cameras: dict[str, CameraDetections], rig: CameraRig) -> list[CameraDetections]:
    """Of a file without names of cameras. Raises ValueError if it cannot be known which they are."""
    if len(cameras) != rig.n_cameras:
        raise ValueError(
            f"it has {len(cameras)} cameras without names, the calibration {rig.n_cameras}: give the calibration of "
            "exactly these, and leave --cameras out"
        )
    return list(cameras.values())


def _needed(fps: float | None) -> float:
    if fps is None:
        raise ValueError("these keypoints have no times; give the frames per second (fps, or --fps)")
    return fps


def keypoint_cameras(path: str | Path) -> tuple[str, ...]:
    """The cameras of keypoints of any format that load_observations reads, by the names they have there.

    Raises:
        ValueError: the file is damaged or the folder has no keypoints; the message names it.
        OSError: it cannot be read.
    """
    path = Path(path)
    if (other := recognised(KeypointFormat, path)) is not None:
        return other.camera_names(path)
    if path.is_file() and live_files.is_live(path):
        return live_files.camera_names(path)
    if array := freemocap_file(path):
        return freemocap.camera_names(array)
    return recording_files.camera_names(path) if recording_files.is_recording(path) else tuple(keypoint_sources(path))


def _check_person(path: Path, person: Person) -> None:
    if person != "consistent" and not isinstance(person, PersonRegion) and (not isinstance(person, int) or person < 0):
        raise ValueError(f"{path}: person must be consistent, a region or an index from 0, got {person!r}")


def _check_options(path: Path, fps: float | None, frame: str, unit: str) -> None:
    if fps is not None and not (_MIN_FPS <= fps <= _MAX_FPS):
        raise ValueError(f"{path}: fps must be a number from {_MIN_FPS:g} to {_MAX_FPS:g}, got {fps:g}")
    if frame not in ("camera", "world") or unit not in _METRES:
        raise ValueError(
            f"{path}: points3d_frame is camera or world and points3d_unit mm or m, got {frame!r} and {unit!r}"
        )


def _read_cameras(path: Path, skeleton: Skeleton) -> tuple[dict[str, CameraDetections], tuple[str, ...]]:
    """Everything detected by each camera, by the names of the keypoints, in natural order; and what is to be said."""
    array = freemocap_file(path)
    if array is not None:
        cameras, formats = freemocap.read(array, skeleton), {}
    else:
        cameras, formats = _read_each(path, skeleton)
    if len(set(formats.values())) > 1:
        mixture = ", ".join(f"{name}: {format_name}" for name, format_name in formats.items())
        raise ValueError(f"{path}: a mixture of formats ({mixture})")
    cameras, of_zeros = without_zeros(cameras)
    cameras, of_scores = as_confidences(cameras, skeleton)
    remarks = of_zeros + of_scores
    if array is not None:
        remarks += ("the cameras have no names in this file: they are taken in the order of the calibration",)
    else:
        remarks += filtered_beside(path)
    remarks += _counted_from_1(cameras)
    given = {image.n_given for images in cameras.values() for image in images.values()} - {0, skeleton.n_joints}
    if given:
        remarks += (f"of the {max(given)} joints in the files only those of skeleton {skeleton.name} are used",)
    return cameras, tuple(f"{path}: {remark}" for remark in remarks)


def _counted_from_1(cameras: Mapping[str, CameraDetections]) -> tuple[str, ...]:
    """What to say where the images of some cameras have the numbers 0 to n - 1, those of others 1 to n."""
    spans = {name: (min(images), max(images), len(images)) for name, images in cameras.items() if images}
    whole = {last - first + 1 == n for first, last, n in spans.values()} == {True}
    from_1 = [name for name, (first, _, _) in spans.items() if first == 1]
    if not whole or len({n for *_, n in spans.values()}) > 1 or {first for first, *_ in spans.values()} != {0, 1}:
        return ()
    return (
        f"the images of {', '.join(from_1)} are counted from 1, as many of the others from 0: are the first ones of "
        "the same moment? Then count them alike",
    )


def _read_each(path: Path, skeleton: Skeleton) -> tuple[dict[str, CameraDetections], dict[str, str]]:
    """The images of each camera, and the formats of those that have any."""
    cameras: dict[str, CameraDetections] = {}
    formats: dict[str, str] = {}
    for name, source in keypoint_sources(path).items():
        reader = image_files if source.is_dir() else camera_files
        reader = network_files if network_files.is_of_network(source) else reader
        cameras[name], format_name = reader.read(source, name, skeleton)
        if format_name:
            formats[name] = format_name
    return cameras, formats


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
    if n_frames > _MAX_FRAMES_PER_IMAGE * len(present) or n_frames > max(_MAX_SPARSE, _MAX_SPARSENESS * len(present)):
        raise ValueError(
            f"the numbers of the images are not frame numbers: {len(present)} images from {present[0]} to {present[-1]}"
        )
    return present[0] + step * np.arange(n_frames)


def _images(
    cameras: list[CameraDetections],
    rig: CameraRig,
    fps: float,
    points3d_frame: Points3dFrame,
    points3d_unit: Points3dUnit,
) -> tuple[Detections, ...]:
    images = []
    for view, frames in zip(rig.cameras, cameras, strict=True):
        for frame, found in frames.items():
            points3d = found.points3d
            if points3d is not None:
                points3d = points3d * _METRES[points3d_unit]
                points3d = view.to_world_frame(points3d) if points3d_frame == "camera" else points3d
            images.append(Detections(view.name, frame / fps, found.points2d_px, found.confidence, points3d))
    return tuple(images)


def _matched_frames(cameras: list[CameraDetections], rig: CameraRig, fps: float) -> MatchedFrames:
    """The images of one frame number belong together."""
    numbers = _frame_numbers(cameras, rig)
    image = np.full((len(numbers), len(cameras)), NO_IMAGE)
    for c, frames in enumerate(cameras):
        image[np.searchsorted(numbers, sorted(frames)), c] = np.arange(len(frames))
    return MatchedFrames(numbers / fps, image)
