"""One camera against the robust triangulation of all the others."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate_without_each

# Fewer errors than this have no median worth comparing.
_MIN_ERRORS = 20


@dataclass(frozen=True, eq=False)
class HeldOutView:
    """The detections of one camera and where the other cameras expect them; NaN where either is missing."""

    detected_px: Float[np.ndarray, "frame joint 2"]
    expected_px: Float[np.ndarray, "frame joint 2"]

    @cached_property
    def constant_px(self) -> Float[np.ndarray, " 2"]:
        """Median difference: what a wrong principal point or a slightly turned camera leaves; NaN without any."""
        difference_px = self.detected_px - self.expected_px
        known = difference_px[np.isfinite(difference_px).all(axis=-1)]
        return np.median(known, axis=0) if len(known) else np.full(2, np.nan)

    def error_px(self) -> float:
        """Median distance; NaN without enough to go by."""
        error_px = np.linalg.norm(self.detected_px - self.expected_px, axis=-1)
        known = error_px[np.isfinite(error_px)]
        return float(np.median(known)) if known.size >= _MIN_ERRORS else np.nan


def compare_with_others(
    undistorted_px: Float[np.ndarray, "frame camera joint 2"],
    confidence: Float[np.ndarray, "frame camera joint"],
    rig: CameraRig,
    inlier_px: float,
) -> tuple[HeldOutView, ...]:
    """Every camera against all others; nothing is expected where there are fewer than two others.

    Args:
        inlier_px: see CameraRig.in_own_px.
    """
    expected_m = triangulate_without_each(undistorted_px, confidence, rig, rig.in_own_px(inlier_px))
    return tuple(
        HeldOutView(undistorted_px[:, c], camera.project(expected_m[c])) for c, camera in enumerate(rig.cameras)
    )
