"""How large the errors of visible detections are in each camera.

There are two measures, and each is too large for a reason of its own: so the smaller holds. Residuals against the pose
hold what is wrong with the pose. Where a limb moves more roughly than the motion model expects, they are large in all
views at once; taken for errors of the detections, they would smooth the path further, and leave larger ones. What the
views of a frame contradict each other by, the part of the residuals that no move of the joint explains, is no fault of
the path, but holds the errors of the other views: of two cameras that face each other, both seem off if one has moved.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.noise import CORRELATED_FACTOR, LEAST_SPREAD_M, shrunk, sizes_around_frames, surely_positive
from fgpose.geometry.vectors import norm
from fgpose_factors.robust_statistics import weighted_median

# So many independent measurements outweigh the prior spread: of all cameras, and of one camera against all.
PRIOR_MEASUREMENTS, PRIOR_MEASUREMENTS_OF_CAMERA = 30.0, 50.0
# Where less of the variance of a detection, along both axes, is left, that is of the other views' errors.
_LEAST_FREEDOM = 0.2
# As hardly anything is known of a joint besides its detections: one camera alone leaves its distance open.
_ANYWHERE_M = 1.0
# The robust kernel lets joints follow the views that agree. Of normal errors it leaves 0.91 to 0.97 with four views and
# 0.98 with two; 0.87 as long as they are taken for half as large.
_LEFT_BY_KERNEL = 0.9


@dataclass(frozen=True, eq=False)
class Contradictions:
    """The parts of the residuals that are left when each joint of each frame is moved to where its detections are."""

    residual_px: Float[np.ndarray, "frame camera joint 2"]
    jacobian: Float[np.ndarray, "frame camera joint 2 3"]
    """See linearized_projection."""
    information: Float[np.ndarray, "frame camera joint"]
    """Of each detection, 1/px^2; 0 of what is not used."""
    px_per_m: Float[np.ndarray, "frame camera joint"]

    @cached_property
    def single_spread_m(self) -> Float[np.ndarray, "frame camera joint"]:
        """What each detection alone says for the standard deviation of errors along each axis of the image, at the
        joint: half of those of a normal error say less. NaN where a detection tells nothing."""
        left_px, left = self._left
        squared = np.sum(left**2, axis=(-2, -1))
        degrees = np.divide(self.freedom**2, squared, out=np.ones_like(squared), where=self.tells)
        # Of a sum of squares with so many degrees of freedom (Satterthwaite 1946, Wilson and Hilferty 1931).
        median = np.where(self.tells, self.freedom * (1 - 2 / (9 * degrees)) ** 3, np.nan)
        return norm(left_px) / np.sqrt(median) / self.px_per_m / _LEFT_BY_KERNEL

    def sizes(self, step_s: float) -> Float[np.ndarray, " frame"]:
        """Variance of the errors of detections around each frame, in that of the recording."""

        def of_stretch(part: slice) -> tuple[float, float]:
            own_m = self.single_spread_m[part][self.tells[part]]
            return float(np.median(own_m)) ** 2 if own_m.size else 0.0, float(own_m.size)

        return sizes_around_frames(of_stretch, len(self.tells), step_s)

    @cached_property
    def freedom(self) -> Float[np.ndarray, "frame camera joint"]:
        """Of the variance of a detection along both axes, how much is left."""
        return np.maximum(np.trace(self._left[1], axis1=-2, axis2=-1), 0.0)

    @cached_property
    def tells(self) -> Bool[np.ndarray, "frame camera joint"]:
        """Whose residual tells how large the errors of detections are. A single view contradicts nothing."""
        used = self.information > 0
        return used & (used.sum(axis=1, keepdims=True) >= 2) & (self.freedom > _LEAST_FREEDOM)

    @cached_property
    def _left(self) -> tuple[Float[np.ndarray, "frame camera joint 2"], Float[np.ndarray, "frame camera joint 2 2"]]:
        """Of the residuals, and of their covariances, in those of the detections."""
        weighted = self.information[..., None, None] * self.jacobian
        of_joints = np.einsum("tcjia,tcjib->tjab", weighted, self.jacobian) + np.eye(3) / _ANYWHERE_M**2
        by_view = np.einsum("tjab,tcjib->tcjia", np.linalg.inv(surely_positive(of_joints)), weighted)
        moved_m = np.einsum("tcjia,tcji->tja", by_view, self.residual_px)
        left_px = self.residual_px - np.einsum("tcjia,tja->tcji", self.jacobian, moved_m)
        return left_px, np.eye(2) - np.einsum("tcjia,tcjka->tcjik", self.jacobian, by_view)


def spread_m(
    single_m: Float[np.ndarray, "frame camera joint"],
    tells: Bool[np.ndarray, "frame camera joint"],
    weights: Float[np.ndarray, "frame camera joint"],
    prior_m: float,
    independent: float,
) -> Float[np.ndarray, " camera"]:
    """Standard deviation of the visible detections of each camera, along each axis of the image, at the joint.

    Args:
        single_m: what each detection alone says for it, by one measure.
        tells: whose does.
        weights: of the detections.
        prior_m: what it usually is.
        independent: how much of an independent measurement each detection is.
    """

    def learned(which: np.ndarray, prior_m: float, prior_measurements: float) -> float:
        if not which.any():
            return prior_m
        measurements = independent * float(weights[which].sum())
        own_m = max(weighted_median(single_m[which], weights[which]), LEAST_SPREAD_M)
        return float(shrunk(own_m, measurements, prior_m, prior_measurements))

    of_all_m = learned(tells, prior_m, PRIOR_MEASUREMENTS)
    cameras = np.eye(tells.shape[1], dtype=bool)[:, None, :, None]
    return np.array([learned(tells & of_camera, of_all_m, PRIOR_MEASUREMENTS_OF_CAMERA) for of_camera in cameras])


def graph_sigma_px(
    evidence: Evidence, spread_m: Float[np.ndarray, "*#frame camera"], px_per_m: Float[np.ndarray, "frame camera joint"]
) -> Float[np.ndarray, "frame camera joint"]:
    """The standard deviations that the graph should take for detections of visible joints.

    Args:
        evidence: keeps its own where the scale is not known.
        spread_m: of each camera, perhaps in each frame; see DetectionResiduals.spread_m.
        px_per_m: scale of the image at the joint; NaN where it is not known.
    """
    sigma_px = CORRELATED_FACTOR * spread_m[..., None] * px_per_m
    return np.where(np.isfinite(sigma_px), sigma_px, evidence.sigma_px)


def spread_m_of(evidence: Evidence, px_per_m: Float[np.ndarray, "frame camera joint"]) -> Float[np.ndarray, " camera"]:
    """The spread of each camera from which graph_sigma_px made the standard deviations, root mean square over time; inf
    where it has no detection."""
    spread_m = evidence.sigma_px / (CORRELATED_FACTOR * px_per_m)
    told = evidence.detected & np.isfinite(spread_m)
    squared_m2, n_told = np.sum(spread_m**2, axis=(0, 2), where=told), told.sum(axis=(0, 2))
    return np.where(n_told > 0, np.sqrt(squared_m2 / np.maximum(n_told, 1)), np.inf)
