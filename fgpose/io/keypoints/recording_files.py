"""Whole recordings in our own formats: npz, and parquet as a long table for other programs."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fgpose.geometry.camera import CameraRig
from fgpose.io.arrays import read_arrays
from fgpose.io.atomic import replacing
from fgpose.io.camera_names import match_cameras
from fgpose.io.covariance_columns import COVARIANCE_COLUMNS, symmetric
from fgpose.observations import Observations
from fgpose.skeleton import Skeleton

if TYPE_CHECKING:
    import pyarrow

_REQUIRED_COLUMNS = ("frame", "time_s", "camera", "joint", "x_px", "y_px", "confidence")
_COLUMNS_3D = ("x_m", "y_m", "z_m")


def is_recording(path: Path) -> bool:
    """Whether a file is a recording of ours, by its content. Raises OSError if it cannot be read."""
    if path.is_dir():
        return False
    with path.open("rb") as file:
        start = file.read(4)
    if start.startswith(b"PK"):
        try:
            with zipfile.ZipFile(path) as archive:
                return "points2d_px.npy" in archive.namelist()
        except (zipfile.BadZipFile, NotImplementedError):
            raise ValueError(f"{path}: a damaged npz") from None
    return start == b"PAR1"


def read(path: Path, rig: CameraRig, skeleton: Skeleton) -> Observations:
    """A recording written by save_observations, with its cameras in the order of the rig.

    Raises:
        ValueError: the file is damaged, of another skeleton or other cameras; the message names the file.
    """
    try:
        observations = _read_parquet(path, skeleton) if _is_parquet(path) else _read_npz(path, skeleton)
        matched = match_cameras(observations.camera_names, rig.names)
        in_order = observations.subset([matched[name] for name in rig.names])
        return replace(in_order, camera_names=rig.names)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def save_observations(observations: Observations, path: str | Path) -> None:
    """Write a recording as npz or as a parquet table, by the extension.

    Pixels, confidences and metres are rounded to single precision (about 1e-4 px and 1e-7 m), far below what a detector
    resolves. The file appears under its name only when it is complete.

    Parquet: one row per frame, camera and joint; columns frame (from 0), time_s, camera, joint, x_px, y_px, confidence
    and, with per-view 3D, x_m, y_m, z_m in the world frame, with covariance cov_xx_m2 to cov_zz_m2; null = missing.

    Raises:
        ValueError: the extension is neither .npz nor .parquet.
        OSError: the file cannot be written.
    """
    path = Path(path)
    writers = {".npz": _write_npz, ".parquet": _write_parquet}
    if path.suffix not in writers:
        raise ValueError(f"{path}: observations are written as .npz or .parquet")
    with replacing(path) as temporary:
        writers[path.suffix](observations, temporary)


def _write_npz(observations: Observations, path: Path) -> None:
    arrays = {
        "time_s": observations.time_s,
        "points2d_px": observations.points2d_px.astype(np.float32),
        "confidence": observations.confidence.astype(np.float32),
        "camera_names": np.array(observations.camera_names),
        "joints": np.array(observations.skeleton.joints),
    }
    if observations.points3d_m is not None:
        arrays["points3d_m"] = observations.points3d_m.astype(np.float32)
    if observations.covariance3d_m2 is not None:
        arrays["covariance3d_m2"] = observations.covariance3d_m2.astype(np.float32)
    # The annotations of savez_compressed leave no keyword but allow_pickle to a checker.
    np.savez_compressed(path, **arrays)  # pyright: ignore[reportArgumentType]


def _read_npz(path: Path, skeleton: Skeleton) -> Observations:
    arrays = read_arrays(path)
    required = ("time_s", "points2d_px", "confidence", "camera_names", "joints")
    missing = [name for name in required if name not in arrays]
    if missing:
        raise ValueError(f"not a recording of fgpose: the array {', '.join(missing)} is missing")
    if tuple(arrays["joints"].tolist()) != skeleton.joints:
        raise ValueError(
            f"its joints are not those of skeleton {skeleton.name}: {', '.join(arrays['joints'].tolist())}"
        )
    return Observations(
        skeleton=skeleton,
        time_s=arrays["time_s"],
        points2d_px=arrays["points2d_px"],
        confidence=arrays["confidence"],
        points3d_m=arrays.get("points3d_m"),
        covariance3d_m2=arrays.get("covariance3d_m2"),
        camera_names=tuple(arrays["camera_names"].tolist()),
    )


def _is_parquet(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(4) == b"PAR1"


def _write_parquet(observations: Observations, path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet

    n_frames, n_cameras, n_joints = observations.points2d_px.shape[:3]
    frame, camera, joint = (index.ravel() for index in np.indices((n_frames, n_cameras, n_joints)))
    time_s = observations.time_s if observations.time_s.ndim == 2 else observations.time_s[:, None]
    columns = {
        "frame": pa.array(frame),
        "time_s": _nullable(np.broadcast_to(time_s, (n_frames, n_cameras))[frame, camera]),
        "camera": pa.DictionaryArray.from_arrays(camera.astype(np.int32), list(observations.camera_names)),
        "joint": pa.DictionaryArray.from_arrays(joint.astype(np.int32), list(observations.skeleton.joints)),
    }
    for axis, name in enumerate(("x_px", "y_px")):
        columns[name] = _nullable(observations.points2d_px[..., axis].ravel().astype(np.float32))
    columns["confidence"] = pa.array(observations.confidence.ravel().astype(np.float32))
    if observations.points3d_m is not None:
        for axis, name in enumerate(_COLUMNS_3D):
            columns[name] = _nullable(observations.points3d_m[..., axis].ravel().astype(np.float32))
    if observations.covariance3d_m2 is not None:
        for name, entry in COVARIANCE_COLUMNS.items():
            columns[name] = _nullable(observations.covariance3d_m2[(..., *entry)].ravel().astype(np.float32))
    pyarrow.parquet.write_table(pa.table(columns), path, compression="zstd", write_page_checksum=True)


def _nullable(values: np.ndarray) -> pyarrow.Array:
    import pyarrow as pa

    return pa.array(values, mask=np.isnan(values))


def _read_parquet(path: Path, skeleton: Skeleton) -> Observations:
    import pyarrow as pa
    import pyarrow.parquet

    try:
        with path.open("rb") as stream:
            table = pyarrow.parquet.read_table(stream, page_checksum_verification=True)
    except (pa.ArrowException, OSError) as error:
        raise ValueError(f"a damaged parquet file: {error}") from None
    missing = [name for name in _REQUIRED_COLUMNS if name not in table.column_names]
    if missing:
        raise ValueError(f"the column {', '.join(missing)} is missing")
    cameras, camera = _categories(table, "camera")
    joint = _joint_indices(table, skeleton)
    frames, frame = np.unique(_column(table, "frame"), return_inverse=True)
    if not np.isfinite(frames).all():
        raise ValueError("a row without a frame")
    shape = (len(frames), len(cameras), skeleton.n_joints)
    _refuse_repeated(frame, camera, joint, frames, cameras, skeleton)

    def spread(*names: str) -> np.ndarray:
        array = np.full((*shape, len(names)), np.nan)
        array[frame, camera, joint] = np.stack([_column(table, name) for name in names], axis=-1)
        return array

    has_3d, has_covariance = (
        all(name in table.column_names for name in names) for names in (_COLUMNS_3D, COVARIANCE_COLUMNS)
    )
    return Observations(
        skeleton=skeleton,
        time_s=_times(_column(table, "time_s"), frame, camera, shape[:2]),
        points2d_px=spread("x_px", "y_px"),
        confidence=np.nan_to_num(spread("confidence")[..., 0]),
        points3d_m=spread(*_COLUMNS_3D) if has_3d else None,
        covariance3d_m2=symmetric(lambda name: spread(name)[..., 0]) if has_covariance else None,
        camera_names=cameras,
    )


def _column(table: pyarrow.Table, name: str) -> np.ndarray:
    import pyarrow as pa

    try:
        return table[name].cast(pa.float64()).to_numpy()
    except pa.ArrowException:
        raise ValueError(f"column {name} does not contain numbers") from None


def _categories(table: pyarrow.Table, name: str) -> tuple[tuple[str, ...], np.ndarray]:
    """Names in a text column in the order of their first occurrence, and the index of each row's."""
    import pyarrow as pa

    try:
        column = table[name].cast(pa.string()).combine_chunks().dictionary_encode()
    except pa.ArrowException:
        raise ValueError(f"column {name} does not contain names") from None
    if isinstance(column, pa.ChunkedArray):
        column = column.combine_chunks()
    if column.null_count:
        raise ValueError(f"a row without a {name}")
    return tuple(column.dictionary.to_pylist()), column.indices.to_numpy()


def _joint_indices(table: pyarrow.Table, skeleton: Skeleton) -> np.ndarray:
    joints, index = _categories(table, "joint")
    unknown = [joint for joint in joints if joint not in skeleton.joints]
    if unknown:
        raise ValueError(f"joint {', '.join(unknown)} is not one of skeleton {skeleton.name}")
    return np.array([skeleton.index(joint) for joint in joints], dtype=int)[index]


def _refuse_repeated(
    frame: np.ndarray,
    camera: np.ndarray,
    joint: np.ndarray,
    frames: np.ndarray,
    cameras: tuple[str, ...],
    skeleton: Skeleton,
) -> None:
    cell = (frame * len(cameras) + camera) * skeleton.n_joints + joint
    cells, counts = np.unique(cell, return_counts=True)
    if (counts > 1).any():
        row = int(np.flatnonzero(cell == cells[counts > 1][0])[0])
        raise ValueError(
            f"two rows for camera {cameras[camera[row]]}, joint {skeleton.joints[joint[row]]}, "
            f"frame {frames[frame[row]]:g}"
        )


def _times(time_s: np.ndarray, frame: np.ndarray, camera: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """(T,) where all cameras share one clock, else (T, C)."""
    own_clock_s = np.full(shape, np.nan)
    own_clock_s[frame, camera] = time_s
    shared_s = np.full(shape[0], np.nan)
    shared_s[frame] = time_s
    agrees = (own_clock_s == shared_s[:, None]) | np.isnan(own_clock_s)
    return shared_s if agrees.all() and not np.isnan(time_s).any() else own_clock_s
