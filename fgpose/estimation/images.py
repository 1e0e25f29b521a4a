"""A motion compared with the images of one frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from fgpose.config import ProjectionConfig
from fgpose.estimation.delays import image_shift_px
from fgpose.estimation.evidence import Evidence
from fgpose.geometry.camera import CameraRig

# From half to twice this, the errors on the tuning clips of the benchmark differ by 2 %.
_MOVED_M = 0.1


def on_time(
    evidence: Evidence,
    positions_m: Float[np.ndarray, "joint 3"],
    velocities_mps: Float[np.ndarray, "joint 3"],
    rig: CameraRig,
) -> Evidence:
    """The detections where they would be if all cameras were synchronous and this were the motion; see delays."""
    delay_s = evidence.delay_s[0]
    if not delay_s.any():
        return evidence
    at_camera_m = positions_m + velocities_mps * delay_s[:, None, None]
    moved_px = image_shift_px(positions_m, at_camera_m, rig)
    return replace(evidence, undistorted_px=evidence.undistorted_px - moved_px)


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
    moved = np.nan_to_num(moved / (1 + moved))
    return _image_error(positions_m, evidence, rig, config) + moved < _image_error(others_m, evidence, rig, config)


def _image_error(
    positions_m: Float[np.ndarray, "joint 3"], evidence: Evidence, rig: CameraRig, config: ProjectionConfig
) -> Float[np.ndarray, " joint"]:
    """Robust (Geman-McClure) reprojection error per joint, in units of the kernel's scale; inf without a point."""
    scale_px = config.sigma_px * config.kernel_scale
    squared = np.sum((rig.project(positions_m) - evidence.undistorted_px[0]) ** 2, axis=-1) / scale_px**2
    # A point behind a camera that sees the joint has no image there: as bad as the farthest outlier.
    robust = np.where(np.isfinite(squared), squared / (1 + squared), 1.0)
    error = np.sum(np.where(evidence.detected[0], evidence.weights[0] * robust, 0.0), axis=0)
    return np.where(np.isfinite(positions_m).all(axis=-1), error, np.inf)
