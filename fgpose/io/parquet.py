"""Trajectories as Parquet: one long table that any data tool reads."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from fgpose.io.covariance_columns import COVARIANCE_COLUMNS, symmetric
from fgpose.io.description import describe, described, status_named
from fgpose.io.tables import metadata, names, numbers, read_table, write_table
from fgpose.trajectory import Status, Trajectory

if TYPE_CHECKING:
    import pyarrow as pa

_AXES = "xyz"
_PREFIX = "fgpose."
_HAS_COVARIANCE = "has_covariance"
_PER_CAMERA = ("residual_px", "visibility")  # fields with one column for each camera: residual_px_<camera>


def write_parquet(trajectory: Trajectory, path: Path) -> None:
    """Write one row per frame and joint, joints in the order of the skeleton within each frame.

    Columns: time_s, frame (from 0), person (always 0), joint; x_m, y_m, z_m in the world frame; cov_xx_m2, cov_xy_m2,
    cov_xz_m2, cov_yy_m2, cov_yz_m2, cov_zz_m2; n_views, the number of cameras with a detection; reprojection_px, the
    median of their reprojection errors in undistorted pixels; status (observed, predicted, unobservable); and, where
    they are known, the errors of each camera in residual_px_<camera>, and the probability that its detection is of the
    joint in visibility_<camera>. What is not known is null. The metadata of the file (keys fgpose.*) hold the skeleton,
    cameras, bone lengths and convergence as JSON and the config as TOML.

    Raises:
        OSError: the file cannot be written.
    """
    import pyarrow as pa

    texts = describe(trajectory) | {_HAS_COVARIANCE: str(trajectory.covariance_m2 is not None).lower()}
    table = pa.table(_columns(trajectory))
    table = table.replace_schema_metadata({_PREFIX + name: text for name, text in texts.items()})
    write_table(path, table)


def _columns(trajectory: Trajectory) -> dict[str, pa.Array]:
    import pyarrow as pa

    n_frames, n_joints = trajectory.n_frames, trajectory.skeleton.n_joints
    joint = np.tile(np.arange(n_joints, dtype=np.int32), n_frames)
    columns = {
        "time_s": pa.array(np.repeat(np.asarray(trajectory.time_s, dtype=float), n_joints)),
        "frame": pa.array(np.repeat(np.arange(n_frames, dtype=np.int32), n_joints)),
        "person": pa.array(np.zeros(n_frames * n_joints, dtype=np.int32)),
        "joint": pa.DictionaryArray.from_arrays(joint, list(trajectory.skeleton.joints)),
    }
    columns |= {f"{_AXES[axis]}_m": _nullable(trajectory.positions_m[..., axis]) for axis in range(3)}
    unknown = np.full((n_frames, n_joints), np.nan)
    for name, (row, column) in COVARIANCE_COLUMNS.items():
        covariance_m2 = trajectory.covariance_m2
        columns[name] = _nullable(unknown if covariance_m2 is None else covariance_m2[..., row, column])
    columns |= _residual_columns(trajectory)
    for field in _PER_CAMERA:
        values = getattr(trajectory, field)
        if values is not None:
            cameras = enumerate(trajectory.camera_names)
            columns |= {f"{field}_{name}": _nullable(values[:, camera]) for camera, name in cameras}
    status = np.asarray(trajectory.status, dtype=np.int8).ravel()
    names = [name.lower() for name in Status.__members__]
    return columns | {"status": pa.DictionaryArray.from_arrays(status, names)}


def _residual_columns(trajectory: Trajectory) -> dict[str, pa.Array]:
    import pyarrow as pa

    residual_px = trajectory.residual_px
    if residual_px is None:
        nothing = np.full((trajectory.n_frames, trajectory.skeleton.n_joints), np.nan)
        return {"n_views": _nullable(nothing).cast(pa.int32()), "reprojection_px": _nullable(nothing)}
    return {
        "n_views": pa.array(np.isfinite(residual_px).sum(axis=1, dtype=np.int32).ravel()),
        "reprojection_px": _nullable(_median_over_cameras(residual_px)),
    }


def _median_over_cameras(residual_px: Float[np.ndarray, "frame camera joint"]) -> Float[np.ndarray, "frame joint"]:
    with warnings.catch_warnings():
        # The median of nothing is NaN, as it should be, with a warning.
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.nanmedian(residual_px, axis=1)


def _nullable(values: Float[np.ndarray, "frame joint"]) -> pa.Array:
    import pyarrow as pa

    return pa.array(np.ascontiguousarray(values, dtype=float).ravel(), from_pandas=True)


def read_parquet(path: Path) -> Trajectory:
    """The trajectory that write_parquet wrote. Covariances come back symmetric, made from their upper triangle.

    Raises:
        ValueError: the file is something else, or rows are missing or in another order.
        OSError: it cannot be opened.
    """
    table = read_table(path)
    texts = {key.removeprefix(_PREFIX): text for key, text in metadata(table).items() if key.startswith(_PREFIX)}
    values = described(texts)
    joints = values["skeleton"].joints
    n_frames = table.num_rows // len(joints)
    _check_order(table, joints, n_frames)

    def column(name: str) -> np.ndarray:
        return numbers(table, name).reshape(n_frames, len(joints))

    for field in _PER_CAMERA:
        cameras = [f"{field}_{name}" for name in values["camera_names"]]
        if cameras and set(cameras) <= set(table.column_names):
            values[field] = np.stack([column(name) for name in cameras], axis=1)
    if texts.get(_HAS_COVARIANCE) == "true":
        values["covariance_m2"] = symmetric(column)
    status_names, status = names(table, "status")
    meaning = np.array([status_named(name) for name in status_names], dtype=int)
    return Trajectory(
        time_s=column("time_s")[:, 0],
        positions_m=np.stack([column(f"{axis}_m") for axis in _AXES], axis=-1),
        status=meaning[status].reshape(n_frames, len(joints)),
        **values,
    )


def _check_order(table: pa.Table, joints: tuple[str, ...], n_frames: int) -> None:
    joint_names, joint = names(table, "joint")
    known = np.array([joints.index(each) if each in joints else -1 for each in joint_names], dtype=int)
    in_order = np.array_equal(numbers(table, "frame"), np.repeat(np.arange(n_frames), len(joints)))
    if not in_order or not np.array_equal(known[joint], np.tile(np.arange(len(joints)), n_frames)):
        raise ValueError("rows are missing or in another order: each frame must hold every joint of the skeleton once")
