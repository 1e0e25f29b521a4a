"""Whole recordings in our own formats: npz, and parquet as a long table for other programs."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fgpose.geometry.camera import CameraRig
from fgpose.io.arrays import array_names, checked, read_arrays, texts, write_arrays
from fgpose.io.content import first_bytes
from fgpose.io.keypoints.detection_columns import (
    DETECTION,
    detection_arrays,
    detection_columns,
    joint_indices,
    repeated_row,
    require_columns,
)
from fgpose.io.mistaken import refuse_result
from fgpose.io.names import match_cameras
from fgpose.io.skeletons.tables import skeleton_to_json
from fgpose.io.tables import Column, names, nullable, numbers, read_table, write_table
from fgpose.observations import Observations
from fgpose.plain_files import naming
from fgpose.shown.wrong_types import check_type
from fgpose.skeleton import Skeleton

if TYPE_CHECKING:
    import pyarrow as pa

SKELETON = "skeleton"
"""Array of an npz, and key of the metadata of a parquet file, that say what the joints are."""
_REQUIRED_ARRAYS = ("time_s", "points2d_px", "confidence", "camera_names", "joints")
# Rows without a detection may be left out, but not nearly all.
_MAX_CELLS_PER_ROW = 1000
COLUMNS = (
    Column("frame", "", "number of the frame, from 0"),
    Column("time_s", "s", "time of the image of this camera"),
    Column("camera", "", "its name"),
    Column("joint", "", "name of the joint"),
    *DETECTION,
)
ARRAYS = (
    Column(
        "time_s",
        "s",
        "time of each frame, or of each image where cameras have clocks of their own",
        "(T,) or (T, C)",
    ),
    Column("points2d_px", "px", "detections in the original images", "(T, C, J, 2)"),
    Column("confidence", "0 to 1", "of the detector; 0: not detected", "(T, C, J)"),
    Column("camera_names", "", "their names", "(C,)"),
    Column("joints", "", "their names", "(J,)"),
    Column("skeleton", "", "the skeleton, as JSON", "(1,)"),
    Column(
        "points3d_m",
        "m",
        "the joints as each view alone gives them, in the world; if there is per-view 3D",
        "(T, C, J, 3)",
    ),
    Column("covariance3d_m2", "m²", "their covariances", "(T, C, J, 3, 3)"),
)


def with_skeleton(table: pa.Table, skeleton: Skeleton) -> pa.Table:
    """The table with what its joints are in its metadata."""
    return table.replace_schema_metadata({SKELETON: skeleton_to_json(skeleton)})


def is_recording(path: Path) -> bool:
    """Whether a file is a recording of ours, by its content.

    Raises:
        ValueError: it is a result or a calibration; the message names it.
        OSError: it cannot be read.
    """
    if path.is_dir():
        return False
    refuse_result(path)
    if is_parquet(path):
        return True
    with naming(path):
        return _is_npz(path) and "points2d_px" in array_names(path)


def read(path: Path, rig: CameraRig, skeleton: Skeleton, *, ignore_other_cameras: bool = False) -> Observations:
    """A recording written by save_observations, with its cameras in the order of the rig.

    Raises:
        ValueError: the file is damaged, of another skeleton or other cameras; the message names the file.
    """
    with naming(path):
        observations = _read_parquet(path, skeleton) if is_parquet(path) else _read_npz(path, skeleton)
        matched = match_cameras(observations.camera_names, rig.names, ignore_others=ignore_other_cameras)
        in_order = observations.subset([matched[name] for name in rig.names])
        return replace(in_order, camera_names=rig.names)


def camera_names(path: Path) -> tuple[str, ...]:
    """The cameras of a recording; nothing else is read. Raises ValueError, which names the file, if it is damaged."""
    with naming(path):
        if is_parquet(path):
            return names(read_table(path, ["camera"]), "camera")[0]
        return texts(read_arrays(path, ["camera_names"]), "camera_names")


def save_observations(observations: Observations, path: str | Path) -> None:
    """Write a recording as npz or as a parquet table, by the extension.

    Pixels, confidences and metres are rounded to single precision (about 1e-4 px and 1e-7 m), far below what a detector
    resolves. The file appears under its name only when it is complete.

    Parquet: one row per frame, camera and joint; columns frame (from 0), time_s, camera, joint, x_px, y_px, confidence
    and, with per-view 3D, x_m, y_m, z_m in the world frame, with covariance cov_xx_m2 to cov_zz_m2; null = missing.
    Both hold the skeleton, as JSON.

    Raises:
        TypeError: these are no observations.
        ValueError: the extension is neither .npz nor .parquet.
        OSError: the file cannot be written.
    """
    check_type("save_observations", "observations", observations, Observations)
    path = Path(path)
    writers = {".npz": _write_npz, ".parquet": _write_parquet}
    if path.suffix not in writers:
        raise ValueError(f"{path}: observations are written as .npz or .parquet")
    writers[path.suffix](observations, path)


def _write_npz(observations: Observations, path: Path) -> None:
    arrays = {
        "time_s": observations.time_s,
        "points2d_px": observations.points2d_px.astype(np.float32),
        "confidence": observations.confidence.astype(np.float32),
        "camera_names": np.array(observations.camera_names),
        "joints": np.array(observations.skeleton.joints),
        SKELETON: np.array([skeleton_to_json(observations.skeleton)]),
    }
    if observations.points3d_m is not None:
        arrays["points3d_m"] = observations.points3d_m.astype(np.float32)
    if observations.covariance3d_m2 is not None:
        arrays["covariance3d_m2"] = observations.covariance3d_m2.astype(np.float32)
    write_arrays(path, arrays)


def _read_npz(path: Path, skeleton: Skeleton) -> Observations:
    arrays = read_arrays(path)
    missing = [name for name in _REQUIRED_ARRAYS if name not in arrays]
    if missing:
        raise ValueError(f"not a recording of fgpose: the array {', '.join(missing)} is missing")
    joints, cameras = texts(arrays, "joints"), texts(arrays, "camera_names")
    if joints != skeleton.joints:
        raise ValueError(f"its joints are not those of skeleton {skeleton.name}: {', '.join(joints)}")
    own_clocks = arrays["time_s"].ndim == 2
    per_detection = (None, len(cameras), len(joints))
    shapes = {
        "time_s": (None, len(cameras)) if own_clocks else (None,),
        "points2d_px": (*per_detection, 2),
        "confidence": per_detection,
        "points3d_m": (*per_detection, 3),
        "covariance3d_m2": (*per_detection, 3, 3),
    }
    found: dict[str, Any] = {
        name: checked(arrays, name, "numbers", *shape) for name, shape in shapes.items() if name in arrays
    }
    return Observations(skeleton=skeleton, camera_names=cameras, **found)


def is_parquet(path: Path) -> bool:
    """By its content, or its name where the content is damaged. Raises OSError if it cannot be read."""
    return first_bytes(path, 4) == b"PAR1" or (path.suffix == ".parquet" and not _is_npz(path))


def _is_npz(path: Path) -> bool:
    return first_bytes(path, 2) == b"PK"


def _write_parquet(observations: Observations, path: Path) -> None:
    import pyarrow as pa

    n_frames, n_cameras, n_joints = observations.points2d_px.shape[:3]
    frame, camera, joint = (index.ravel() for index in np.indices((n_frames, n_cameras, n_joints)))
    time_s = observations.time_s if observations.time_s.ndim == 2 else observations.time_s[:, None]
    columns = {
        "frame": pa.array(frame),
        "time_s": nullable(np.broadcast_to(time_s, (n_frames, n_cameras))[frame, camera]),
        "camera": pa.DictionaryArray.from_arrays(camera.astype(np.int32), list(observations.camera_names)),
        "joint": pa.DictionaryArray.from_arrays(joint.astype(np.int32), list(observations.skeleton.joints)),
    }
    arrays = observations.per_detection(lambda array: array)
    columns |= {name: nullable(values) for name, values in detection_columns(arrays).items()}
    write_table(path, with_skeleton(pa.table(columns), observations.skeleton))


def _read_parquet(path: Path, skeleton: Skeleton) -> Observations:
    table = read_table(path)
    require_columns(table, ("frame", "time_s", "camera", "joint"))
    cameras, camera = names(table, "camera")
    joint = joint_indices(table, skeleton)
    frames, frame = np.unique(numbers(table, "frame"), return_inverse=True)
    if not np.isfinite(frames).all():
        raise ValueError("a row without a frame")
    shape = (len(frames), len(cameras), skeleton.n_joints)
    if math.prod(shape) > _MAX_CELLS_PER_ROW * table.num_rows:
        raise ValueError(f"{table.num_rows} rows for {shape[0]} frames, {shape[1]} cameras and {shape[2]} joints")
    _refuse_repeated(frame, camera, joint, frames, cameras, skeleton)

    def spread(column: np.ndarray) -> np.ndarray:
        array = np.full(shape, np.nan)
        array[frame, camera, joint] = column
        return array

    found: dict[str, Any] = detection_arrays(table, spread)
    time_s = _times(numbers(table, "time_s"), frame, camera, shape[:2])
    return Observations(skeleton=skeleton, time_s=time_s, camera_names=cameras, **found)


def _refuse_repeated(
    frame: np.ndarray,
    camera: np.ndarray,
    joint: np.ndarray,
    frames: np.ndarray,
    cameras: tuple[str, ...],
    skeleton: Skeleton,
) -> None:
    row = repeated_row((frame * len(cameras) + camera) * skeleton.n_joints + joint)
    if row is not None:
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
