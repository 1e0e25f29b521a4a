"""Result files of one person or several: one function that writes and one that reads, whatever the format."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from fgpose.geometry.camera import CameraRig
from fgpose.geometry.up_axis import UpAxis, UpChoice, WorldUp, from_z_up, z_up, z_up_R_world
from fgpose.io.atomic import check_replaceable, replacing
from fgpose.io.c3d import read_c3d, require_ezc3d, write_c3d
from fgpose.io.content import first_bytes
from fgpose.io.folders import own_paths
from fgpose.io.formats import trajectory_formats
from fgpose.io.npz import read_npz, write_npz
from fgpose.io.origin import Origin
from fgpose.io.parquet import read_origin, read_parquet, write_parquet
from fgpose.io.trc import read_trc, write_trc
from fgpose.io.upright import resolved_up
from fgpose.observations import is_infinite
from fgpose.plain_files import naming
from fgpose.sampling import TIME_ROUNDING_S, nearest
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status, Trajectory

EXTENSIONS = (".parquet", ".npz", ".trc", ".c3d")
"""What save_trajectory writes, those that keep most first. Other packages may add formats (fgpose.io.formats)."""


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
    """Write a trajectory in the format that the extension names: .parquet, .npz, .trc or .c3d.

    Parquet and npz keep everything; TRC and C3D keep positions alone (see write_parquet, write_npz, write_trc,
    write_c3d). The file appears whole or not at all; a missing folder is made.

    Args:
        world_up: what is up in the trajectory's world, for TRC (which has y up) and C3D: an axis, or a direction.
            auto: as the body and the cameras of the origin stand, see find_up; z where nothing speaks against it.
        origin: what it was made from; parquet keeps it, the others which command made it.

    Warns:
        UserWarning: auto found another axis up than z, or is in doubt; it says why.

    Raises:
        ValueError: the extension is none of these, or the format cannot hold the trajectory.
        ImportError: C3D without ezc3d.
        OSError: the file cannot be written.
    """
    _write({0: trajectory}, {0: np.arange(trajectory.n_frames)}, Path(path), world_up, origin)


def _write(
    people: Mapping[int, Trajectory],
    frames: Mapping[int, Int[np.ndarray, " own_frame"]],
    path: Path,
    world_up: UpChoice | WorldUp,
    origin: Origin | None,
) -> tuple[Path, ...]:
    extension, made_by = _extension(path), "" if origin is None else origin.step
    if extension == ".parquet":
        write_parquet(people, frames, path, origin)
        return (path,)
    up = resolved_up(people.values(), world_up, path, origin and origin.rig) if extension in (".trc", ".c3d") else "z"
    paths = people_paths(path, people)
    for own_path, trajectory in zip(paths, people.values(), strict=True):
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
    """Write the trajectories of people as save_trajectory that of one: one table as .parquet; .npz, .trc or .c3d for
    each, NAME_person1.trc, where there are several.

    The table is that of one person (write_parquet), with the number of each in the column person. Frame numbers are
    those of the recording: the place of a time among all times.

    Args:
        trajectories: by the number of the person, from 0.
        path: NAME with its extension.
        world_up: see save_trajectory; auto: as all of them stand.
        time_s: of all frames of the recording, increasing, seconds; by default those at which somebody is there.
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
    if _extension(path) != ".parquet":
        check_output(path)
        return _write(trajectories, {}, path, world_up, origin)
    with naming(path):
        return _write(trajectories, _frame_numbers(trajectories, time_s), path, world_up, origin)


def people_paths(path: str | Path, people: Collection[int] = ()) -> tuple[Path, ...]:
    """The files that save_people writes: a .parquet itself, whoever is in it; of the other formats one for each person,
    named after its number where there are several.

    Raises:
        ValueError: the extension is none of EXTENSIONS.
    """
    path = Path(path)
    return (path,) if _extension(path) == ".parquet" else own_paths(path, people)


def _frame_numbers(
    people: Mapping[int, Trajectory], time_s: Float[np.ndarray, " frame"] | None
) -> dict[int, Int[np.ndarray, " own_frame"]]:
    for person, trajectory in people.items():
        if not trajectory.n_frames or not _increases(trajectory.time_s):
            raise ValueError(f"person {person} must have frames whose time_s increases")
    all_s = np.unique(np.concatenate([each.time_s for each in people.values()])) if time_s is None else time_s
    if not len(all_s) or not _increases(all_s):
        raise ValueError("time_s of the recording must increase")
    frames = {person: nearest(trajectory.time_s, all_s) for person, trajectory in people.items()}
    for person, frame in frames.items():
        own_s = people[person].time_s
        # Two ways to take the mean over the clocks of cameras differ in their last digits.
        other = (np.abs(all_s[frame] - own_s) > TIME_ROUNDING_S) | (np.diff(frame, prepend=-1) == 0)
        if other.any():
            raise ValueError(f"person {person} has a frame at {own_s[other][0]:.6g} s, the recording has none then")
    return frames


def _increases(time_s: Float[np.ndarray, " frame"]) -> bool:
    return bool(np.isfinite(time_s).all() and (np.diff(time_s) > 0).all())


def load_trajectory(
    path: str | Path, skeleton: Skeleton | None = None, world_up: WorldUp = "z", file_up: UpChoice | WorldUp = "auto"
) -> Trajectory:
    """Read a trajectory that save_trajectory wrote, or anyone's TRC or C3D file; the content says which.

    Args:
        path: the file.
        skeleton: wanted joints and their order, by name. Joints that the file lacks are NaN and unobservable; the
            file's others are left out. By default the file's own: of TRC and C3D its markers, without bones.
        world_up: what is up in the world wanted, for TRC and C3D.
        file_up: what is up in the file, for TRC and C3D. auto: as its format says (y in TRC; what Y_SCREEN says in C3D,
            else z), unless the body stands along another axis.

    Warns:
        UserWarning: auto found another axis up than the format says, or is in doubt; it says why.

    Raises:
        ValueError: the file is empty, damaged or of another kind, holds several people, or has no joint of the
            skeleton; the message names the file.
        ImportError: C3D without ezc3d.
        OSError: the file cannot be read.
    """
    people = load_people_trajectories(path, skeleton, world_up, file_up)
    if len(people) > 1:
        raise ValueError(
            f"{path}: one trajectory is needed, the file holds those of people {', '.join(map(str, people))}; "
            "load_people_trajectories reads them all"
        )
    return next(iter(people.values()))


def load_people_trajectories(
    path: str | Path, skeleton: Skeleton | None = None, world_up: WorldUp = "z", file_up: UpChoice | WorldUp = "auto"
) -> dict[int, Trajectory]:
    """Read everybody in a table of save_people, by number, in the order of the file; or a file of one person.

    Who is alone in a file is person 0 if it does not say. Arguments and errors as of load_trajectory.
    """
    path = Path(path)
    kind = _kind(path)
    with naming(path, f"not a readable {kind} trajectory"):
        people = _read(path, kind, world_up, file_up)
        for trajectory in people.values():
            _check(trajectory)
        if skeleton is None:
            return people
        return {person: _in_order_of(skeleton, trajectory) for person, trajectory in people.items()}


def load_origin(path: str | Path) -> Origin | None:
    """What a result was made from; None where its file does not say, as all but parquet.

    Raises:
        ValueError: what it says is damaged; the message names the file.
        OSError: the file cannot be read.
    """
    path = Path(path)
    if _kind(path) != "parquet":
        return None
    with naming(path):
        return read_origin(path)


def load_upright(
    path: str | Path, world_up: UpChoice | WorldUp = "auto", rig: CameraRig | None = None
) -> tuple[dict[int, Trajectory], Float[np.ndarray, "3 3"]]:
    """Everybody in a file, in a world with z up, and the rotation that takes the cameras there.

    Args:
        path: the file.
        world_up: what is up in the world of the file, or of the cameras. auto: as its format says, unless bodies (and
            cameras) stand otherwise.
        rig: the cameras that saw the people; by default those that the file knows.

    Warns:
        UserWarning: auto found another axis up than the format says, or is in doubt; it says why.

    Raises as load_people_trajectories.
    """
    path = Path(path)
    kind = _kind(path)
    if kind in _MARKER_FILES:
        if rig is None:
            return load_people_trajectories(path, file_up=world_up), np.eye(3)
        # Such files have axes of their own, to which the world of the cameras was turned.
        return load_people_trajectories(path), z_up_R_world(resolved_up((), world_up, path, rig))
    people, origin = load_people_trajectories(path), load_origin(path)
    rotation = z_up_R_world(resolved_up(people.values(), world_up, path, rig or (origin and origin.rig)))
    if np.array_equal(rotation, np.eye(3)):
        return people, rotation
    return {person: each.turned(rotation) for person, each in people.items()}, rotation


_MARKER_FILES = ("TRC", "C3D")


def _read(path: Path, kind: str, world_up: WorldUp, file_up: UpChoice | WorldUp) -> dict[int, Trajectory]:
    match kind:
        case "parquet":
            return read_parquet(path)
        case "npz":
            return {0: read_npz(path)}
        case "TRC":
            return {0: _turned(path, read_trc(path), "+y", world_up, file_up)}
        case "C3D":
            return {0: _turned(path, *read_c3d(path), world_up, file_up)}
        case _:
            return {0: trajectory_formats()[kind].read(path)}


def _turned(
    path: Path, markers: Trajectory, usual: UpAxis, world_up: WorldUp, file_up: UpChoice | WorldUp
) -> Trajectory:
    """Markers of a file in the world wanted."""
    up = resolved_up([markers], file_up, path, usual=usual)
    return replace(markers, positions_m=from_z_up(z_up(markers.positions_m, up), world_up))


def _kind(path: Path) -> str:
    start = first_bytes(path, 16)
    if not start:
        raise ValueError(f"{path}: the file is empty")
    if start.startswith(b"PAR1"):
        return "parquet"
    if start.startswith(b"PK\x03\x04"):
        return "npz"
    if start.removeprefix(b"\xef\xbb\xbf").startswith(b"PathFileType"):
        return "TRC"
    # The first byte of a C3D file says where its parameters begin, the second is always 0x50.
    if path.suffix.lower() == ".c3d" and start[1:2] == b"\x50":
        return "C3D"
    if (extension := path.suffix.lower()) in trajectory_formats():
        return extension
    raise ValueError(f"{path}: not a trajectory: its content is none of parquet, npz, TRC, C3D")


def _check(trajectory: Trajectory) -> None:
    bad = np.flatnonzero(~np.isfinite(trajectory.time_s))
    if bad.size:
        raise ValueError(f"the time of frame {bad[0]} is {trajectory.time_s[bad[0]]}")
    earlier = np.flatnonzero(np.diff(trajectory.time_s) <= 0)
    if earlier.size:
        at, before = earlier[0] + 1, earlier[0]
        own_s = trajectory.time_s
        raise ValueError(f"its times do not increase: frame {at} is at {own_s[at]:.13g} s after {own_s[before]:.13g} s")
    infinite = np.argwhere(is_infinite(trajectory.positions_m).any(axis=-1))
    if len(infinite):
        frame, joint = infinite[0]
        raise ValueError(f"the position of joint {trajectory.skeleton.joints[joint]} is infinite in frame {frame}")


def _in_order_of(skeleton: Skeleton, trajectory: Trajectory) -> Trajectory:
    if skeleton == trajectory.skeleton:
        return trajectory
    joints = trajectory.skeleton.joints
    source = np.array([joints.index(joint) if joint in joints else -1 for joint in skeleton.joints])
    if np.all(source < 0):
        raise ValueError(f"no joint of skeleton {skeleton.name} is in the file, which has {', '.join(joints)}")

    def arranged(values: np.ndarray, axis: int, fill: float | int) -> np.ndarray:
        result = np.take(values, source, axis)
        np.moveaxis(result, axis, 0)[source < 0] = fill
        return result

    def arranged_if_known(values: np.ndarray | None, axis: int) -> np.ndarray | None:
        return None if values is None else arranged(values, axis, np.nan)

    return replace(
        trajectory,
        skeleton=skeleton,
        positions_m=arranged(trajectory.positions_m, 1, np.nan),
        status=arranged(trajectory.status, 1, Status.UNOBSERVABLE),
        covariance_m2=arranged_if_known(trajectory.covariance_m2, 1),
        residual_px=arranged_if_known(trajectory.residual_px, 2),
        visibility=arranged_if_known(trajectory.visibility, 2),
        # Lengths belong to the bones of the file's skeleton.
        bone_lengths_m=None,
    )
