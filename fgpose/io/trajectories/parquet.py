"""Trajectories as Parquet: one long table that any data tool reads."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int

from fgpose.io.origin import Origin, origin_from_json, origin_to_json
from fgpose.io.tables import (
    file_metadata,
    metadata,
    names,
    numbers,
    read_table,
    symmetric,
    whole_numbers,
    write_row_groups,
)
from fgpose.io.trajectories.description import describe, described, status_named
from fgpose.io.trajectories.result_table import AXES, PER_CAMERA, result_tables
from fgpose.trajectory import Trajectory

if TYPE_CHECKING:
    import pyarrow as pa

_PREFIX = "fgpose."
_ORIGIN = "origin"
ORIGIN_KEY = _PREFIX + _ORIGIN
"""Of the metadata of a file that says what it was made from."""
_HAS_COVARIANCE = "has_covariance"


def write_parquet(
    people: Mapping[int, Trajectory],
    frames: Mapping[int, Int[np.ndarray, " frame"]],
    path: Path,
    origin: Origin | None = None,
) -> None:
    """Write one row per person, frame and joint: person by person, joints in the order of the skeleton in each frame.

    Columns: time_s, frame, person, joint; x_m, y_m, z_m in the world frame; cov_xx_m2, cov_xy_m2, cov_xz_m2, cov_yy_m2,
    cov_yz_m2, cov_zz_m2; n_views, the number of cameras with a detection; reprojection_px, the median of their
    reprojection errors in undistorted pixels; status (observed, predicted, unobservable); and, where they are known,
    the errors of each camera in residual_px_<camera>, and the probability that its detection is of the joint in
    visibility_<camera>. What is not known is null. The metadata of the file (keys fgpose.*) hold the skeleton, cameras,
    bone lengths with standard deviations and convergence as JSON and the config as TOML; what is not everybody's has
    the number of its person (fgpose.bone_lengths_m.3). fgpose.origin, where it is known, says what they were made from
    (fgpose.io.origin).

    Args:
        people: by number, one at least.
        frames: the numbers of each one's frames.
        path: the file.
        origin: what they were made from.

    Raises:
        ValueError: people differ in skeleton or cameras, or some have a covariance, residuals or visibility only.
        OSError: the file cannot be written.
    """
    texts = {
        person: describe(trajectory) | {_HAS_COVARIANCE: str(trajectory.covariance_m2 is not None).lower()}
        for person, trajectory in people.items()
    }
    known = _joined(texts) | ({} if origin is None else {_ORIGIN: origin_to_json(origin, path.parent)})
    tables = result_tables(people, frames)
    first = next(tables)
    schema = first.schema.with_metadata({_PREFIX + name: text for name, text in known.items()})
    write_row_groups(path, schema, (each.replace_schema_metadata(schema.metadata) for each in chain([first], tables)))


def _joined(texts: Mapping[int, dict[str, str]]) -> dict[str, str]:
    """What everybody has is there once, under its name; all else under name.person."""
    common = set.intersection(*(set(own.items()) for own in texts.values()))
    return {
        name if (name, text) in common else f"{name}.{person}": text
        for person, own in texts.items()
        for name, text in own.items()
    }


def _own(texts: Mapping[str, str], person: int) -> dict[str, str]:
    """The texts of one person from what _joined wrote."""
    parts = {name: name.partition(".")[::2] for name in texts}
    return {name: texts[key] for key, (name, whose) in parts.items() if whose in ("", str(person))}


def read_parquet(path: Path) -> dict[int, Trajectory]:
    """The trajectories that write_parquet wrote, by person. Covariances come back symmetric, from their upper triangle.

    People may be mixed; of each the rows stand as they were written. Whole frames may be left out.

    Raises:
        ValueError: the file is something else, or rows are missing or in another order.
        OSError: it cannot be opened.
    """
    table = read_table(path)
    texts = {key.removeprefix(_PREFIX): text for key, text in metadata(table).items() if key.startswith(_PREFIX)}
    if not texts:
        raise ValueError("it was not written by fgpose, or lost its metadata since")
    people = {}
    # A trajectory without frames has no row that could say whose it is.
    for person, rows in (_by_person(table) or {0: table}).items():
        try:
            people[person] = _trajectory(rows, _own(texts, person))
        except ValueError as error:
            raise ValueError(f"person {person}: {error}") from None
    return people


def read_origin(path: Path) -> Origin | None:
    """What write_parquet was told of the origin of a result; None where there is none, as in files of older versions.

    Raises:
        ValueError: the file, or what it says, is damaged.
        OSError: it cannot be opened.
    """
    text = file_metadata(path).get(ORIGIN_KEY)
    return None if text is None else origin_from_json(text, path.parent)


def _by_person(table: pa.Table) -> dict[int, pa.Table]:
    """The rows of each person, in the order in which they first occur."""
    column = numbers(table, "person")
    people, first, index = np.unique(column, return_index=True, return_inverse=True)
    whole_numbers(people, "person")
    if len(people) == 1:
        return {int(people[0]): table}  # a copy of an hour takes 0.8 GB
    rows = table.take(np.argsort(first[index], kind="stable"))
    order = np.argsort(first)
    ends = np.cumsum(np.bincount(index, minlength=len(people))[order]).tolist()
    return {
        int(person): rows.slice(begin, end - begin)
        for person, begin, end in zip(people[order], [0, *ends], ends, strict=False)
    }


def _trajectory(table: pa.Table, texts: dict[str, str]) -> Trajectory:
    """Of one person."""
    values = described(texts)
    joints = values["skeleton"].joints
    n_frames = table.num_rows // len(joints)
    values["frame_numbers"] = _frame_numbers(table, joints, n_frames)

    def column(name: str) -> np.ndarray:
        return numbers(table, name).reshape(n_frames, len(joints))

    for field in PER_CAMERA:
        cameras = [f"{field}_{name}" for name in values["camera_names"]]
        if cameras and set(cameras) <= set(table.column_names):
            values[field] = np.stack([column(name) for name in cameras], axis=1)
    if texts.get(_HAS_COVARIANCE) == "true":
        values["covariance_m2"] = symmetric(column)
    status_names, status = names(table, "status")
    meaning = np.array([status_named(name) for name in status_names], dtype=int)
    return Trajectory(
        time_s=column("time_s")[:, 0],
        positions_m=np.stack([column(f"{axis}_m") for axis in AXES], axis=-1),
        status=meaning[status].reshape(n_frames, len(joints)),
        **values,
    )


def _frame_numbers(table: pa.Table, joints: tuple[str, ...], n_frames: int) -> Int[np.ndarray, " frame"]:
    """Raises ValueError unless rows are in order."""
    joint_names, joint = names(table, "joint")
    known = np.array([joints.index(each) if each in joints else -1 for each in joint_names], dtype=int)
    frame = numbers(table, "frame")
    numbered = frame[:: len(joints)]
    in_order = (np.diff(numbered) > 0).all() and np.array_equal(frame, np.repeat(numbered, len(joints)))
    if not in_order or not np.array_equal(known[joint], np.tile(np.arange(len(joints)), n_frames)):
        raise ValueError("rows are missing or in another order: each frame must hold every joint of the skeleton once")
    return whole_numbers(numbered, "frame")
