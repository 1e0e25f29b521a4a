"""Writing of result files: one function for all formats, named by the extension."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from fgpose.geometry.up_axis import UpChoice, WorldUp
from fgpose.io.atomic import check_replaceable, replacing
from fgpose.io.formats import trajectory_formats
from fgpose.io.names import own_paths
from fgpose.io.origin import Origin
from fgpose.io.tables import write_csv
from fgpose.io.trajectories.c3d import require_ezc3d, write_c3d
from fgpose.io.trajectories.npz import write_npz
from fgpose.io.trajectories.parquet import write_parquet
from fgpose.io.trajectories.result_table import frame_numbers, numbered, result_tables
from fgpose.io.trajectories.trc import write_trc
from fgpose.io.trajectories.upright import resolved_up
from fgpose.plain_files import naming
from fgpose.shown.wrong_types import check_type
from fgpose.trajectory import Trajectory

EXTENSIONS = (".parquet", ".npz", ".csv", ".trc", ".c3d")
"""What save_trajectory writes, those that keep most first. Other packages may add formats (fgpose.io.formats)."""
_TABLES = (".parquet", ".csv")
"""Those that hold several people."""


def check_output(path: str | Path) -> None:
    """Make sure, before any work is done, that save_trajectory will be able to write a file; its folder is made.

    Raises:
        ValueError: the extension is none of EXTENSIONS.
        ImportError: a C3D file is wanted and ezc3d is not installed.
        OSError: the folder cannot be written into, or what has its name is no plain file.
    """
    if _extension(Path(path)) == ".c3d":
        require_ezc3d()
    check_replaceable(path)


def save_trajectory(
    trajectory: Trajectory, path: str | Path, world_up: UpChoice | WorldUp = "auto", origin: Origin | None = None
) -> None:
    """Write a trajectory in the format that the extension names: .parquet, .npz, .csv, .trc or .c3d.

    Parquet and npz keep everything; CSV has the table of parquet, without what it says of skeleton and origin, and is
    not read; TRC and C3D keep positions alone (see write_parquet, write_npz, write_trc, write_c3d). The file appears
    whole or not at all; a missing folder is made.

    Args:
        world_up: what is up in the trajectory's world, for TRC (which has y up) and C3D: an axis, or a direction.
            auto: as the body and the cameras of the origin stand, see find_up; z where nothing speaks against it.
        origin: what it was made from; parquet keeps it, the others which command made it.

    Warns:
        UserWarning: auto found another axis up than z, or is in doubt; it says why.

    Raises:
        TypeError: it is no trajectory.
        ValueError: the extension is none of these, or the format cannot hold the trajectory.
        ImportError: C3D without ezc3d.
        OSError: the file cannot be written.
    """
    check_type("save_trajectory", "trajectory", trajectory, Trajectory)
    _write({0: trajectory}, {0: numbered(trajectory)}, Path(path), world_up, origin)


def _write(
    people: Mapping[int, Trajectory],
    frames: Mapping[int, Int[np.ndarray, " own_frame"]],
    path: Path,
    world_up: UpChoice | WorldUp,
    origin: Origin | None,
) -> tuple[Path, ...]:
    extension, made_by = _extension(path), "" if origin is None else origin.maker(path.parent)
    if extension == ".parquet":
        write_parquet(people, frames, path, origin)
        return (path,)
    if extension == ".csv":
        write_csv(path, result_tables(people, frames))
        return (path,)
    rig = None if origin is None else origin.rig
    up = resolved_up(people.values(), world_up, path, rig) if extension in (".trc", ".c3d") else "z"
    paths = people_paths(path, people)
    numbered_people = [replace(each, frame_numbers=frames[person]) for person, each in people.items()]
    for own_path, trajectory in zip(paths, numbered_people, strict=True):
        match extension:
            case ".npz":
                write_npz(trajectory, own_path, made_by)
            case ".trc":
                write_trc(trajectory, own_path, up, made_by)
            case ".c3d":
                write_c3d(trajectory, own_path, up, made_by=made_by)
            case _:
                others = trajectory_formats()[extension]
                with replacing(own_path, others.check) as temporary:
                    others.write(trajectory, temporary)
    return paths


def _extension(path: Path) -> str:
    extension = path.suffix.lower()
    if extension not in EXTENSIONS and extension not in (others := trajectory_formats()):
        known = ", ".join((*EXTENSIONS, *others))
        raise ValueError(f"{path}: a trajectory is written as {known}, not as {extension or 'nothing'}")
    return extension


def save_people(
    trajectories: Mapping[int, Trajectory],
    path: str | Path,
    world_up: UpChoice | WorldUp = "auto",
    time_s: Float[np.ndarray, " frame"] | None = None,
    origin: Origin | None = None,
) -> tuple[Path, ...]:
    """Write the trajectories of people as save_trajectory that of one: one table as .parquet or .csv; a .npz, .trc or
    .c3d for each, NAME_person1.trc, where there are several.

    The table is that of one person (write_parquet), with the number of each in the column person. Frame numbers, which
    npz and TRC have too, are those of the recording: the place of a time among all times.

    Args:
        trajectories: by the number of the person, from 0.
        path: NAME with its extension.
        world_up: see save_trajectory; auto: as all of them stand.
        time_s: of all frames of the recording, increasing, seconds; by default frames have the numbers that everybody's
            trajectory knows (frame_numbers) or, where one does not, count those at which somebody is there.
        origin: see save_trajectory.

    Returns:
        The files (see people_paths). Each appears whole or not at all.

    Raises:
        ValueError: there is nobody, somebody has no frame or one that is not the recording's, people of a table differ
            in skeleton, cameras or in what is known of them; or as save_trajectory.
        ImportError: C3D without ezc3d.
        OSError: a file cannot be written.
    """
    path = Path(path)
    if not trajectories or min(trajectories) < 0:
        raise ValueError(
            f"{path}: people with numbers from 0 are needed, got {', '.join(map(str, trajectories)) or 'nobody'}"
        )
    if _extension(path) not in _TABLES:
        check_output(path)
    with naming(path):
        return _write(trajectories, frame_numbers(trajectories, time_s), path, world_up, origin)


def people_paths(path: str | Path, people: Collection[int] = ()) -> tuple[Path, ...]:
    """The files that save_people writes: a table itself, whoever is in it; of the other formats one for each person,
    named after its number where there are several.

    Raises:
        ValueError: the extension is none of EXTENSIONS.
    """
    path = Path(path)
    return (path,) if _extension(path) in _TABLES else own_paths(path, people)
