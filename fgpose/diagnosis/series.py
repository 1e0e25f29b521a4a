"""Series over time that the checks and the figures share."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.trajectory import Trajectory


def known_quantile(values: Float[np.ndarray, "*shape"], q: float) -> float:
    """Of the values that are not NaN; NaN if there is none."""
    known = values[np.isfinite(values)]
    return float(np.quantile(known, q)) if known.size else np.nan


def sigma_m(trajectory: Trajectory) -> Float[np.ndarray, "frame joint"]:
    """Root of the largest eigenvalue of each joint's covariance, metres; NaN where there is none."""
    result = np.full(trajectory.status.shape, np.nan)
    if trajectory.covariance_m2 is not None:
        known = np.asarray(np.isfinite(trajectory.covariance_m2).all(axis=(-1, -2)))
        result[known] = np.sqrt(np.maximum(_largest_eigenvalue(trajectory.covariance_m2[known]), 0.0))
    return result


def _largest_eigenvalue(matrices: Float[np.ndarray, "matrix 3 3"]) -> Float[np.ndarray, " matrix"]:
    """Of symmetric matrices, in closed form (Smith 1961): LAPACK takes ten times as long for so many."""
    mean = np.trace(matrices, axis1=-2, axis2=-1) / 3
    centred = matrices - mean[:, None, None] * np.eye(3)
    scale = np.sqrt(np.einsum("mij,mij->m", centred, centred) / 6)
    safe = np.where(scale > 0, scale, 1.0)
    half_determinant = np.clip(np.linalg.det(centred / safe[:, None, None]) / 2, -1.0, 1.0)
    return mean + 2 * scale * np.cos(np.arccos(half_determinant) / 3)


def root_m(trajectory: Trajectory) -> Float[np.ndarray, "frame 3"]:
    """Of the body; NaN where a joint of it is not known."""
    return trajectory.positions_m[:, list(trajectory.skeleton.root)].mean(axis=1)


def root_speed_mps(trajectory: Trajectory) -> Float[np.ndarray, " step"]:
    """From frame to frame; NaN where a joint of the root is not known."""
    return np.linalg.norm(np.diff(root_m(trajectory), axis=0), axis=-1) / np.diff(trajectory.time_s)


def quantile_of_frames(values: Float[np.ndarray, " frame *shape"], q: float = 0.5) -> Float[np.ndarray, " frame"]:
    """Of the known values of each frame, without interpolation; NaN where there is none."""
    rows = np.sort(values.reshape(len(values), -1), axis=1)  # NaN last
    counts = np.isfinite(rows).sum(axis=1)
    at = np.clip(np.round(q * (counts - 1)).astype(int), 0, max(rows.shape[1] - 1, 0))
    if rows.shape[1] == 0:
        return np.full(len(values), np.nan)
    return np.where(counts > 0, rows[np.arange(len(rows)), at], np.nan)
