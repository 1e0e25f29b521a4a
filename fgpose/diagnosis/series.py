"""Numbers of a result that the checks and the figures share: quantiles, sigmas, speeds, reprojection errors."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.diagnosis.finished import FinishedRecording
from fgpose.geometry.camera import CameraRig
from fgpose.sampling import parts_of, spread_evenly
from fgpose.trajectory import Trajectory
from fgpose_factors.robust_statistics import MEDIAN_LENGTH, known_quantile

USUAL_ERROR_M = 0.018 * MEDIAN_LENGTH
"""Median of networks on people whom they see (VisibilityConfig.sigma_m)."""
SAMPLES = 200
"""Frames; a median needs no more."""


def camera_medians(values: Float[np.ndarray, "frame camera joint"]) -> Float[np.ndarray, " camera"]:
    """Of what is known of each camera."""
    return np.array([known_quantile(own, 0.5) for own in np.moveaxis(values, 1, 0)])


def sigma_m(trajectory: Trajectory) -> Float[np.ndarray, "frame joint"]:
    """Root of the largest eigenvalue of each joint's covariance, metres; NaN where there is none."""
    result = np.full(trajectory.status.shape, np.nan)
    if trajectory.covariance_m2 is not None:
        for part in parts_of(trajectory.n_frames):
            covariance_m2 = trajectory.covariance_m2[part]
            known = np.asarray(np.isfinite(covariance_m2).all(axis=(-1, -2)))
            result[part][known] = np.sqrt(np.maximum(_largest_eigenvalue(covariance_m2[known]), 0.0))
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


def together_px(recording: FinishedRecording) -> Float[np.ndarray, "frame camera joint"] | None:
    """Of everybody, one after the other; None where some have none."""
    residuals = [each.residual_px for each in recording.people.values() if each.residual_px is not None]
    if len(residuals) < len(recording.people):
        return None
    return residuals[0] if len(residuals) == 1 else np.concatenate(residuals)


def errors_m(trajectory: Trajectory, rig: CameraRig) -> Float[np.ndarray, "frame camera joint"]:
    """Of a sample of frames, across the ray, at the joint."""
    assert trajectory.residual_px is not None
    sampled = spread_evenly(trajectory.n_frames, SAMPLES)
    return trajectory.residual_px[sampled] / rig.px_per_m(trajectory.positions_m[sampled])
