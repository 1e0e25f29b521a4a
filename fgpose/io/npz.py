"""Trajectories as NumPy archives: everything, exactly."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fgpose.io.arrays import read_arrays
from fgpose.io.atomic import replacing
from fgpose.io.description import describe, described
from fgpose.trajectory import Status, Trajectory

_ARRAYS = ("covariance_m2", "residual_px")
_TEXTS = ("skeleton", "camera_names", "bone_lengths_m", "convergence", "config")


def write_npz(trajectory: Trajectory, path: Path) -> None:
    """Write a NumPy archive that needs no pickle.

    Arrays time_s (T,), positions_m (T, J, 3), status (T, J), covariance_m2 (T, J, 3, 3) and residual_px (T, C, J)
    where they are known; status_names: what the numbers in status mean; joints: their names. The rest as texts of the
    same names as the fields of Trajectory, in JSON, the config in TOML.

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
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)


def read_npz(path: Path) -> Trajectory:
    """The trajectory that write_npz wrote.

    Raises:
        ValueError, KeyError: the file is damaged or something else.
    """
    archive = read_arrays(path)
    statuses = np.array([Status[name.upper()] for name in archive["status_names"].tolist()])
    arrays = {name: archive[name] for name in ("time_s", "positions_m", *_ARRAYS) if name in archive}
    texts = {name: str(archive[name]) for name in _TEXTS if name in archive}
    return Trajectory(status=statuses[archive["status"]], **arrays, **described(texts))
