"""C3D, the binary marker file of motion capture laboratories, by way of ezc3d."""

from __future__ import annotations

import warnings
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from fgpose.geometry.up_axis import SIGNED_AXES, UpAxis, WorldUp, nearest_axis, z_up, z_up_R_world
from fgpose.io.arrays import checked, texts
from fgpose.io.atomic import Check, replacing
from fgpose.io.trajectories.c3d_points import BLOCK_BYTES, START_OFFSET, C3dSize, check_size, read_points
from fgpose.io.trajectories.markers import (
    constant_rate_hz,
    in_whole_frames,
    markers_to_trajectory,
    warn_of_uneven_times,
    without_subject,
    without_zeros,
)
from fgpose.kinematics.poses import SegmentPoses, segment_poses
from fgpose.shown.joint_meanings import marker_names
from fgpose.trajectory import Trajectory

_UNITS_PER_METRE = {"m": 1.0, "mm": 1000.0}
# The header counts frames in 16 bits; ezc3d writes longer files without complaint and reads back their beginning only.
_MAX_FRAMES = 65535
_NOTICED_S = 1e-3  # of its start: less is below the exposure of an image
ROTATION_LABEL = "_4X4"
"""The end of the names of rotations, as Visual3D has it."""
_ROTATION_BYTES = 17 * 4  # a 4x4 matrix and its reliability, 32 bit each
_POINT_BYTES = 4 * 4  # x, y, z and residual
# ROTATION:DATA_START is the block in which they begin, a signed number of 16 bits. Before them are the header, at most
# 255 blocks of parameters, and the points.
_MOST_POINT_BYTES = (32767 - 1 - 255 - 1) * BLOCK_BYTES
_SCREEN = {"+z": ("+X", "+Z"), "+y": ("+Z", "+Y")}


def require_ezc3d() -> ModuleType:
    """The module ezc3d. Raises ImportError that says how to install it."""
    try:
        import ezc3d
    except ImportError:
        raise ImportError('C3D files need ezc3d: pip install "fgpose[c3d]"') from None
    return ezc3d


def write_c3d(
    trajectory: Trajectory,
    path: Path,
    world_up: WorldUp = "z",
    made_by: str = "",
    *,
    rotations: bool = False,
) -> None:
    """Write positions in millimetres (32 bit); gaps are NaN with residual -1. World axes are unchanged where z or y is
    up, and else turned so that z is: few programs heed an axis that points down.

    Markers have marker_names (RHip). X_SCREEN and Y_SCREEN tell viewers which way is up. A C3D
    file has no times, only a rate and the number of its first frame. The rate is that of the whole recording without
    gaps (1 for a single frame); frames that are missing are written as gaps of all points; a UserWarning is given where
    the true times differ noticeably from what this implies. What the number cannot tell of the start, as the rest of a
    frame, or all of it where it is before 0 or beyond 65535 frames, stands in POINT:START_OFFSET_S, which read_c3d
    adds.

    Args:
        trajectory: of one person.
        path: the file.
        world_up: what is up in its world.
        made_by: see Origin.maker; it is then said in MANUFACTURER:SOFTWARE.
        rotations: whether those of its segments stand in the group ROTATION, named as Visual3D does (left_thigh_4X4):
            4x4 matrices that take the segment's axes (x forward, y up, z to the right) and origin (in millimetres) to
            the world. NaN where a rotation is not determined.

    Warns:
        UserWarning: times differ as above; or there are no rotations, for C3D cannot tell where they begin behind so
            many points (16.6 MB: 40,000 frames of 26 joints, 7,800 of 133).

    Raises:
        ImportError: ezc3d is not installed.
        ValueError: there is no frame or more than 65535, the times do not increase, or a skeleton without hips or
            shoulders has no rotations.
        OSError: the file cannot be written.
    """
    ezc3d = require_ezc3d()
    check_frames(trajectory.n_frames, path)
    rate_hz = constant_rate_hz(trajectory.time_s)
    trajectory = in_whole_frames(trajectory, rate_hz, _MAX_FRAMES)
    warn_of_uneven_times(trajectory.time_s, rate_hz, path, "C3D")
    kept = isinstance(world_up, str) and nearest_axis(world_up) in _SCREEN
    file_up: WorldUp = world_up if kept else "z"
    file = ezc3d.c3d()
    points, known = _points(trajectory.positions_m if kept else z_up(trajectory.positions_m, world_up))
    file["data"]["points"] = points
    file["data"]["meta_points"]["residuals"] = np.where(known, 0.0, -1.0)[None]
    first, offset_s = _start(trajectory.time_s, rate_hz, path)
    file["header"]["points"]["first_frame"] = first
    file.add_parameter("POINT", START_OFFSET, _in_single_precision(offset_s))
    _describe(file, trajectory.skeleton.joints, rate_hz, file_up)
    if made_by:
        file.add_parameter("MANUFACTURER", "SOFTWARE", f"made by fgpose {made_by}")
    poses = segment_poses(trajectory, world_up) if rotations and not _are_too_far(trajectory, path) else None
    if poses is not None:
        _add_rotations(file, poses, rate_hz, file_up)
    with replacing(path, _holds(trajectory, len(poses.segments) if poses else 0)) as temporary:
        file.write(str(temporary))


def check_frames(n_frames: int, path: Path) -> None:
    """Raise ValueError that names the file if it cannot hold so many."""
    if not n_frames:
        raise ValueError(f"{path}: C3D holds at least one frame, this has none; use parquet, npz or TRC")
    if n_frames > _MAX_FRAMES:
        raise ValueError(f"{path}: C3D holds at most {_MAX_FRAMES} frames, this is {n_frames}; use TRC")


def _describe(file: Any, joints: tuple[str, ...], rate_hz: float, file_up: WorldUp) -> None:
    """Fill the group POINT."""
    parameters = file["parameters"]["POINT"]
    parameters["RATE"]["value"] = [rate_hz]
    parameters["UNITS"]["value"] = ["mm"]
    parameters["LABELS"]["value"] = list(marker_names(joints))
    for name, axis in zip(("X_SCREEN", "Y_SCREEN"), _SCREEN[nearest_axis(file_up)], strict=True):
        file.add_parameter("POINT", name, axis)


def _add_rotations(file: Any, poses: SegmentPoses, rate_hz: float, file_up: WorldUp) -> None:
    file["data"]["rotations"] = _rotations(poses, file_up)
    file.add_parameter("ROTATION", "LABELS", [f"{segment.name}{ROTATION_LABEL}" for segment in poses.segments])
    file.add_parameter("ROTATION", "RATE", [rate_hz])


def _points(
    positions_m: Float[np.ndarray, "frame joint 3"],
) -> tuple[Float[np.ndarray, "4 joint frame"], Bool[np.ndarray, "joint frame"]]:
    """In millimetres, homogeneous, NaN in gaps; and where there is none."""
    known = np.asarray(np.isfinite(positions_m).all(axis=-1))
    points = np.ones((4, *positions_m.shape[1::-1]))
    points[:3] = np.where(known[..., None], positions_m, np.nan).transpose(2, 1, 0) * 1000.0
    return points, known.T


def _are_too_far(trajectory: Trajectory, path: Path) -> bool:
    """Whether rotations begin behind so many points that the file cannot tell where; then it is said."""
    n_bytes = trajectory.n_frames * trajectory.skeleton.n_joints * _POINT_BYTES
    if n_bytes <= _MOST_POINT_BYTES:
        return False
    warnings.warn(
        f"{path}: it has points and no rotations: C3D holds none behind more than {_MOST_POINT_BYTES / 1e6:.1f} MB of "
        f"points, these are {n_bytes / 1e6:.1f} MB. Write fewer frames at once, or .bvh, .mot or .parquet",
        UserWarning,
        stacklevel=3,
    )
    return True


def _rotations(poses: SegmentPoses, file_up: WorldUp) -> Float[np.ndarray, "4 4 segment frame"]:
    matrices = np.zeros((*poses.origin_m.shape[:2], 4, 4))
    matrices[..., :3, :3] = np.where(poses.determined[..., None, None], poses.world_R_segment, np.nan)
    matrices[..., :3, 3] = poses.origin_m * 1000.0
    matrices[..., :3, :] = z_up_R_world(file_up).T @ matrices[..., :3, :]  # poses have z up
    matrices[..., 3, 3] = 1.0
    matrices[np.isnan(matrices).any(axis=(-2, -1))] = np.nan
    return matrices.transpose(2, 3, 1, 0)


def _holds(trajectory: Trajectory, n_rotations: int) -> Check:
    """Needed because ezc3d does not report a full disk."""

    def check(path: Path) -> None:
        expected = C3dSize(trajectory.skeleton.n_joints, trajectory.n_frames)
        found = check_size(path)
        if found != expected and found.n_frames is not None:
            raise ValueError(f"its header counts {found}, not {expected}")
        # Rotations follow the points; ezc3d fills the last block of the points, but not that of the rotations.
        rotation_bytes = trajectory.n_frames * n_rotations * _ROTATION_BYTES
        if (path.stat().st_size - rotation_bytes) % BLOCK_BYTES:
            raise ValueError("its last block is not full")

    return check


def _start(time_s: Float[np.ndarray, " frame"], rate_hz: float, path: Path) -> tuple[int, float]:
    """Number of the first frame, counted from time 0, and how much later than that it is, seconds; says it where other
    programs read another start."""
    rate_hz = float(np.float32(rate_hz))  # as the file has it
    first = round(float(time_s[0]) * rate_hz)
    if not (first >= 0 and first + len(time_s) <= _MAX_FRAMES):
        first = 0
    offset_s = float(time_s[0]) - first / rate_hz
    if abs(offset_s) * rate_hz > 1:
        warnings.warn(
            f"{path}: C3D cannot hold a start at {time_s[0]:.6g} s: for other programs than fgpose it starts at 0 s "
            f"({START_OFFSET} tells it)",
            UserWarning,
            stacklevel=3,
        )
    elif abs(offset_s) > _NOTICED_S:
        warnings.warn(
            f"{path}: C3D counts its start in whole frames: other programs than fgpose take all times "
            f"{1000 * abs(offset_s):.3g} ms too {'early' if offset_s > 0 else 'late'} ({START_OFFSET} tells it)",
            UserWarning,
            stacklevel=3,
        )
    return first, offset_s


def _in_single_precision(value: float) -> list[float]:
    """Numbers of 32 bit whose sum it is, as exactly as one of 64 bit."""
    parts: list[float] = []
    for _ in range(3):
        parts.append(float(np.float32(value - sum(parts))))
    return parts


def read_c3d(path: Path) -> tuple[Trajectory, UpAxis]:
    """Read the markers of a C3D file, in metres and its own axes, and the axis that it says is up: that of Y_SCREEN, z
    where it says nothing. Time counts from the file's frame 0, with the START_OFFSET_S of fgpose. Gaps have a negative
    residual, or are exactly (0, 0, 0).

    Warns:
        UserWarning: there are zeros; how many, and of which markers. Or there are several subjects.

    Raises:
        ImportError: ezc3d is not installed.
        ValueError: the file is something else, its unit is not m or mm, it has no rate, or a marker no name.
        OSError: it cannot be read.
    """
    require_ezc3d()
    file = read_points(path)
    points, missing = file["points"], file["residuals"] < 0
    n_markers, n_frames = missing.shape
    unit = (_texts(file, "UNITS") or ("none",))[0]
    if unit not in _UNITS_PER_METRE:
        raise ValueError(f"POINT:UNITS must be m or mm, got {unit}")
    markers = list(_texts(file, "LABELS"))[:n_markers]
    if len(markers) < n_markers:
        raise ValueError(f"POINT:LABELS names {len(markers)} of {n_markers} markers")
    markers = without_subject(markers, path)
    positions_m = np.where(missing, np.nan, points[:3] / _UNITS_PER_METRE[unit]).transpose(2, 1, 0)
    said = "".join(_texts(file, "Y_SCREEN")).lower()
    file_up: UpAxis = SIGNED_AXES[SIGNED_AXES.index(said)] if said in SIGNED_AXES else "+z"
    time_s = _start_offset_s(file) + (float(file["first_frame"]) + np.arange(n_frames)) / _rate_hz(file)
    return markers_to_trajectory(markers, time_s, without_zeros(markers, positions_m, path)), file_up


def _texts(file: dict[str, np.ndarray], parameter: str) -> tuple[str, ...]:
    """A parameter that is a list of texts; empty where it is missing."""
    if parameter not in file or not file[parameter].size:
        return ()
    # ezc3d gives bytes that are no UTF-8 as surrogates.
    return tuple(text.encode("utf-8", "replace").decode().strip() for text in texts(file, parameter))


def _start_offset_s(file: dict[str, np.ndarray]) -> float:
    """0 in files of other programs."""
    if START_OFFSET not in file or not file[START_OFFSET].size:
        return 0.0
    offset_s = float(checked(file, START_OFFSET, "numbers", None).astype(float).sum())
    return offset_s if np.isfinite(offset_s) else 0.0


def _rate_hz(file: dict[str, np.ndarray]) -> float:
    if "RATE" not in file or not file["RATE"].size:
        raise ValueError("POINT:RATE is missing")
    rate_hz = float(checked(file, "RATE", "numbers", None)[0])
    if not 0 < rate_hz < np.inf:
        raise ValueError(f"POINT:RATE must be positive, got {rate_hz:g}")
    return rate_hz
