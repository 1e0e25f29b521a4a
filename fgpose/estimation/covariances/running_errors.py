"""How large the errors of detections are and how long they last, and whether a camera has moved: learned
frame by frame."""

from __future__ import annotations

import importlib
from collections import deque
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from fgpose.estimation.covariances.detection_errors import (
    ErrorProducts,
    Parity,
    TellingDetections,
    accepted,
    lags_of,
    products_later,
    products_of_axes,
    products_of_others,
    share_of_visible,
)
from fgpose.estimation.covariances.rig_errors import MOVE_MEMORY_S, CameraMoves, JointMoves, MoveSums, without_move
from fgpose.estimation.covariances.variance_components import (
    MOST_FRAMES,
    ErrorComponents,
    size_in_stretch,
)
from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.noise import MEMORY_S, SAME_S, sizes_over_time
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.reprojection import linearized_projection

_EVERY_S, _OF_ALL = 0.5, 0.25  # fits take a few milliseconds, and errors change slowly once something is known
_OTHERS_EVERY_S = 0.1  # neighbouring frames tell the same of cameras and of the correlation between joints
_LEAST_MOMENT_M2 = 1e-8  # a tenth of a millimetre


class RunningErrors:
    """The components of the errors of all joints, and how far a camera may have moved; earlier frames have less weight.
    Frames are evenly spaced, by and large: lags are counted in frames.
    """

    components: ErrorComponents
    """Learned so far, without what the move of a camera explains."""
    moments_m2: Float[np.ndarray, "camera 6 6"]
    """Of the moves of the cameras, learned so far; see MoveSums."""
    size: float
    """Variance of the errors lately, in that of the components; see sizes_over_time."""

    def __init__(self, n_cameras: int, joints: Sequence[str]) -> None:
        importlib.import_module("scipy.optimize")  # takes 0.2 s: the first fit would stop for it
        self._joints, n_joints = joints, len(joints)
        self.components = ErrorComponents.usual(joints)
        self.moments_m2, self.size = np.zeros((n_cameras, 6, 6)), 1.0
        self._parities: deque[Parity] = deque()
        self._lags = np.zeros(1, dtype=int)
        self._sums = np.zeros((0, 2, 2, n_joints))  # by lag; of accepted detections and of all; products, dimensions
        self._others = np.zeros((2, n_joints, n_joints))  # products, dimensions
        self._axes = np.zeros((2, n_joints, 2, 3))  # of accepted detections and of all; by axis products and dimensions
        self._moves = MoveSums(np.zeros((n_cameras, 6, 6)), np.zeros((n_cameras, 6)))
        self._moved = self._moves.most_likely()
        self._n_frames, self._step_s, self._since_s, self._since_others_s = 0.0, 0.0, 0.0, np.inf
        self._within, self._around = 0.0, 0.0
        self._stretch, self._in_stretch_s = list[Float[np.ndarray, "2 joint"]](), 0.0  # products, dimensions
        self._stretches: deque[tuple[float, float]] = deque(maxlen=int(MEMORY_S / SAME_S))

    def add(
        self,
        evidence: Evidence,
        positions_m: Float[np.ndarray, "joint 3"],
        views: tuple[Float[np.ndarray, "1 camera joint 2"], Float[np.ndarray, "1 camera joint 2 3"]],
        step_s: float,
        rig: CameraRig,
    ) -> None:
        """Take the next frame, so long after the one before, with the weights of its detections in the graph, and what
        they are whitened."""
        residual, jacobian = views
        self._since_others_s += step_s
        tells_others = self._since_others_s >= _OTHERS_EVERY_S
        if tells_others:
            good = accepted(jacobian, evidence.weights)
            joints = JointMoves.of(jacobian, good, positions_m[None], rig)
            moves = CameraMoves.of(residual, joints).sums(slice(None))
            self._moves = moves.plus(self._moves, float(np.exp(-self._since_others_s / MOVE_MEMORY_S)))
            self._moved = self._moves.most_likely()
        residual = without_move(residual, jacobian, positions_m[None], self._moved, rig)
        telling = TellingDetections.of(residual, jacobian, evidence.weights)
        keep = float(np.exp(-step_s / MEMORY_S))
        self._within, self._around = keep * self._within + telling.within, keep * self._around + telling.around
        self._step_s = step_s if self._n_frames == 0 else keep * self._step_s + (1 - keep) * step_s
        self._n_frames = keep * self._n_frames + 1
        self._add_later(Parity.joined(list(telling.parities)), keep)
        self._end_stretch(step_s)
        if tells_others:
            memory = float(np.exp(-self._since_others_s / MEMORY_S))
            self._others = memory * self._others + np.stack(products_of_others(telling.parities[0]))
            by_axis = (products_of_axes(parity) for parity in telling.parities)
            self._axes = memory * self._axes + [np.dstack([products, dims]) for products, dims in by_axis]
            self._since_others_s = 0.0
        self._since_s += step_s
        if self._since_s >= min(_EVERY_S, _OF_ALL * self._n_frames * self._step_s):
            self._fit()

    def of_cameras_m2(
        self, evidence: Evidence, positions_m: Float[np.ndarray, "joint 3"], rig: CameraRig
    ) -> Float[np.ndarray, "joint 3 3"]:
        """Covariance of the joints of a frame because a camera may have moved."""
        if np.trace(self.moments_m2, axis1=-2, axis2=-1).max() < _LEAST_MOMENT_M2:
            return np.zeros((len(self._joints), 3, 3))
        _, jacobian = whitened(evidence, positions_m, rig)
        joints = JointMoves.of(jacobian, accepted(jacobian, evidence.weights), positions_m[None], rig)
        return evidence.bias_share[0, :, None, None] * joints.covariance_m2(self.moments_m2, slice(None))[0]

    def _end_stretch(self, step_s: float) -> None:
        """If it is as long as errors are taken for equally large."""
        self._in_stretch_s += step_s
        if self._in_stretch_s >= SAME_S:
            self._stretches.append(size_in_stretch(*np.stack(self._stretch, axis=1)))
            self.size = float(sizes_over_time(*np.array(self._stretches).T)[-1])
            self._stretch, self._in_stretch_s = [], 0.0

    def _add_later(self, parity: Parity, keep: float) -> None:
        """Products with the frames before; the lags are by the step of the first."""
        if len(self._sums) == 0:
            self._lags = lags_of(MOST_FRAMES, max(self._step_s, 1.0 / MOST_FRAMES))
            self._sums = np.zeros((len(self._lags), 2, 2, len(self._joints)))
        self._parities.appendleft(parity)
        there = self._lags < len(self._parities)
        earlier = Parity.joined([self._parities[lag] for lag in self._lags[there].tolist()])
        newest = Parity.joined([parity] * int(there.sum()))
        # By lag and kind of detections, then products and dimensions.
        products = np.stack(products_later(earlier, newest), axis=1).reshape(-1, 2, 2, len(self._joints))
        self._stretch.append(products[0, 1])  # of all detections, with those of the same frame
        self._sums = keep * self._sums
        self._sums[there] += products
        while len(self._parities) > self._lags[-1]:
            self._parities.pop()

    def _fit(self) -> None:
        share = share_of_visible(self._within, self._around)
        products, dimensions = np.moveaxis((1 - share) * self._sums[:, 0] + share * self._sums[:, 1], 1, 0)
        axes = (1 - share) * self._axes[0] + share * self._axes[1]
        found = ErrorProducts(
            self._n_frames, products, dimensions, *self._others, axes=axes[..., 0], axes_dimensions=axes[..., 1:]
        )
        self.components = ErrorComponents.of(found, self._lags * self._step_s, self._step_s, self._joints)
        independent = self.components.independent(MOVE_MEMORY_S, self._step_s) * _OTHERS_EVERY_S / self._step_s
        self.moments_m2, self._since_s = self._moves.moments(independent), 0.0


def whitened(
    evidence: Evidence, positions_m: Float[np.ndarray, "joint 3"], rig: CameraRig
) -> tuple[Float[np.ndarray, "1 camera joint 2"], Float[np.ndarray, "1 camera joint 2 3"]]:
    """Residuals against the detections, biases included, and their Jacobians, in standard deviations."""
    residual_px, jacobian, seen = linearized_projection(evidence.measured_px, rig, positions_m[None])
    sigma_px = np.where(seen, evidence.detection_sigma_px, 1.0)[..., None]
    return residual_px / sigma_px, jacobian / sigma_px[..., None]


def information_by_axis(
    jacobian: Float[np.ndarray, "frame camera joint 2 3"],
) -> Float[np.ndarray, "frame joint axis 3 3"]:
    """Of the detections on each joint, 1/m^2, by axis of the image; from Jacobians in standard deviations."""
    by_camera = jacobian.transpose(0, 2, 3, 4, 1)
    return by_camera @ by_camera.swapaxes(-1, -2)
