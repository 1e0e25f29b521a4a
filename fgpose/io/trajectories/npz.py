"""Trajectories as NumPy archives: everything, exactly."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from fgpose.io.arrays import checked, read_arrays, text, texts, write_arrays
from fgpose.io.tables import Column, whole_numbers
from fgpose.io.trajectories.description import LENGTHS, describe, described, status_named
from fgpose.trajectory import Status, Trajectory

_ARRAYS = ("covariance_m2", "residual_px", "visibility", "frame_numbers")
_TEXTS = ("skeleton", "camera_names", *LENGTHS, "convergence", "implausible_frames", "config")
ARRAYS = (
    Column("time_s", "s", "time of each frame: the mean time at which the cameras took it", "(T,)"),
    Column("positions_m", "m", "of each joint, in the world of the calibration", "(T, J, 3)"),
    Column("status", "", "number of its status in `status_names`", "(T, J)"),
    Column("status_names", "", "`observed`, `predicted`, `unobservable`, in the order of the numbers", "(3,)"),
    Column("joints", "", "their names", "(J,)"),
    Column("skeleton", "", "the skeleton, as JSON", "text"),
    Column("camera_names", "", "names of the cameras, as JSON", "text"),
    Column(
        "bone_lengths_m",
        "m",
        "a list of L lengths, one for a bone and its mirror image, as JSON; null: not estimated",
        "text",
    ),
    Column("bone_length_sigma_m", "m", "their standard deviations, as JSON; not in files of older versions", "text"),
    Column("convergence", "", "how the optimiser ended, as JSON", "text"),
    Column(
        "implausible_frames",
        "",
        "frames that were left out because their detections make no body, as JSON",
        "text",
    ),
    Column("config", "", "the configuration, as TOML", "text"),
    Column("covariance_m2", "m²", "covariance of each position", "(T, J, 3, 3)"),
    Column("residual_px", "px", "distance between detection and projected joint, undistorted", "(T, C, J)"),
    Column("visibility", "0 to 1", "probability that the detection is of the joint, and not hallucinated", "(T, C, J)"),
    Column(
        "frame_numbers",
        "",
        "of each frame in the recording, from 0; where they are not known (C3D), counted from the first; not in "
        "files of older versions",
        "(T,)",
    ),
    Column("made_by", "", "the command of fgpose that wrote it, and the recording that it was made from", "text"),
)


def write_npz(trajectory: Trajectory, path: Path, made_by: str = "") -> None:
    """Write a NumPy archive that needs no pickle.

    Arrays time_s (T,), positions_m (T, J, 3), status (T, J), and where they are known covariance_m2 (T, J, 3, 3),
    residual_px and visibility (T, C, J), frame_numbers (T,); status_names: what the numbers in status mean; joints:
    their names. The rest as texts of the same names as the fields of Trajectory, in JSON, the config in TOML. made_by,
    where it is known: see Origin.maker.

    Raises:
        OSError: the file cannot be written.
    """
    arrays: dict[str, Any] = {
        "time_s": trajectory.time_s,
        "positions_m": trajectory.positions_m,
        "status": np.asarray(trajectory.status, dtype=np.int8),
        "status_names": np.array([status.name.lower() for status in Status]),
        "joints": np.array(trajectory.skeleton.joints),
    }
    arrays |= {name: np.array(text) for name, text in describe(trajectory).items()}
    for name in _ARRAYS:
        array = getattr(trajectory, name)
        if array is not None:
            arrays[name] = array
    if made_by:
        arrays["made_by"] = np.array(made_by)
    write_arrays(path, arrays)


def read_npz(path: Path) -> Trajectory:
    """The trajectory that write_npz wrote.

    Raises:
        ValueError: the file is damaged or something else.
    """
    archive = read_arrays(path)
    values = described({name: text(archive, name) for name in _TEXTS if name in archive})
    n_joints, n_cameras = values["skeleton"].n_joints, len(values["camera_names"])
    shapes = {"time_s": (None,), "positions_m": (None, n_joints, 3)}
    of_detections = (None, n_cameras, n_joints)
    optional = dict(zip(_ARRAYS, ((None, n_joints, 3, 3), of_detections, of_detections, (None,)), strict=True))
    shapes |= {name: shape for name, shape in optional.items() if name in archive}
    arrays: dict[str, Any] = {
        name: checked(archive, name, "numbers", *shape).astype(float) for name, shape in shapes.items()
    }
    if "frame_numbers" in arrays:
        arrays["frame_numbers"] = _increasing(whole_numbers(arrays["frame_numbers"], "frame"))
    return Trajectory(status=_status(archive, n_joints), **arrays, **values)


def _increasing(frames: Int[np.ndarray, " frame"]) -> Int[np.ndarray, " frame"]:
    if (np.diff(frames) <= 0).any():
        raise ValueError("array frame_numbers does not increase")
    return frames


def _status(archive: dict[str, np.ndarray], n_joints: int) -> Int[np.ndarray, "frame joint"]:
    """The numbers in the file are those of its own list of names."""
    meaning = np.array([status_named(name) for name in texts(archive, "status_names")])
    status = checked(archive, "status", "whole numbers", None, n_joints)
    if np.any(status < 0) or np.any(status >= len(meaning)):
        raise ValueError(f"array status has a number that is none of the {len(meaning)} in status_names")
    return meaning[status.astype(np.int64)]
