"""How large the errors of detections are and how long they last, learned frame by frame."""

from __future__ import annotations

from collections import deque

import numpy as np
from jaxtyping import Float

from fgpose.estimation.detection_errors import (
    ErrorProducts,
    Parity,
    TellingDetections,
    lags_of,
    products_later,
    share_of_visible,
)
from fgpose.estimation.evidence import Evidence
from fgpose.estimation.variance_components import ErrorComponents
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.reprojection import linearized_projection

# A network, a light and a person are the same for longer than this; a camera may be moved.
_MEMORY_S = 30.0
_EVERY_S = 0.5  # fits take a few milliseconds, and errors change slowly
_LONGEST_FRAMES = 1000  # a stream of more frames in a second is cut short


# Variance of the errors in that of the graph, before anything is known of them. The spread that the graph takes is
# learned from residuals, which are smaller online, where fewer frames contradict each other.
_TOTAL_AT_FIRST = 1.0


class RunningErrors:
    """The components of the errors of all joints; earlier frames have less weight. Frames are evenly spaced, by and
    large: lags are counted in frames.

    The correlation between joints is not learned, for the covariance of the newest pose is not simulated.
    """

    components: ErrorComponents
    """Learned so far."""

    def __init__(self, n_joints: int) -> None:
        self.components = ErrorComponents.usual(n_joints, _TOTAL_AT_FIRST)
        self._n_joints = n_joints
        self._parities: deque[Parity] = deque()
        self._lags = np.zeros(1, dtype=int)
        self._sums = np.zeros((0, 2, 2, n_joints))  # by lag; of accepted detections and of all; products, dimensions
        self._n_frames, self._step_s, self._since_s = 0.0, 0.0, 0.0
        self._within, self._around = 0.0, 0.0

    def add(self, evidence: Evidence, positions_m: Float[np.ndarray, "joint 3"], step_s: float, rig: CameraRig) -> None:
        """Take the next frame, so long after the one before, with the weights of its detections in the graph."""
        if not np.isfinite(step_s):
            return
        residual_px, jacobian, seen = linearized_projection(evidence.measured_px, rig, positions_m[None])
        sigma_px = np.where(seen, evidence.detection_sigma_px, 1.0)[..., None]
        telling = TellingDetections.of(residual_px / sigma_px, jacobian / sigma_px[..., None], evidence.weights)
        keep = float(np.exp(-step_s / _MEMORY_S))
        self._within, self._around = keep * self._within + telling.within, keep * self._around + telling.around
        self._step_s = step_s if self._n_frames == 0 else keep * self._step_s + (1 - keep) * step_s
        self._parities.appendleft(Parity.joined(list(telling.parities)))
        self._start_lags()
        self._n_frames = keep * self._n_frames + 1
        self._sums = keep * self._sums
        there = self._lags < len(self._parities)
        earlier = Parity.joined([self._parities[lag] for lag in self._lags[there]])
        newest = Parity.joined([self._parities[0]] * int(there.sum()))
        products = np.stack(products_later(earlier, newest), axis=1).reshape(-1, 2, 2, self._n_joints)
        self._sums[there] += products
        while len(self._parities) > self._lags[-1]:
            self._parities.pop()
        self._since_s += step_s
        if self._since_s >= _EVERY_S:
            self.components, self._since_s = self._fitted(), 0.0

    def _start_lags(self) -> None:
        """Lags by the step of the first frames."""
        if len(self._sums) == 0:
            self._lags = lags_of(_LONGEST_FRAMES, max(self._step_s, 1.0 / _LONGEST_FRAMES))
            self._sums = np.zeros((len(self._lags), 2, 2, self._n_joints))

    def _fitted(self) -> ErrorComponents:
        share = share_of_visible(self._within, self._around)
        products, dimensions = np.moveaxis((1 - share) * self._sums[:, 0] + share * self._sums[:, 1], 1, 0)
        nothing = np.zeros((self._n_joints, self._n_joints))
        found = ErrorProducts(self._n_frames, products, dimensions, nothing, nothing)
        return ErrorComponents.of(found, self._lags * self._step_s, self._step_s)
