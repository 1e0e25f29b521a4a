"""How much each detection counts in the estimator: the views' agreement (eq. 2), adapted to a temporal estimator."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.config import ProjectionConfig
from fgpose.estimation.evidence.fusion import Fusion
from fgpose.geometry.camera import CameraRig

LEAST_WEIGHT = 0.001
"""Of a detection before its visibility is judged."""


def detection_weights(
    fusion: Fusion, confidence: Float[np.ndarray, "frame camera joint"], rig: CameraRig, config: ProjectionConfig
) -> Float[np.ndarray, "frame camera joint"]:
    """Weight of every detection, from LEAST_WEIGHT to 1: its information relative to a good detection.

    Eq. 2 weights a view's 3D candidate by the reciprocal of its reprojection error. As information of a 2D detection
    that would be over-confident (a view that happens to agree gets a weight without bound) and circular (a view's own
    detection judges its own candidate). So the error e of a detection is its squared distance to the nearest candidate
    of another view: one view that confirms it outweighs others that are wrong in depth. And the reciprocal is bounded,
    a(s) = 1 / (1 + e / s^2), which is eq. 2 for large errors.

    The weight has two factors. 1 - (1 - c) (1 - a(confirming_px)): a detection is good if the detector says so,
    confidence c, or another view confirms it closely. a(agreement_px): it is distrusted if no other view's candidate
    is near. Of two views that contradict each other neither is confirmed, so e counts from three views on.
    """
    if config.weighting == "uniform":
        return np.ones_like(confidence)
    weights = confidence
    if config.weighting == "fusion":
        error_px2 = _error_of_other_views_px2(fusion)
        several = np.asarray(confidence > 0).sum(axis=1, keepdims=True) > 2
        compared = several & np.isfinite(error_px2)
        confirmed = np.where(compared, _agreement(error_px2, rig.in_own_px(config.confirming_px)), 0.0)
        near = np.where(compared, _agreement(error_px2, rig.in_own_px(config.agreement_px)), 1.0)
        weights = (1.0 - (1.0 - confidence) * (1.0 - confirmed)) * near
    return np.clip(weights, LEAST_WEIGHT, 1.0)


def _agreement(
    error_px2: Float[np.ndarray, "frame camera joint"], scale_px: Float[np.ndarray, "camera 1"]
) -> Float[np.ndarray, "frame camera joint"]:
    """From 1 down; 1/2 where the error is the scale."""
    return 1.0 / (1.0 + error_px2 / scale_px**2)


def _error_of_other_views_px2(fusion: Fusion) -> Float[np.ndarray, "frame camera joint"]:
    """Smallest squared reprojection error that another view's candidate has in each view; NaN without another view."""
    by_view = fusion.reprojection_by_view_px2.copy()
    views = np.arange(by_view.shape[1])
    by_view[:, views, views] = np.nan
    by_view = np.where(np.isfinite(by_view), by_view, np.inf)
    smallest = by_view.min(axis=1)
    return np.where(np.isfinite(smallest), smallest, np.nan)
