"""DeepLabCut: a table (csv) for each camera, with a header of scorer, bodyparts and coords."""

from __future__ import annotations

import codecs
import csv
import math
from array import array
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain, islice
from pathlib import Path

import numpy as np
from jaxtyping import Float

from fgpose.io.content import first_bytes, read_content, text_lines
from fgpose.io.keypoints.detections import CameraDetections, Provenance, checked_detections
from fgpose.io.names import camera_name, frame_numbers
from fgpose.io.skeletons.joint_names import plain_joint
from fgpose.plain_files import naming
from fgpose.skeleton import Skeleton

_HEADER = ("scorer", "individuals", "bodyparts", "coords")
_COORDINATES = ("x", "y", "likelihood")
_NO_COLUMN = -1


def is_deeplabcut(path: Path) -> bool:
    """Whether a csv begins as DeepLabCut's, or as Excel saves it: with a byte order mark, with semicolons. Raises
    OSError if it cannot be read."""
    return first_bytes(path, 10).removeprefix(codecs.BOM_UTF8).startswith((b"scorer,", b"scorer;"))


def read(source: Provenance, skeleton: Skeleton) -> CameraDetections:
    """The images of one camera. Joints are found by their names (without case and separators); body parts that the
    skeleton lacks are left out. Without a likelihood (labels) all that is there has confidence 1.

    Raises:
        ValueError: the table is damaged, or has no body part for a joint of the skeleton; the message names file,
            camera, frame and joint.
    """
    with naming(source, "not a table of DeepLabCut", damage=[csv.Error]):
        rows = _rows(source.path)
        start = list(islice(rows, len(_HEADER)))
        header, first = _header(start)
        people = _columns(skeleton, header, first)
        indices, values = _body(chain(start, rows), len(header), len(header["coords"]), first)
    # One more, for what there is no column of.
    values = np.concatenate([values, np.full((len(values), 1), np.nan)], axis=1)
    n_given = len(set(header["bodyparts"][first:]))
    found: CameraDetections = {}
    for frame, row in zip(_frames(source, indices), values, strict=True):
        joints = np.stack([row[columns] for columns in people])
        joints[..., 2] = np.where(people[:, :, 2] == _NO_COLUMN, 1.0, joints[..., 2])
        joints = joints[np.isfinite(joints[..., :2]).all(axis=-1).any(axis=-1)]
        here = Provenance(source.path, source.camera, frame)
        image = checked_detections(here, skeleton, joints[..., :2], joints[..., 2])
        if frame in found:
            raise ValueError(f"{here}: this frame comes twice")
        found[frame] = replace(image, n_given=n_given)
    return found


def body_parts(source: Provenance) -> tuple[str, ...]:
    """The names of its joints. Raises ValueError as read."""
    with naming(source, "not a table of DeepLabCut", damage=[csv.Error]):
        header, first = _header(list(islice(_rows(source.path), len(_HEADER))))
    return tuple(dict.fromkeys(header["bodyparts"][first:]))


def _rows(path: Path) -> Iterator[list[str]]:
    """Those that are not empty."""
    content = read_content(path)
    semicolons = next(text_lines(content), "").startswith("scorer;")
    return filter(None, csv.reader(text_lines(content), delimiter=";" if semicolons else ","))


def _header(rows: Sequence[list[str]]) -> tuple[dict[str, list[str]], int]:
    """The rows of the header by their names, and the first column of coordinates."""
    header = {row[0]: row for row in rows if row[0] in _HEADER}
    if not {"bodyparts", "coords"} <= set(header) or not set(header["coords"]) & set(_COORDINATES):
        raise ValueError("it lacks the rows bodyparts and coords")
    if len({len(row) for row in header.values()}) > 1:
        raise ValueError("the rows of its header have different lengths")
    return header, next(i for i, kind in enumerate(header["coords"]) if kind in _COORDINATES)


def _body(
    rows: Iterable[list[str]], n_header: int, n_columns: int, first: int
) -> tuple[list[str], Float[np.ndarray, "row column"]]:
    """What the rows after the header are named by, and their numbers, from the first column of them on."""
    names: list[str] = []
    values = array("d")
    for number, row in enumerate(rows, 1):
        if len(row) != n_columns:
            raise ValueError(f"row {number} has {len(row)} cells, coords has {n_columns}")
        if number > n_header:
            names.append(row[first - 1] if first else str(len(names)))
            # Where cells are separated by semicolons, numbers may have decimal commas.
            values.extend(float(cell.replace(",", ".")) if cell.strip() else math.nan for cell in row[first:])
    return names, np.array(values).reshape(len(names), n_columns - first)


def _columns(skeleton: Skeleton, header: dict[str, list[str]], first: int) -> np.ndarray:
    """(person, joint, 3) where x, y and likelihood of each joint are, counted from the first; at least one person has
    it."""
    whose = header.get("individuals", [""] * len(header["coords"]))
    where: dict[str, dict[tuple[str, str], int]] = {}
    for column in range(first, len(whose)):
        part, kind = plain_joint(header["bodyparts"][column]), header["coords"][column]
        where.setdefault(whose[column], {})[part, kind] = column - first
    parts = {part for of_person in where.values() for part, _ in of_person}
    missing = [joint for joint in skeleton.joints if plain_joint(joint) not in parts]
    if missing:
        given = ", ".join(dict.fromkeys(header["bodyparts"][first:]))
        raise ValueError(
            f"it has no body part {', '.join(missing)} of skeleton {skeleton.name}, only {given}. Write a "
            f"skeleton file (TOML) whose joints are {given}, and give it as --skeleton"
        )
    keys = [[(plain_joint(joint), kind) for kind in _COORDINATES] for joint in skeleton.joints]
    return np.array([[[own.get(key, _NO_COLUMN) for key in joint] for joint in keys] for own in where.values()])


def _frames(source: Provenance, indices: Sequence[str]) -> list[int]:
    """Of each row: its number, or that in the name of its image."""
    names = [Path(index).stem for index in indices]
    number = frame_numbers(list(dict.fromkeys(names)), camera_name(source.camera))
    found = []
    for name in names:
        frame = number[name]
        if frame is None:
            raise ValueError(f"{source}: {name!r} is not the number of a frame")
        found.append(frame)
    return found
