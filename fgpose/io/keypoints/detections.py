"""The detections of one image, checked while the file that they come from is known."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from fgpose.io.content import parse_json, read_content
from fgpose.io.skeletons.joint_names import chosen_joints, no_such_joints
from fgpose.observations import is_infinite
from fgpose.plain_files import naming
from fgpose.skeleton import Skeleton


@dataclass(frozen=True)
class Provenance:
    """Where numbers come from, for messages."""

    path: Path
    camera: str
    frame: int | None = None

    def __str__(self) -> str:
        frame = "" if self.frame is None else f", frame {self.frame}"
        return f"{self.path}, camera {self.camera}{frame}"


@dataclass(frozen=True)
class NetworkJoints:
    """What a monocular network says of the 3D joints of the people in an image, beside these; NaN: nothing."""

    network: str
    translation: Float[np.ndarray, "person 3"]
    """From the joints to the camera frame, in the unit of points3d."""
    focal_px: Float[np.ndarray, " person"]
    """That the network assumed."""
    sigma_m: Float[np.ndarray, "person joint"]
    """Its own uncertainty of each joint, metres."""


@dataclass(frozen=True)
class ImageDetections:
    """The people found in one image; NaN = missing, then with confidence 0."""

    source: Provenance
    points2d_px: Float[np.ndarray, "person joint 2"]
    confidence: Float[np.ndarray, "person joint"]
    """As in the file: its own scale, from 0."""
    points3d: Float[np.ndarray, "person joint 3"] | None = None
    """As in the file: its own unit and frame."""
    n_given: int = 0
    """Joints of each person in the file, which may be more than are used; 0: nobody is there."""
    of_network: NetworkJoints | None = None
    """Of a monocular network, whose 3D becomes absolute by its 2D; see fgpose.io.keypoints.networks."""


CameraDetections = dict[int, ImageDetections]
"""The images of one camera by frame number."""


def nobody(source: Provenance, skeleton: Skeleton) -> ImageDetections:
    """An image without people."""
    return ImageDetections(source, np.empty((0, skeleton.n_joints, 2)), np.empty((0, skeleton.n_joints)))


def read_json(source: Provenance) -> Any:
    """The document in a JSON file. Raises ValueError, naming file, camera and frame, if it is damaged."""
    with naming(source):
        content = read_content(source.path)
        if not content.strip():
            raise ValueError("the file is empty. Let the detector write it again, or remove it")
    with naming(source, "not JSON, or a truncated file"):
        return parse_json(content)


def detections_from_triples(source: Provenance, skeleton: Skeleton, people: list[Any]) -> ImageDetections:
    """People given as flat lists x, y, confidence per joint, an empty list for one without a body.

    Raises:
        ValueError: a list does not fit the skeleton, or a number is impossible.
    """
    rows = [numbers(source, f"the keypoints of person {p}", flat).ravel() for p, flat in enumerate(people)]
    # Somebody without a body keeps the numbers of those behind them; at the end it is nobody.
    while rows and not rows[-1].size:
        rows.pop()
    if not rows:
        return nobody(source, skeleton)
    size = max(row.size for row in rows)
    for person, row in enumerate(rows):
        if row.size not in (0, size) or size % 3:
            raise ValueError(_other_number(source, skeleton, person, row.size))
    triples = np.stack([row.reshape(-1, 3) if row.size else np.full((size // 3, 3), np.nan) for row in rows])
    if len(triples[0]) != skeleton.n_joints and chosen_joints(skeleton, len(triples[0])) is None:
        raise ValueError(_other_number(source, skeleton, next(p for p, row in enumerate(rows) if row.size), size))
    return checked_detections(source, skeleton, triples[..., :2], triples[..., 2])


def _other_number(source: Provenance, skeleton: Skeleton, person: int, n_values: int) -> str:
    return (
        f"{source}: person {person} has {n_values / 3:g} keypoints of x, y, confidence; "
        f"{no_such_joints(skeleton, n_values // 3)}"
    )


def checked_detections(
    source: Provenance, skeleton: Skeleton, points2d_px: Any, confidence: Any, points3d: Any = None
) -> ImageDetections:
    """Detections whose missing joints are NaN with confidence 0; of a larger set of joints that is known, those of the
    skeleton.

    Raises:
        ValueError: the number of joints is not the skeleton's, a number is infinite, a confidence negative; the message
            names file, camera, frame and joint.
    """
    given: dict[str, tuple[np.ndarray, tuple[int, ...]]] = {}
    given["2D points"] = numbers(source, "the 2D points", points2d_px), (2,)
    given["scores"] = numbers(source, "the confidence", confidence), ()
    if points3d is not None:
        given["3D points"] = numbers(source, "the 3D points", points3d), (3,)
    n_people, n_given = len(given["2D points"][0]), np.shape(given["2D points"][0])[1:2]
    chosen = chosen_joints(skeleton, *n_given) if n_given else None
    n_joints = skeleton.n_joints if chosen is None else n_given[0]
    for what, (array, size) in given.items():
        _check_shape(source, skeleton, what, array, (n_people, n_joints, *size))
    used = [array if chosen is None else array[:, list(chosen)] for array, _ in given.values()]
    points2d_px, confidence, *rest = used
    _refuse_joint(source, skeleton, np.asarray(is_infinite(points2d_px).any(axis=-1)), "a pixel that is infinite")
    known = np.isfinite(points2d_px).all(axis=-1) & ~np.isnan(confidence)
    bad = np.asarray(known & ~((confidence >= 0) & np.isfinite(confidence)))
    refuse_confidence(source, skeleton, confidence, bad)
    confidence = np.where(known, confidence, 0.0)
    points2d_px = np.where(confidence[..., None] > 0, points2d_px, np.nan)
    if rest:
        _refuse_joint(
            source, skeleton, np.asarray(is_infinite(rest[0]).any(axis=-1)), "a 3D coordinate that is infinite"
        )
    return ImageDetections(source, points2d_px, confidence, rest[0] if rest else None, n_joints)


def refuse_confidence(
    source: Provenance, skeleton: Skeleton, confidence: np.ndarray, bad: np.ndarray, remedy: str = ""
) -> None:
    """Raise ValueError, which names the first joint of the first person, if any confidence is bad."""
    first = ", ".join(f"{value:g}" for value in confidence[bad][:1])
    _refuse_joint(source, skeleton, bad, f"a confidence outside [0, 1]: {first}{remedy}")


def numbers(source: Provenance, what: str, value: Any) -> np.ndarray:
    """An array of what a file has; null is NaN. Raises ValueError for anything but numbers, or ragged lists of them."""
    try:
        array = np.array(value)
        if array.dtype.kind not in "OfiuV" and array.size:
            raise TypeError(f"{array.dtype} is no type of numbers")
        return array.astype(float)  # lists with null are objects
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{source}: {what} are not numbers, or not equally many for every joint") from None


def _check_shape(source: Provenance, skeleton: Skeleton, what: str, array: np.ndarray, shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise ValueError(
            f"{source}: the {what} of {shape[0]} people must be {shape} for the {skeleton.n_joints} joints of skeleton "
            f"{skeleton.name}, got {array.shape}; {no_such_joints(skeleton, *array.shape[1:2])}"
        )


def _refuse_joint(source: Provenance, skeleton: Skeleton, bad: np.ndarray, what: str) -> None:
    if bad.any():
        person, joint = np.argwhere(bad)[0]
        raise ValueError(f"{source}, joint {skeleton.joints[joint]}: person {person} has {what}")
