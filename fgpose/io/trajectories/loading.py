"""Reading of result files: one function for all formats, told apart by their content."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import CameraRig
from fgpose.geometry.up_axis import UpAxis, UpChoice, WorldUp, from_z_up, z_up, z_up_R_world
from fgpose.io.content import first_bytes
from fgpose.io.formats import trajectory_formats
from fgpose.io.mistaken import refuse_keypoints
from fgpose.io.origin import Origin
from fgpose.io.skeletons import as_skeleton
from fgpose.io.trajectories.c3d import read_c3d
from fgpose.io.trajectories.npz import read_npz
from fgpose.io.trajectories.parquet import read_origin, read_parquet
from fgpose.io.trajectories.trc import read_trc
from fgpose.io.trajectories.upright import doubt_given_up, resolved_up
from fgpose.observations import is_infinite
from fgpose.plain_files import naming
from fgpose.shown.joint_meanings import found_among
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status, Trajectory


def load_trajectory(
    path: str | Path,
    skeleton: Skeleton | str | None = None,
    world_up: WorldUp = "z",
    file_up: UpChoice | WorldUp = "auto",
) -> Trajectory:
    """Read a trajectory that save_trajectory wrote, or anyone's TRC or C3D file; the content says which.

    Args:
        path: the file.
        skeleton: wanted joints and their order, or the name of a skeleton. They are found by what their names mean
            (RHip is right_hip). Joints that the file lacks are NaN and unobservable; the file's others are left out. By
            default the file's own: of TRC and C3D its markers, without bones.
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
    path: str | Path,
    skeleton: Skeleton | str | None = None,
    world_up: WorldUp = "z",
    file_up: UpChoice | WorldUp = "auto",
) -> dict[int, Trajectory]:
    """Read everybody in a table of save_people, by number, in the order of the file; or a file of one person.

    Who is alone in a file is person 0 if it does not say. Arguments and errors as of load_trajectory.
    """
    path, wanted = Path(path), None if skeleton is None else as_skeleton(skeleton)
    kind = _kind(path)
    with naming(path, f"not a readable {kind} trajectory"):
        people = _read(path, kind, world_up, file_up)
        for trajectory in people.values():
            _check(trajectory)
        if wanted is None:
            return people
        return {person: _in_order_of(wanted, trajectory) for person, trajectory in people.items()}


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
    path: str | Path,
    world_up: UpChoice | WorldUp = "auto",
    rig: CameraRig | None = None,
    option: str = "--world-up",
) -> tuple[dict[int, Trajectory], Float[np.ndarray, "3 3"]]:
    """Everybody in a file, in a world with z up, and the rotation that takes the cameras there.

    Args:
        path: the file.
        world_up: what is up in the world of the file, or of the cameras. auto: as its format says, unless bodies (and
            cameras) stand otherwise.
        rig: the cameras that saw the people; by default those that the file knows.
        option: with which the user says world_up.

    Warns:
        UserWarning: auto found another axis up than the format says, or is in doubt; or bodies (and cameras) contradict
            what is given. It says why.

    Raises as load_people_trajectories.
    """
    path = Path(path)
    kind = _kind(path)
    if kind in _MARKER_FILES:
        if rig is None:
            people = load_people_trajectories(path, file_up=world_up)
            if world_up != "auto":
                # In the axes of the file, which the user names.
                own = (each.turned(z_up_R_world(world_up).T) for each in people.values())
                doubt_given_up(own, world_up, path, option=option)
            return people, np.eye(3)
        # Such files have axes of their own, to which the world of the cameras was turned.
        return load_people_trajectories(path), z_up_R_world(resolved_up((), world_up, path, rig))
    people, origin = load_people_trajectories(path), load_origin(path)
    rig = rig or (None if origin is None else origin.rig)
    if world_up != "auto":
        doubt_given_up(people.values(), world_up, path, rig, option)
    rotation = z_up_R_world(resolved_up(people.values(), world_up, path, rig))
    if np.array_equal(rotation, np.eye(3)):
        return people, rotation
    return {person: each.turned(rotation) for person, each in people.items()}, rotation


READABLE = (".parquet", ".npz", ".trc", ".c3d")
"""Extensions of what fgpose writes that load_trajectory reads, those that keep most first."""
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
    refuse_keypoints(path)
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
    source = found_among(skeleton.joints, joints)
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
        bone_length_sigma_m=None,
    )
