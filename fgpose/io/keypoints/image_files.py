"""One JSON file per image, in one folder per camera: OpenPose (and Pose2Sim), or MMPose run on images."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fgpose.io.keypoints.detections import (
    CameraDetections,
    ImageDetections,
    Provenance,
    checked_detections,
    detections_from_triples,
    nobody,
    read_json,
)
from fgpose.io.names import camera_name, frame_numbers, not_hidden
from fgpose.io.skeletons import builtin_skeletons, load_skeleton
from fgpose.io.skeletons.joint_names import whose_joints
from fgpose.skeleton import Skeleton

# Where OpenPose writes the joints of the body and of each part.
_OPENPOSE_LISTS = {
    "": "pose_keypoints_2d",
    "left_hand": "hand_left_keypoints_2d",
    "right_hand": "hand_right_keypoints_2d",
    "face": "face_keypoints_2d",
}


def read(folder: Path, camera: str, skeleton: Skeleton) -> tuple[CameraDetections, str | None]:
    """The images of one camera by the frame number in their file names, and the name of their format.

    OpenPose: an object with ``people``, each with ``pose_keypoints_2d`` = x, y, confidence per joint, 0, 0, 0 =
    missing, and hands and face, if the skeleton has them, in lists of their own; an empty object, as Pose2Sim writes
    it, is somebody who is not in this image. MMPose: a list of instances with ``keypoints`` and ``keypoint_scores``.

    Raises:
        ValueError: a file is damaged, of another format than the others, or does not fit the skeleton; two have the
            same frame number. The message names file, camera, frame and joint.
    """
    frames: CameraDetections = {}
    format_of_folder = None
    paths = not_hidden(folder.glob("*.json"))
    number = frame_numbers([path.stem for path in paths], camera_name(folder.name))
    for path in paths:
        frame = number[path.stem]
        source = Provenance(path, camera, frame)
        if frame is None:
            raise ValueError(f"{source}: no frame number in the name {path.stem!r}")
        if frame in frames:
            raise ValueError(f"{source}: another file has the same frame number")
        document = read_json(source)
        kind = image_format(document)
        if kind is None or (format_of_folder and kind and kind != format_of_folder):
            wanted = format_of_folder or "an image of OpenPose or MMPose"
            raise ValueError(f"{source}: this is {kind or 'something else'}, not {wanted}")
        format_of_folder = format_of_folder or kind or None
        frames[frame] = _detections(document, source, skeleton)
    return frames, format_of_folder


def image_format(document: Any) -> str | None:
    """The format of a document about one image; empty for a list without people, None for something else."""
    if isinstance(document, dict) and "people" in document:
        return "OpenPose"
    if isinstance(document, list) and all(isinstance(row, dict) and "keypoint_scores" in row for row in document):
        return "MMPose" if document else ""
    return None


def _detections(document: Any, source: Provenance, skeleton: Skeleton) -> ImageDetections:
    if isinstance(document, list):
        return mmpose_instances(document, source, skeleton)
    people = document["people"]
    if not isinstance(people, list) or not all(isinstance(row, dict) for row in people):
        raise ValueError(f"{source}: people are not a list of objects")
    if any(row and "pose_keypoints_2d" not in row for row in people):
        raise ValueError(f"{source}: a person without pose_keypoints_2d")
    found = detections_from_triples(source, skeleton, [_openpose_triples(row, source, skeleton) for row in people])
    used = {"", *(part.name for part in skeleton.parts)}
    n_unused = max((sum(n for name, n in _n_listed(row).items() if name not in used) for row in people), default=0)
    return replace(found, n_given=found.n_given + n_unused) if found.n_given else found


def _n_listed(person: Mapping[str, Any]) -> dict[str, int]:
    """How many joints each list has that is not empty, by the name of the part."""
    given = {name: person.get(key) for name, key in _OPENPOSE_LISTS.items()}
    return {name: len(numbers) // 3 for name, numbers in given.items() if isinstance(numbers, list) and numbers}


def skeletons_with_parts(document: Any) -> tuple[str, ...]:
    """The built-in skeletons that have hands and face as well, whose lists are in an image of OpenPose."""
    people = [row for row in document["people"] if isinstance(row, dict)] if isinstance(document, dict) else []
    fitting = dict.fromkeys(
        skeleton.name
        for skeleton in map(load_skeleton, builtin_skeletons())
        if skeleton.parts
        for row in people
        if _n_joints(skeleton).items() <= _n_listed(row).items()
    )
    return tuple(fitting)


def _n_joints(skeleton: Skeleton) -> dict[str, int]:
    return {"": len(skeleton.body), **{part.name: len(part.joints) for part in skeleton.parts}}


def _openpose_triples(person: dict[str, Any], source: Provenance, skeleton: Skeleton) -> list[Any]:
    """Of all joints of the skeleton; its parts have lists of their own, or are with the body (Pose2Sim). Raises
    ValueError if a list does not fit."""
    of_body = person.get("pose_keypoints_2d", [])
    if not of_body or not skeleton.parts or len(of_body) == 3 * skeleton.n_joints:
        return of_body
    triples = np.zeros((skeleton.n_joints, 3), dtype=object)
    for name, joints in (("", skeleton.body), *((part.name, part.joints) for part in skeleton.parts)):
        key = _OPENPOSE_LISTS[name]
        given = person.get(key, [])
        if given and len(given) != 3 * len(joints):
            other = "" if name or len(given) % 3 else whose_joints(skeleton, len(given) // 3)
            raise ValueError(
                f"{source}: {key} has {len(given)} numbers, skeleton {skeleton.name} needs {3 * len(joints)}: x, y, "
                f"confidence of {len(joints)} joints{other}"
            )
        if given:
            triples[list(joints)] = np.array(given, dtype=object).reshape(-1, 3)
    return triples.ravel().tolist()


def mmpose_instances(instances: list[Any], source: Provenance, skeleton: Skeleton) -> ImageDetections:
    """People of one image of MMPose. Raises ValueError as checked_detections does."""
    if not all(isinstance(row, dict) and {"keypoints", "keypoint_scores"} <= set(row) for row in instances):
        raise ValueError(f"{source}: an instance without keypoints or keypoint_scores")
    if not instances:
        return nobody(source, skeleton)
    points2d_px = [row["keypoints"] for row in instances]
    return checked_detections(source, skeleton, points2d_px, [row["keypoint_scores"] for row in instances])
