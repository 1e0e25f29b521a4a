"""One file per camera: MMPose, COCO results, AlphaPose, MeTRAbs, DeepLabCut."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fgpose.io.arrays import read_arrays
from fgpose.io.keypoints import deeplabcut
from fgpose.io.keypoints.detections import (
    CameraDetections,
    ImageDetections,
    Provenance,
    checked_detections,
    detections_from_triples,
    nobody,
    numbers,
    read_json,
)
from fgpose.io.keypoints.image_files import image_format, mmpose_instances
from fgpose.io.names import MAX_FRAME, camera_name, frame_numbers
from fgpose.io.skeletons.joint_names import check_joints
from fgpose.plain_files import naming
from fgpose.skeleton import Skeleton


def read(path: Path, camera: str, skeleton: Skeleton) -> tuple[CameraDetections, str]:
    """The images of one camera by frame number, and the name of their format, recognised by the content.

    - MMPose: a list of ``frame_id`` and ``instances``, alone or as ``instance_info`` beside a ``meta_info`` that may
      say what the joints are.
    - COCO results, AlphaPose: a list of ``image_id``, ``keypoints`` (x, y, score per joint); the image_id is the frame.
    - MeTRAbs (npz, or JSON): ``poses2d`` (T, n, J, 2), ``poses3d`` (T, n, J, 3) and ``boxes`` (T, n, 5), whose last
      number is the confidence of all joints (1 without it); in JSON also a list with one such object per frame. An
      optional ``frame`` gives the numbers of the frames.

    Raises:
        ValueError: the file is damaged, of no such format, or does not fit the skeleton. The message names file,
            camera, frame and joint.
    """
    source = Provenance(path, camera)
    if path.suffix == ".csv":
        return deeplabcut.read(source, skeleton), "DeepLabCut"
    document = read_document(source)
    format_name, reader = reader_of(document, source)
    return reader(document, source, skeleton), format_name


def read_document(source: Provenance) -> Any:
    """The JSON, or the arrays of an npz. Raises ValueError, which names the file, if it is damaged."""
    if source.path.suffix != ".npz":
        return read_json(source)
    with naming(source):
        return read_arrays(source.path)


def reader_of(document: Any, source: Provenance) -> tuple[str, Callable[[Any, Provenance, Skeleton], CameraDetections]]:
    """The format of a document, and what reads it. Raises ValueError, which names the file, if it is of none."""
    first = document[0] if isinstance(document, list) and document else document
    if isinstance(document, list) and not document:
        return "COCO results", _read_coco
    if isinstance(first, Mapping):
        if "poses2d" in first:
            return "MeTRAbs", _read_metrabs
        if "instance_info" in first and isinstance(document, Mapping):
            return "MMPose", _read_mmpose
        if "frame_id" in first and "instances" in first and isinstance(document, list):
            return "MMPose", _read_mmpose_frames
        if "image_id" in first and "keypoints" in first and isinstance(document, list):
            return "COCO results", _read_coco
    one_image = image_format(document)
    if one_image:
        raise ValueError(
            f"{source}: {one_image} of a single image, where files of a whole camera are expected. Each camera needs a "
            f"folder of its own; if {source.path.parent} is that of one camera, give the folder above it, "
            f"{source.path.absolute().parent.parent}"
        )
    if isinstance(document, Mapping) and {"images", "annotations"} <= set(document):
        raise ValueError(
            f"{source}: annotations of COCO, not what a detector found; give results: a list of image_id and keypoints"
        )
    raise ValueError(f"{source}: not keypoints of MMPose, COCO results, AlphaPose or MeTRAbs")


def _read_mmpose(document: dict[str, Any], source: Provenance, skeleton: Skeleton) -> CameraDetections:
    with naming(source):
        check_joints(skeleton, *stated_joints(document.get("meta_info")))
    return _read_mmpose_frames(document["instance_info"], source, skeleton)


def stated_joints(meta: Any) -> tuple[list[str], str]:
    """What MMPose says of the joints: their names, none where it does not say, and the data set."""
    if not isinstance(meta, Mapping):
        return [], ""
    named, data_set = meta.get("keypoint_id2name"), meta.get("dataset_name")
    named = named if isinstance(named, Mapping) else {}
    names = [named.get(str(joint)) for joint in range(len(named))]
    known = all(isinstance(name, str) for name in names)
    return [str(name) for name in names] if known else [], data_set if isinstance(data_set, str) else ""


def _read_mmpose_frames(document: Any, source: Provenance, skeleton: Skeleton) -> CameraDetections:
    frames: CameraDetections = {}
    for position, image in enumerate(_rows(document, source)):
        if "frame_id" not in image or not isinstance(image.get("instances"), list):
            raise ValueError(f"{source}: entry {position} of instance_info lacks frame_id or instances")
        here = Provenance(source.path, source.camera, _frame_number(source, image["frame_id"]))
        frames[_new_frame(here, frames)] = mmpose_instances(image["instances"], here, skeleton)
    return frames


def _read_coco(document: list[Any], source: Provenance, skeleton: Skeleton) -> CameraDetections:
    rows = _rows(document, source)
    for position, row in enumerate(rows):
        if not {"image_id", "keypoints"} <= set(row):
            raise ValueError(f"{source}: entry {position} lacks image_id or keypoints")
    stems = {row["image_id"]: Path(row["image_id"]).stem for row in rows if isinstance(row["image_id"], str)}
    number = frame_numbers(list(dict.fromkeys(stems.values())), camera_name(source.camera))
    people: dict[int, list[Any]] = {}
    for row in rows:
        image = row["image_id"]
        frame = _frame_of(source, stems[image], number) if isinstance(image, str) else _frame_number(source, image)
        people.setdefault(frame, []).append(row["keypoints"])
    return {
        frame: detections_from_triples(Provenance(source.path, source.camera, frame), skeleton, found)
        for frame, found in sorted(people.items())
    }


def _read_metrabs(document: Any, source: Provenance, skeleton: Skeleton) -> CameraDetections:
    by_frame = _rows(document, source) if isinstance(document, list) else _rows_of_columns(document, source)
    frames: CameraDetections = {}
    for position, row in enumerate(by_frame):
        here = Provenance(source.path, source.camera, _frame_number(source, row.get("frame", position)))
        frames[_new_frame(here, frames)] = _metrabs_image(row, here, skeleton)
    return frames


def _rows_of_columns(columns: Mapping[str, Any], source: Provenance) -> list[dict[str, Any]]:
    used = {name: columns[name] for name in ("poses2d", "poses3d", "boxes", "frame") if name in columns}
    for name, column in used.items():
        if not isinstance(column, list) and np.ndim(column) == 0:
            raise ValueError(f"{source}: {name} is not a list with an entry per frame")
    if len({len(column) for column in used.values()}) > 1:
        lengths = ", ".join(f"{name} {len(column)}" for name, column in used.items())
        raise ValueError(f"{source}: a different number of frames in {lengths}")
    return [dict(zip(used, row, strict=True)) for row in zip(*used.values(), strict=True)]


def _metrabs_image(row: Mapping[str, Any], source: Provenance, skeleton: Skeleton) -> ImageDetections:
    poses2d, poses3d, boxes = (
        None if row.get(name) is None else numbers(source, name, row[name]) for name in ("poses2d", "poses3d", "boxes")
    )
    if poses2d is None:
        raise ValueError(f"{source}: poses2d is missing")
    if poses2d.size == 0:
        return nobody(source, skeleton)
    if poses2d.ndim < 2:
        raise ValueError(f"{source}: poses2d must be (people, joints, 2), got {poses2d.shape}")
    if poses2d.ndim == 2:
        poses2d, poses3d, boxes = (None if array is None else array[None] for array in (poses2d, poses3d, boxes))
        assert poses2d is not None
    n_people = len(poses2d)
    if boxes is not None and boxes.shape not in ((n_people, 4), (n_people, 5)):
        raise ValueError(f"{source}: boxes must be ({n_people}, 5) for {n_people} people, got {boxes.shape}")
    score = boxes[:, 4] if boxes is not None and boxes.shape[1] == 5 else np.ones(n_people)
    confidence = np.repeat(score[:, None], skeleton.n_joints, axis=1)
    return checked_detections(source, skeleton, poses2d, confidence, poses3d)


def _rows(rows: Any, source: Provenance) -> list[dict[str, Any]]:
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise ValueError(f"{source}: a list of objects is needed, one per frame or person")
    return rows


def _frame_number(source: Provenance, value: Any) -> int:
    number = isinstance(value, int | float | np.integer | np.floating)
    if not number or not 0 <= value < MAX_FRAME or value != int(value):
        raise ValueError(f"{source}: {value!r} is not the number of a frame")
    return int(value)


def _frame_of(source: Provenance, name: str, numbers: Mapping[str, int | None]) -> int:
    """Of the name of an image file."""
    number = numbers[name]
    if number is None:
        raise ValueError(f"{source}: no frame number in the name {name!r}")
    return number


def _new_frame(source: Provenance, frames: CameraDetections) -> int:
    if source.frame is None or source.frame in frames:
        raise ValueError(f"{source}: this frame comes twice")
    return source.frame
