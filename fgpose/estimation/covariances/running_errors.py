"""How large the errors of detections are and how long they last, and whether a camera has moved: learned
frame by frame."""

from __future__ import annotations

import importlib
from collections import deque
from collections.abc import Sequence
from dataclasses import astuple, dataclass

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
from fgpose.estimation.noise import LEAST_OF_STRETCH, MEMORY_S, SAME_S, sizes_over_time
from fgpose.estimation.process_noise import NEARBY_S
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.reprojection import linearized_projection
from fgpose_factors.robust_statistics import medians

_EVERY_S, _OF_ALL = 0.5, 0.25  # fits take a few milliseconds, and errors change slowly once something is known
_OTHERS_EVERY_S = 0.1  # neighbouring frames tell the same of cameras and of the correlation between joints
_LEAST_MOMENT_M2 = 1e-8  # a tenth of a millimetre
WhitenedViews = tuple[Float[np.ndarray, "1 camera joint 2"], Float[np.ndarray, "1 camera joint 2 3"]]
"""See whitened."""


class RunningSizes:
    """How large errors are lately, in the variance of all: in stretches of SAME_S; see sizes_over_time."""

    def __init__(self) -> None:
        self.size = 1.0
        """As the last stretch says that is over."""
        self._usual: _Stretch | None = None  # of all that tell what single frames find by chance
        self._stretch, self._in_stretch_s = list[Float[np.ndarray, "2 joint"]](), 0.0  # products, dimensions
        self._stretches: deque[_Stretch] = deque(maxlen=int(MEMORY_S / SAME_S))

    def add(self, products: Float[np.ndarray, "2 joint"], step_s: float) -> None:
        """Of the next frame: its squared errors and their dimensions."""
        self._stretch.append(products)
        self._in_stretch_s += step_s
        if self._in_stretch_s >= SAME_S:
            found, measurements = size_in_stretch(*np.stack(self._stretch, axis=1))
            single = np.array([size_in_stretch(*frame[:, None]) for frame in self._stretch])
            single = single[(single > 0).all(axis=1) & (found > 0)]
            by_chance = np.mean(np.log(single[:, 0] / found) ** 2 * single[:, 1]) if len(single) else np.nan
            self._stretches.append(_Stretch(found, measurements, float(by_chance), measurements / len(self._stretch)))
            known = np.array([(each.found, each.measurements) for each in self._stretches])
            self.size = float(sizes_over_time(*known.T)[-1])
            self._usual = _Stretch.usual([each for each in self._stretches if np.isfinite(each.by_chance)])
            self._stretch, self._in_stretch_s = [], 0.0

    def of_frame(self, found: float, measurements: float) -> float:
        """As lately, or larger, as far as a frame by itself differs by more than single ones do by chance."""
        usual = self._usual
        if usual is None or not found > 0 or measurements <= LEAST_OF_STRETCH * usual.in_frame:
            return self.size
        chance = usual.by_chance / measurements
        off = max(float(np.log(found / (self.size * usual.found))), 0.0)
        real = max(off**2 - chance, 0.0)
        return float(self.size * np.exp(off * real / max(real + chance, 1e-12)))


@dataclass(frozen=True)
class _Stretch:
    found: float
    """Usual squared error."""
    measurements: float
    by_chance: float
    """Variance of the logarithm of what a single frame finds, times its measurements."""
    in_frame: float
    """Measurements of a single frame."""

    @staticmethod
    def usual(stretches: list[_Stretch]) -> _Stretch | None:
        """Of these, all together; None without any."""
        if not stretches:
            return None
        found, measurements, by_chance, in_frame = np.array([astuple(each) for each in stretches]).T
        return _Stretch(
            float(np.average(found, weights=measurements)),
            float(measurements.sum()),
            float(np.average(by_chance, weights=measurements)),
            float(medians(in_frame)),
        )


class RunningErrors:
    """The components of the errors of all joints, and how far a camera may have moved; earlier frames have less weight.
    Frames are evenly spaced, by and large: lags are counted in frames.
    """

    components: ErrorComponents
    """Learned so far, without what the move of a camera explains."""
    moments_m2: Float[np.ndarray, "camera 6 6"]
    """Of the moves of the cameras, learned so far; see MoveSums."""

    def __init__(self, n_cameras: int, joints: Sequence[str]) -> None:
        importlib.import_module("scipy.optimize")  # takes 0.2 s: the first fit would stop for it
        self._joints, n_joints = joints, len(joints)
        self.components = ErrorComponents.usual(joints)
        self.moments_m2 = np.zeros((n_cameras, 6, 6))
        self._parities: deque[Parity] = deque()
        self._lags = np.zeros(1, dtype=int)
        self._sums = np.zeros((0, 2, 2, n_joints))  # by lag; of accepted detections and of all; products, dimensions
        self._others = np.zeros((2, n_joints, n_joints))  # products, dimensions
        self._axes = np.zeros((2, n_joints, 2, 3))  # of accepted detections and of all; by axis products and dimensions
        self._moves = MoveSums(np.zeros((n_cameras, 6, 6)), np.zeros((n_cameras, 6)))
        self._moved = self._moves.most_likely()
        self._n_frames, self._step_s, self._since_s, self._since_others_s = 0.0, 0.0, 0.0, np.inf
        self._within, self._around, self._variance_m2 = 0.0, 0.0, np.nan
        self._sizes = RunningSizes()

    def add(
        self,
        evidence: Evidence,
        positions_m: Float[np.ndarray, "joint 3"],
        views: WhitenedViews,
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
        if np.isfinite(variance_m2 := _variance_m2(evidence, positions_m, rig)):
            lately = float(np.exp(-step_s / NEARBY_S)) if np.isfinite(self._variance_m2) else 0.0
            self._variance_m2 = lately * np.nan_to_num(self._variance_m2) + (1 - lately) * variance_m2
        keep = float(np.exp(-step_s / MEMORY_S))
        self._within, self._around = keep * self._within + telling.within, keep * self._around + telling.around
        self._step_s = step_s if self._n_frames == 0 else keep * self._step_s + (1 - keep) * step_s
        self._n_frames = keep * self._n_frames + 1
        self._sizes.add(self._add_later(Parity.joined(list(telling.parities)), keep), step_s)
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
        self,
        evidence: Evidence,
        positions_m: Float[np.ndarray, "joint 3"],
        jacobian: Float[np.ndarray, "1 camera joint 2 3"],
        rig: CameraRig,
    ) -> Float[np.ndarray, "joint 3 3"]:
        """Covariance of the joints of a frame because a camera may have moved; see whitened."""
        if np.trace(self.moments_m2, axis1=-2, axis2=-1).max() < _LEAST_MOMENT_M2:
            return np.zeros((len(self._joints), 3, 3))
        joints = JointMoves.of(jacobian, accepted(jacobian, evidence.weights), positions_m[None], rig)
        return evidence.bias_share[0, :, None, None] * joints.covariance_m2(self.moments_m2, slice(None))[0]

    def size_in(
        self, evidence: Evidence, positions_m: Float[np.ndarray, "joint 3"], views: WhitenedViews, rig: CameraRig
    ) -> float:
        """Variance of the errors in a frame, in that of the components: what is learned of it comes a lag and half a
        second later, and if errors grow its own views show it."""
        residual, jacobian = views
        residual = without_move(residual, jacobian, positions_m[None], self._moved, rig)
        _, of_all = TellingDetections.of(residual, jacobian, evidence.weights).parities
        found, measurements = size_in_stretch(*products_later(of_all, of_all))
        # In the variances that the graph has taken lately: what is learned is in these.
        return self._sizes.of_frame(found * _variance_m2(evidence, positions_m, rig) / self._variance_m2, measurements)

    def _add_later(self, parity: Parity, keep: float) -> Float[np.ndarray, "2 joint"]:
        """Products with the frames before; the lags are by the step of the first. Those of all detections with those of
        the same frame."""
        if len(self._sums) == 0:
            self._lags = lags_of(MOST_FRAMES, max(self._step_s, 1.0 / MOST_FRAMES))
            self._sums = np.zeros((len(self._lags), 2, 2, len(self._joints)))
        self._parities.appendleft(parity)
        there = self._lags < len(self._parities)
        earlier = Parity.joined([self._parities[lag] for lag in self._lags[there].tolist()])
        newest = Parity.joined([parity] * int(there.sum()))
        # By lag and kind of detections, then products and dimensions.
        products = np.stack(products_later(earlier, newest), axis=1).reshape(-1, 2, 2, len(self._joints))
        self._sums = keep * self._sums
        self._sums[there] += products
        while len(self._parities) > self._lags[-1]:
            self._parities.pop()
        return products[0, 1]

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


def _variance_m2(evidence: Evidence, positions_m: Float[np.ndarray, "joint 3"], rig: CameraRig) -> float:
    """That the graph takes visible detections of a frame to have at the joints, the median; NaN: there are none."""
    sigma_m = evidence.sigma_px / rig.px_per_m(positions_m[None])
    told = evidence.detected & np.isfinite(sigma_m)
    return float(medians(sigma_m[told] ** 2)) if told.any() else np.nan


def whitened(evidence: Evidence, positions_m: Float[np.ndarray, "joint 3"], rig: CameraRig) -> WhitenedViews:
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
