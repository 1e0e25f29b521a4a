"""Result files: one function that writes and one that reads, whatever the format."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from fgpose.io.atomic import check_writable
from fgpose.io.c3d import read_c3d, require_ezc3d, write_c3d
from fgpose.io.content import first_bytes
from fgpose.io.markers import UpAxis
from fgpose.io.npz import read_npz, write_npz
from fgpose.io.parquet import read_parquet, write_parquet
from fgpose.io.trc import read_trc, write_trc
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status, Trajectory

EXTENSIONS = (".parquet", ".npz", ".trc", ".c3d")
"""What save_trajectory writes."""


def check_output(path: str | Path) -> None:
    """Make sure, before any work is done, that save_trajectory will be able to write a file; its folder is made.

    Raises:
        ValueError: the extension is none of EXTENSIONS.
        ImportError: a C3D file is wanted and ezc3d is not installed.
        OSError: the folder cannot be written into.
    """
    if _extension(Path(path)) == ".c3d":
        require_ezc3d()
    check_writable(Path(path).parent)


def save_trajectory(trajectory: Trajectory, path: str | Path, world_up: UpAxis = "z") -> None:
    """Write a trajectory in the format that the extension names: .parquet, .npz, .trc or .c3d.

    Parquet and npz keep everything; TRC and C3D keep positions alone (see write_parquet, write_npz, write_trc,
    write_c3d). The file appears whole or not at all; a missing folder is made.

    Args:
        world_up: which axis of the trajectory's world points up, for TRC (which has y up) and C3D.

    Raises:
        ValueError: the extension is none of these, or the format cannot hold the trajectory.
        ImportError: C3D without ezc3d.
        OSError: the file cannot be written.
    """
    path = Path(path)
    match _extension(path):
        case ".parquet":
            write_parquet(trajectory, path)
        case ".npz":
            write_npz(trajectory, path)
        case ".trc":
            write_trc(trajectory, path, world_up)
        case ".c3d":
            write_c3d(trajectory, path, world_up)


def _extension(path: Path) -> str:
    extension = path.suffix.lower()
    if extension not in EXTENSIONS:
        raise ValueError(f"{path}: a trajectory is written as {', '.join(EXTENSIONS)}, not as {extension or 'nothing'}")
    return extension


def load_trajectory(path: str | Path, skeleton: Skeleton | None = None, world_up: UpAxis = "z") -> Trajectory:
    """Read a trajectory that save_trajectory wrote, or anyone's TRC or C3D file; the content says which.

    Args:
        skeleton: wanted joints and their order, by name. Joints that the file lacks are NaN and unobservable; the
            file's others are left out. By default the file's own: of TRC and C3D its markers, without bones.
        world_up: which axis points up in the world wanted, for TRC and C3D.

    Raises:
        ValueError: the file is empty, damaged or of another kind, or has no joint of the skeleton; the message names
            the file.
        ImportError: C3D without ezc3d.
        OSError: the file cannot be read.
    """
    path = Path(path)
    kind = _kind(path)
    try:
        match kind:
            case "parquet":
                trajectory = read_parquet(path)
            case "npz":
                trajectory = read_npz(path)
            case "TRC":
                trajectory = read_trc(path, world_up)
            case _:
                trajectory = read_c3d(path, world_up)
        _check_finite(trajectory)
        return trajectory if skeleton is None else _in_order_of(skeleton, trajectory)
    except ValueError as error:
        raise ValueError(f"{path}: not a readable {kind} trajectory: {error}") from None


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
    raise ValueError(f"{path}: not a trajectory: its content is none of parquet, npz, TRC, C3D")


def _check_finite(trajectory: Trajectory) -> None:
    bad = np.flatnonzero(~np.isfinite(trajectory.time_s))
    if bad.size:
        raise ValueError(f"the time of frame {bad[0]} is {trajectory.time_s[bad[0]]}")
    infinite = np.argwhere(np.isinf(trajectory.positions_m).any(axis=-1))
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
