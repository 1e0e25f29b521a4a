"""Reprojection errors of a result."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.diagnosis.finished import FinishedRecording
from fgpose.geometry.camera import CameraRig
from fgpose.sampling import spread_evenly
from fgpose.trajectory import Trajectory

MEDIAN_LENGTH = 1.1774
"""Of a vector of two normal numbers of standard deviation one."""
USUAL_ERROR_M = 0.018 * MEDIAN_LENGTH
"""Median of networks on people whom they see (VisibilityConfig.sigma_m)."""
SAMPLES = 200
"""Frames; a median needs no more."""


def together_px(recording: FinishedRecording) -> Float[np.ndarray, "frame camera joint"] | None:
    """Of everybody, one after the other; None where some have none."""
    residuals = [each.residual_px for each in recording.people.values() if each.residual_px is not None]
    return np.concatenate(residuals) if len(residuals) == len(recording.people) else None


def errors_m(trajectory: Trajectory, rig: CameraRig) -> Float[np.ndarray, "frame camera joint"]:
    """Of a sample of frames, across the ray, at the joint."""
    assert trajectory.residual_px is not None
    sampled = spread_evenly(trajectory.n_frames, SAMPLES)
    return trajectory.residual_px[sampled] / rig.px_per_m(trajectory.positions_m[sampled])
