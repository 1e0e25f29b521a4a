"""A motion compared with the images of one frame."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.config import ProjectionConfig
from fgpose.estimation.evidence.detection_bias import Bias
from fgpose.estimation.evidence.evidence import Evidence
from fgpose.geometry.camera import CameraRig

# From half to twice this, the errors on the tuning clips of the benchmark differ by 2 %.
_MOVED_M = 0.1


def corrected(
    evidence: Evidence,
    positions_m: Float[np.ndarray, "joint 3"],
    velocities_mps: Float[np.ndarray, "joint 3"],
    bias: Bias,
    rig: CameraRig,
) -> Evidence:
    """The detections where they would be if this were the motion and all cameras were synchronous and without bias."""
    if evidence.delay_s.any():
        moved_m = np.nan_to_num(velocities_mps * evidence.delay_s[0, :, None, None])
        evidence = evidence.on_time(positions_m[None], moved_m[None], rig)
    return evidence.less_bias(positions_m[None], bias, rig) if bias.bias_m.any() else evidence


def fits_better(
    positions_m: Float[np.ndarray, "joint 3"],
    others_m: Float[np.ndarray, "joint 3"],
    evidence: Evidence,
    rig: CameraRig,
    config: ProjectionConfig,
) -> Bool[np.ndarray, " joint"]:
    """Which of the joints explain the detections better at the first positions than at the others.

    The others count as one more detection, whose errors have the scale _MOVED_M: hallucinations agree on a far point by
    chance.
    """
    moved = np.sum((positions_m - others_m) ** 2, axis=-1) / _MOVED_M**2
    error, of_others = _image_errors(np.array([positions_m, others_m]), evidence, rig, config)
    return np.asarray(error + np.nan_to_num(moved / (1 + moved)) < of_others)


def _image_errors(
    positions_m: Float[np.ndarray, "pose joint 3"], evidence: Evidence, rig: CameraRig, config: ProjectionConfig
) -> Float[np.ndarray, "pose joint"]:
    """Robust (Geman-McClure) reprojection error per joint, in units of the kernel's scale; inf without a point."""
    scale_px = evidence.sigma_px * config.kernel_scale
    squared = np.sum((rig.project(positions_m) - evidence.undistorted_px) ** 2, axis=-1) / scale_px**2
    # A point behind a camera that sees the joint has no image there: as bad as the farthest outlier.
    robust = np.where(np.isfinite(squared), squared / (1 + squared), 1.0)
    error = np.sum(np.where(evidence.detected, evidence.weights * robust, 0.0), axis=1)
    return np.where(np.isfinite(positions_m).all(axis=-1), error, np.inf)
