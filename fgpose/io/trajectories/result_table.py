"""The table of a result, whatever file it goes to: one row for each person, frame and joint."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from fgpose.io.tables import COVARIANCE_COLUMNS, Column, nullable
from fgpose.kinematics.quantities import Quantities
from fgpose.sampling import TIME_ROUNDING_S, nearest
from fgpose.trajectory import Status, Trajectory
from fgpose_factors.robust_statistics import known_medians

if TYPE_CHECKING:
    import pyarrow as pa

AXES = "xyz"
PER_CAMERA = ("residual_px", "visibility")
"""Fields with one column for each camera: residual_px_<camera>."""
_FRAMES_AT_ONCE = 2000  # in a group of rows: 12 MB, and two of them are in memory
RESULT = (
    Column("time_s", "s", "time of the frame: the mean time at which the cameras took it"),
    Column(
        "frame",
        "",
        "number of the frame in the recording, from 0; of results that do not know it (C3D, npz of older "
        "versions), counted from their first frame",
    ),
    Column("person", "", "number of the person, 0 where there is one"),
    Column("joint", "", "name of the joint in the skeleton"),
    Column("x_m y_m z_m", "m", "position"),
    Column(
        " ".join(COVARIANCE_COLUMNS),
        "m²",
        "covariance of the position; the square root of `cov_xx_m2` is the standard deviation of `x_m`",
    ),
    Column("n_views", "", "cameras with a detection of the joint"),
    Column(
        "reprojection_px",
        "px",
        "median over the cameras of the distance between detection and projected joint, undistorted",
    ),
    Column("residual_px_<camera>", "px", "this distance in one camera"),
    Column("visibility_<camera>", "0 to 1", "probability that the detection is of the joint, and not hallucinated"),
    Column(
        "status",
        "",
        "`observed`: two cameras or more see it, which are those whose detections are more probably of the joint "
        "than hallucinated (`visibility_<camera>` above 0.5), so there may be more in `n_views`; `predicted`: "
        "from other joints and frames; `unobservable`: nothing determines it",
    ),
)


def numbered(shown: Trajectory | Quantities) -> Int[np.ndarray, " frame"]:
    """The numbers of its frames; where they are not known, counted from its first."""
    numbers = shown.numbered if isinstance(shown, Quantities) else shown.frame_numbers
    return np.arange(len(shown.time_s)) if numbers is None else numbers


def frame_numbers(
    people: Mapping[int, Trajectory], time_s: Float[np.ndarray, " frame"] | None = None
) -> dict[int, Int[np.ndarray, " own_frame"]]:
    """The numbers of everybody's frames in their recording.

    Args:
        people: by number, one at least.
        time_s: of all frames of the recording; by default everybody's own numbers count or, where somebody has none,
            the times at which somebody is there.

    Raises:
        ValueError: somebody has no frame, one that is not the recording's, or times do not increase.
    """
    for person, trajectory in people.items():
        if not trajectory.n_frames or not _increases(trajectory.time_s):
            raise ValueError(f"person {person} must have frames whose time_s increases")
    known = {person: each.frame_numbers for person, each in people.items() if each.frame_numbers is not None}
    if time_s is None and len(known) == len(people):
        return known
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


def result_tables(
    people: Mapping[int, Trajectory], frames: Mapping[int, Int[np.ndarray, " frame"]]
) -> Iterator[pa.Table]:
    """The rows of some frames each, one table at least: person by person, joints in the order of the skeleton in each
    frame. What is not known is null.

    Args:
        people: by number, one at least.
        frames: the numbers of each one's frames.

    Raises:
        ValueError: people differ in skeleton or cameras, or some have a covariance, residuals or visibility only.
    """
    import pyarrow as pa

    _check_alike(people)
    for person, trajectory in people.items():
        for start in range(0, max(trajectory.n_frames, 1), _FRAMES_AT_ONCE):
            part = slice(start, start + _FRAMES_AT_ONCE)
            yield pa.table(_columns(trajectory.frames(part), person, frames[person][part]))


def _check_alike(people: Mapping[int, Trajectory]) -> None:
    """Raise ValueError unless all rows can have the same columns and the same joints."""
    first, one = next(iter(people.items()))
    for person, other in people.items():
        different = [name for name in ("skeleton", "camera_names") if getattr(one, name) != getattr(other, name)]
        if different:
            raise ValueError(
                f"people {first} and {person} differ in their {different[0]}; they need files of their own"
            )
        for name in ("covariance_m2", *PER_CAMERA):
            if (getattr(one, name) is None) != (getattr(other, name) is None):
                raise ValueError(f"only one of people {first} and {person} has {name}; they need files of their own")


def _columns(trajectory: Trajectory, person: int, frame: Int[np.ndarray, " frame"]) -> dict[str, pa.Array]:
    import pyarrow as pa

    n_frames, n_joints = trajectory.n_frames, trajectory.skeleton.n_joints
    joint = np.tile(np.arange(n_joints, dtype=np.int32), n_frames)
    columns = {
        "time_s": pa.array(np.repeat(np.asarray(trajectory.time_s, dtype=float), n_joints)),
        "frame": pa.array(np.repeat(frame.astype(np.int32), n_joints)),
        "person": pa.array(np.full(n_frames * n_joints, person, dtype=np.int32)),
        "joint": pa.DictionaryArray.from_arrays(joint, list(trajectory.skeleton.joints)),
    }
    columns |= {f"{AXES[axis]}_m": _flat(trajectory.positions_m[..., axis]) for axis in range(3)}
    unknown = np.full((n_frames, n_joints), np.nan)
    for name, (row, column) in COVARIANCE_COLUMNS.items():
        covariance_m2 = trajectory.covariance_m2
        columns[name] = _flat(unknown if covariance_m2 is None else covariance_m2[..., row, column])
    columns |= _residual_columns(trajectory)
    for field in PER_CAMERA:
        values = getattr(trajectory, field)
        if values is not None:
            cameras = enumerate(trajectory.camera_names)
            columns |= {f"{field}_{name}": _flat(values[:, camera]) for camera, name in cameras}
    status = np.asarray(trajectory.status, dtype=np.int8).ravel()
    names = [name.lower() for name in Status.__members__]
    return columns | {"status": pa.DictionaryArray.from_arrays(status, names)}


def _residual_columns(trajectory: Trajectory) -> dict[str, pa.Array]:
    import pyarrow as pa

    residual_px = trajectory.residual_px
    if residual_px is None:
        nothing = np.full((trajectory.n_frames, trajectory.skeleton.n_joints), np.nan)
        return {"n_views": _flat(nothing).cast(pa.int32()), "reprojection_px": _flat(nothing)}
    return {
        "n_views": pa.array(np.isfinite(residual_px).sum(axis=1, dtype=np.int32).ravel()),
        "reprojection_px": _flat(known_medians(residual_px, axis=1)),
    }


def _flat(values: Float[np.ndarray, "frame joint"]) -> pa.Array:
    return nullable(np.asarray(values, dtype=float).ravel())
