"""Files of joint angles and of what else follows from a trajectory: one function that writes, whatever the format."""

from __future__ import annotations

import json
import warnings
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from fgpose.geometry.up_axis import UpChoice, WorldUp, up_vector
from fgpose.io.atomic import check_replaceable, write_text
from fgpose.io.content import first_bytes
from fgpose.io.names import own_paths
from fgpose.io.origin import Origin, origin_to_json
from fgpose.io.tables import (
    FRAME,
    TIME_S,
    Column,
    file_metadata,
    metadata,
    names,
    nullable,
    numbers,
    one_line,
    read_table,
    whole_numbers,
    write_csv,
    write_table,
)
from fgpose.io.trajectories.bvh import write_bvh
from fgpose.io.trajectories.c3d import ROTATION_LABEL, check_frames, require_ezc3d, write_c3d
from fgpose.io.trajectories.parquet import ORIGIN_KEY
from fgpose.io.trajectories.result_table import frame_numbers, numbered
from fgpose.io.trajectories.upright import resolved_up
from fgpose.kinematics.angles import JointAngles, joint_angles
from fgpose.kinematics.motion import heights_m
from fgpose.kinematics.opensim import opensim_coordinates
from fgpose.kinematics.quantities import Quantities
from fgpose.kinematics.speeds import JointSpeeds, joint_speeds, with_centre_m
from fgpose.plain_files import naming
from fgpose.trajectory import Trajectory

EXTENSIONS = (".parquet", ".csv", ".mot", ".bvh", ".c3d")
"""What save_kinematics writes."""
UNITS = {each.kind: each.unit for each in (JointAngles, JointSpeeds)} | {"height": "m"}
"""Unit of value and sigma by kind of quantity."""
_TABLES = (".parquet", ".csv")
_UNITS_KEY = "fgpose.units"
_HEAD_BYTES = 4 << 20  # the parameters of a C3D are in these
_Quantities = tuple[list[str], list[str], Float[np.ndarray, "frame quantity"], Float[np.ndarray, "frame quantity"]]
"""Kinds, names, values and standard deviations."""
KINEMATICS = (
    TIME_S,
    FRAME,
    Column("person", "", "number of the person"),
    Column("kind", "", "`angle`, `speed` or `height`"),
    Column("name", "", "the [angle](../angles.md), or the joint; `centre`: the root of the body"),
    Column(
        "value",
        "that of `unit`",
        "the quantity; heights are above the origin of the world; speeds are over the two steps around a frame, "
        "and not known in a gap and beside it, where frames are missing too",
    ),
    Column("sigma", "that of `unit`", "its standard deviation; not known of speeds"),
    Column("unit", "", "`deg`, `m/s` or `m`"),
)
_COLUMNS = tuple(column.names for column in KINEMATICS)
MOT = (
    Column("time", "s", "time of the frame"),
    Column("pelvis_tx pelvis_ty pelvis_tz", "m", "the pelvis, y up"),
    Column("<coordinate>", "deg", "a rotation, by the name that it has in OpenSim's models (`knee_angle_l`)"),
)


def check_kinematics_output(path: str | Path, people: Collection[Trajectory] = ()) -> None:
    """Make sure, before any work is done, that save_kinematics will be able to write a file; its folder is made.

    Args:
        path: the file.
        people: who will be in it, where that is known.

    Raises:
        ValueError: the extension is none of EXTENSIONS, or the format cannot hold so many frames.
        ImportError: a C3D file is wanted and ezc3d is not installed.
        OSError: the folder cannot be written into, or what has its name is no plain file.
    """
    path = Path(path)
    extension = path.suffix.lower()
    if extension not in EXTENSIONS:
        raise ValueError(f"{path}: kinematics are written as {', '.join(EXTENSIONS)}, not as {extension or 'nothing'}")
    if extension == ".c3d":
        require_ezc3d()
        for trajectory in people:
            check_frames(trajectory.n_frames, path)
    check_replaceable(path)


def holds_kinematics(path: Path) -> bool:
    """Whether a parquet or C3D file is one of save_kinematics. A damaged one is not."""
    match path.suffix.lower():
        case ".parquet":
            try:
                return _UNITS_KEY in file_metadata(path)
            except (ValueError, OSError):
                return False
        case ".c3d":
            head = first_bytes(path, _HEAD_BYTES)
            return ROTATION_LABEL.encode() in head or b"made by fgpose angles" in head
    return False


def kinematics_paths(path: Path, people: Collection[int]) -> tuple[Path, ...]:
    """The files that save_kinematics writes of people with these numbers: a table, or one for each."""
    return (path,) if path.suffix.lower() in _TABLES else own_paths(path, people)


def save_kinematics(
    people: Mapping[int, Trajectory] | Trajectory,
    path: str | Path,
    world_up: UpChoice | WorldUp = "auto",
    origin: Origin | None = None,
) -> tuple[Path, ...]:
    """Write what follows from trajectories in the format that the extension names.

    .parquet, .csv: one row per person, frame and quantity, with columns time_s, frame, person, kind (angle, speed,
    height), name (left_knee_flexion; the joint, or centre), value, sigma and unit. Joint angles are in degrees, speeds
    in m/s, heights in metres above the world's origin; sigma is null where it is unknown, as it is of speeds.
    .mot: coordinates of OpenSim (kinematics/opensim.py).
    .bvh: segment rotations for animation programs (write_bvh).
    .c3d: the points, and the rotations of the segments beside them (write_c3d).

    Args:
        people: by number, or one.
        path: the file; of several people the formats other than tables have one each, NAME_person1.mot.
        world_up: what is up in the trajectories' world; auto: as the bodies stand, see find_up.
        origin: what they were made from; parquet keeps it, .mot and .c3d which command made them. CSV and BVH have no
            place for it.

    Warns:
        UserWarning: auto found another axis up than z, or is in doubt; or some of several people, who have no body to
            be written, are left out.

    Returns:
        The files. Each appears whole or not at all.

    Raises:
        ValueError: the extension is none of these, there is nobody, or a skeleton determines no angle or segment.
        ImportError: C3D without ezc3d.
        OSError: a file cannot be written.
    """
    path = Path(path)
    check_kinematics_output(path)
    people = {0: people} if isinstance(people, Trajectory) else people
    if not people:
        raise ValueError(f"{path}: there is nobody to be written")
    with naming(path):
        return _write(people, path, resolved_up(people.values(), world_up, path), origin)


def _write(people: Mapping[int, Trajectory], path: Path, world_up: WorldUp, origin: Origin | None) -> tuple[Path, ...]:
    if path.suffix.lower() in _TABLES:
        _write_table(people, path, world_up, origin)
        return (path,)
    made_by = "" if origin is None else origin.maker(path.parent)
    written, without = [], []
    for own_path, trajectory in zip(kinematics_paths(path, people), people.values(), strict=True):
        try:
            _write_one(trajectory, own_path, world_up, made_by)
            written.append(own_path)
        except ValueError as error:
            without.append(error)
    if not written:
        raise without[0]
    for error in without:
        warnings.warn(f"{error}; left out", stacklevel=4)  # past _write, naming and save_kinematics
    return tuple(written)


def _write_one(trajectory: Trajectory, path: Path, world_up: WorldUp, made_by: str) -> None:
    match path.suffix.lower():
        case ".mot":
            write_mot(opensim_coordinates(trajectory, world_up), trajectory.time_s, path, made_by)
        case ".bvh":
            write_bvh(trajectory, path, world_up)
        case ".c3d":
            write_c3d(trajectory, path, world_up, made_by, rotations=True)


def _write_table(people: Mapping[int, Trajectory], path: Path, world_up: WorldUp, origin: Origin | None) -> None:
    import pyarrow as pa

    frames = frame_numbers(people)
    tables = [
        _rows(trajectory.time_s, frames[person], person, _quantities(trajectory, world_up))
        for person, trajectory in people.items()
    ]
    if path.suffix.lower() == ".csv":
        write_csv(path, tables)
        return
    table = pa.concat_tables(tables).unify_dictionaries().combine_chunks()
    known = {} if origin is None else {ORIGIN_KEY: origin_to_json(origin, path.parent)}
    write_table(path, table.replace_schema_metadata({_UNITS_KEY: json.dumps(UNITS)} | known))


def quantities_table(quantities: Quantities) -> pa.Table:
    """The rows of joint angles or of speeds alone, of one person, as in the tables of save_kinematics."""
    kinds = [quantities.kind] * len(quantities.names)
    rows = kinds, [*quantities.names], quantities.value, _sigma(quantities)
    return _rows(quantities.time_s, numbered(quantities), 0, rows)


def _sigma(quantities: Quantities) -> Float[np.ndarray, "frame quantity"]:
    return np.full(quantities.value.shape, np.nan) if quantities.sigma is None else quantities.sigma


def _rows(
    time_s: Float[np.ndarray, " frame"], frame: Int[np.ndarray, " frame"], person: int, quantities: _Quantities
) -> pa.Table:
    import pyarrow as pa

    kinds, labels, value, sigma = quantities
    n_frames, n_quantities = value.shape
    index = np.tile(np.arange(n_quantities, dtype=np.int32), n_frames)
    texts = {"kind": kinds, "name": labels, "unit": [UNITS[kind] for kind in kinds]}
    columns = {
        "time_s": pa.array(np.repeat(np.asarray(time_s, dtype=float), n_quantities)),
        "frame": pa.array(np.repeat(frame.astype(np.int32), n_quantities)),
        "person": pa.array(np.full(n_frames * n_quantities, person, dtype=np.int32)),
    }
    columns |= {name: pa.array(text).take(pa.array(index)).dictionary_encode() for name, text in texts.items()}
    columns |= {"value": nullable(value.ravel()), "sigma": nullable(sigma.ravel())}
    return pa.table({name: columns[name] for name in _COLUMNS})


def _quantities(trajectory: Trajectory, world_up: WorldUp) -> _Quantities:
    """Everything that stands in the table."""
    angles, speeds = joint_angles(trajectory, world_up), joint_speeds(trajectory)
    points_m, up = with_centre_m(trajectory), up_vector(world_up)
    height_sigma_m = np.full(points_m.shape[:2], np.nan)
    if trajectory.covariance_m2 is not None:
        height_sigma_m[:, :-1] = np.sqrt(trajectory.covariance_m2 @ up @ up)
    kinds = [kind for each in (angles, speeds) for kind in [each.kind] * len(each.names)]
    names = [*angles.names, *speeds.names, *speeds.names]
    value = [angles.value, speeds.value, heights_m(points_m, world_up)]
    sigma = [_sigma(angles), _sigma(speeds), height_sigma_m]
    kinds += ["height"] * len(speeds.names)
    return kinds, names, np.concatenate(value, axis=1), np.concatenate(sigma, axis=1)


def load_angles(path: str | Path) -> dict[int, JointAngles]:
    """The joint angles of everybody in a .parquet file of save_kinematics, by the number of the person.

    Raises:
        ValueError: the file is something else, or rows are missing; the message names it.
        OSError: it cannot be read.
    """
    path = Path(path)
    try:
        table = read_table(path)
        if _UNITS_KEY not in metadata(table):
            raise ValueError("it was not written by save_kinematics, or lost its metadata since")
        kinds, kind = names(table, "kind")
        is_angle = np.array([each == "angle" for each in kinds], dtype=bool)[kind]
        table = table.filter(is_angle)
        person = whole_numbers(numbers(table, "person"), "person")
        return {int(who): _angles_of(table.filter(person == who)) for who in dict.fromkeys(person.tolist())}
    except ValueError as error:
        raise ValueError(f"{path}: not readable joint angles: {error}") from None


def _angles_of(table: pa.Table) -> JointAngles:
    labels, label = names(table, "name")
    n_frames = table.num_rows // len(labels)
    if not np.array_equal(label, np.tile(np.arange(len(labels)), n_frames)):
        raise ValueError("rows are missing or in another order: each frame must hold every angle once")

    def column(name: str) -> Float[np.ndarray, "frame angle"]:
        return numbers(table, name).reshape(n_frames, len(labels)).copy()

    frame = whole_numbers(column("frame")[:, 0], "frame")
    return JointAngles(labels, column("time_s")[:, 0], column("value"), column("sigma"), frame)


def write_mot(
    coordinates: Mapping[str, Float[np.ndarray, " frame"]], time_s: np.ndarray, path: Path, made_by: str = ""
) -> None:
    """Write coordinates with the header of OpenSim 4: angles in degrees, lengths in metres. made_by: see Origin.maker;
    it is said there too.

    OpenSim's Storage, with which its GUI opens motions, stops reading at the first value that is no number. So values
    are interpolated in time where they are NaN, at the ends the nearest one is held, and coordinates that are never
    known are left out: a model keeps its own value of those.

    Raises:
        ValueError: no coordinate is known in any frame.
        OSError: the file cannot be written.
    """
    known = {name: values for name, values in coordinates.items() if np.isfinite(values).any()}
    if not known:
        raise ValueError(f"{path}: no coordinate is known in any frame: there is no motion to be written")
    time_s = np.asarray(time_s, dtype=float)
    table = np.column_stack([time_s, *(_without_gaps(values, time_s) for values in known.values())])
    header = ["Coordinates", "version=1", f"nRows={len(table)}", f"nColumns={table.shape[1]}", "inDegrees=yes", ""]
    header += ["Units are S.I. units (second, meters, Newtons, ...)", "Angles are in degrees.", ""]
    header += [*([one_line(f"made by fgpose {made_by}"), ""] if made_by else []), "endheader"]
    # Tabs, and numbers as short as they read back the same.
    rows = ["\t".join(map(repr, row)) for row in table.tolist()]
    write_text(path, "\n".join([*header, "\t".join(["time", *known]), *rows]) + "\n")


def _without_gaps(values: Float[np.ndarray, " frame"], time_s: Float[np.ndarray, " frame"]) -> np.ndarray:
    """Interpolated the shorter way round a circle of 360; lengths in metres are far from one."""
    known = np.isfinite(values)
    found = values[known]
    unwrapped = np.unwrap(found, period=360.0)
    last_found = np.maximum(np.cumsum(known) - 1, 0)
    between = np.interp(time_s, time_s[known], unwrapped) - (unwrapped - found)[last_found]
    return np.where(known, values, between)


if TYPE_CHECKING:
    import pyarrow as pa
