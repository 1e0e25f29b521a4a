"""The optimisation problem of the bundle adjustment, by which all calibration is done.

One objective: half the robust squared reprojection errors that the estimator minimises, plus half the squared changes
of the cameras and the biases of the detections, in standard deviations of their priors (noise).

A network takes a joint to be beside where it is, by 20 to 40 mm, and always to the same side while it sees the body
from the same direction. Such errors do not average out. So each joint may have, for each sector of directions, an
unknown bias, which is that of all cameras.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.adjustment.cameras import Projection, Views
from fgpose.calibration.adjustment.noise import Noise
from fgpose.calibration.adjustment.normal_equations import Factorized
from fgpose.calibration.adjustment.sightings import SeenFrom, Sightings
from fgpose.calibration.adjustment.unknowns import N_OF_CAMERA, OFFSET, POSE, TRANSLATION, Unknowns
from fgpose.estimation.solvers.elimination import ReducedSystem, eliminate_joints
from fgpose.estimation.solvers.levenberg_marquardt import Solution, levenberg_marquardt
from fgpose.geometry.camera import CameraRig
from fgpose_factors import robust_loss, robust_weight

# 0.5 mm, 0.006 degrees, 0.01 % of the focal length: a fiftieth of what a rig from nothing but people is stated to.
_STEP_TOLERANCE_M = 5e-4
_MAX_ITERATIONS = 100  # about ten are needed on the tuning clips of the benchmark
_MEDIAN_OF_SIX = 5.348  # of the sum of the squares of six standard normal variables
_GAUGE_SHARE = 1e-5  # of the held distance; nothing else knows the scale but the priors of biases, which only pull


@dataclass(frozen=True, eq=False)
class Bundle:
    """What the adjustment estimates."""

    changes: Float[np.ndarray, "camera 11"]
    """Of the cameras from what they were given as (unknowns.N_OF_CAMERA)."""
    joints_m: Float[np.ndarray, "frame joint 3"]
    """Zero where there is none."""
    bias_m: Float[np.ndarray, "joint sector 2"]
    """Of the detections, metres at the joint, along the axes of SeenFrom."""

    @staticmethod
    def of(
        changes: Float[np.ndarray, "camera 11"], joints_m: Float[np.ndarray, "frame joint 3"], n_sectors: int = 0
    ) -> Bundle:
        """Without biases; joints: NaN = not known."""
        return Bundle(changes, np.nan_to_num(joints_m), np.zeros((joints_m.shape[1], n_sectors, 2)))


@dataclass(frozen=True, eq=False)
class Linearized:
    """The detections around a state; the arguments of eliminate_joints."""

    residual_px: Float[np.ndarray, "frame camera joint 2"]
    by_joint: Float[np.ndarray, "frame camera joint 2 3"]
    by_camera: Float[np.ndarray, "frame camera joint 2 11"]
    by_bias: Float[np.ndarray, "frame camera joint 2 bias"]
    weights: Float[np.ndarray, "frame camera joint"]
    """Information, 1/px^2."""


class BundleProblem:
    """A levenberg_marquardt.Problem over Bundle; steps are of shared unknowns, biases and joints.

    Where the pose of the first camera is held and others are free, so is the distance from it to the farthest one: the
    images determine the scene but for a similarity.

    Args:
        rig: as it was given.
        sightings: the detections.
        unknowns: what is free of the cameras.
        noise: standard deviations.
        seen_from: directions from which the cameras see the body; None: there are no biases.
        step_tolerance_m: converged when no camera changes by more, as metres (Unknowns.scale_m2).
    """

    def __init__(
        self,
        rig: CameraRig,
        sightings: Sightings,
        unknowns: Unknowns,
        noise: Noise,
        seen_from: SeenFrom | None = None,
        step_tolerance_m: float = _STEP_TOLERANCE_M,
    ) -> None:
        n_frames, n_cameras, n_joints = sightings.weights.shape
        self.rig, self.sightings, self.unknowns, self._noise = rig, sightings, unknowns, noise
        self._seen_from = seen_from or SeenFrom.anywhere(n_frames, n_cameras)
        self._step_tolerance_m = step_tolerance_m
        self._measured_px = np.where(sightings.weights[..., None] > 0, sightings.undistorted_px, 0.0)
        self._prior = noise.information(unknowns)
        self._n_biases = 2 * n_joints * self._seen_from.sector.shape[-1]
        self._n_coordinates = 3 * n_frames * n_joints
        self._gauge = _Gauge.of(rig) if unknowns.poses and 0 not in unknowns.poses else None

    @property
    def step_tolerance(self) -> float:
        return self._step_tolerance_m

    @property
    def damping_scale(self) -> Float[np.ndarray, " unknown"]:
        return np.append(self.unknowns.scale_m2, np.ones(self._n_biases + self._n_coordinates))

    @property
    def sigma_px(self) -> Float[np.ndarray, " camera"]:
        """Of a good detection with independent errors."""
        return self._noise.sigma_px

    def solve(self, start: Bundle) -> Solution[Bundle]:
        """The minimum that is reached from this state."""
        return levenberg_marquardt(self, start, _MAX_ITERATIONS)

    def error(self, state: Bundle) -> float:
        projection, noise = self._projection(state), self._noise
        squared = self._squared(self._from_detections(projection, state), projection.in_front)
        of_detections = self.sightings.weights * robust_loss(squared, noise.kernel, noise.kernel_scale)
        of_poses = robust_loss(self._moved_squared(state), "cauchy", noise.moved_scale)
        held = 0.0 if self._gauge is None else self._gauge.residual(state.changes)[0]
        of_rest = np.sum((self._prior * state.changes**2)[:, POSE.stop :]) + np.sum(state.bias_m**2) / noise.bias_m**2
        return float(np.sum(of_detections) + np.sum(of_poses) + 0.5 * (of_rest + held**2))

    def residual_px(self, state: Bundle) -> Float[np.ndarray, "frame camera joint"]:
        """Lengths of the reprojection errors, biases taken out; NaN where there is no detection, or the joint is behind
        the camera."""
        projection = self._projection(state)
        length_px = np.linalg.norm(self._from_detections(projection, state), axis=-1)
        return np.where(projection.in_front & (self.sightings.weights > 0), length_px, np.nan)

    def gradient(self, state: Bundle, terms: Linearized | None = None) -> Float[np.ndarray, " unknown"]:
        """Of the error; with the linearized state, where it is known."""
        terms = self.linearized(state) if terms is None else terms
        pull = terms.weights[..., None] * terms.residual_px
        of_cameras = np.einsum("tcji,tcjik->ck", pull, terms.by_camera)
        of_cameras += self._prior_weights(state) * state.changes
        if self._gauge is not None:
            residual, by_far = self._gauge.residual(state.changes)
            of_cameras[self._gauge.far, TRANSLATION] += residual * by_far
        of_biases = np.einsum("tcji,tcjib->jb", pull, terms.by_bias).ravel()
        of_biases += state.bias_m.ravel() / self._noise.bias_m**2
        of_joints = np.einsum("tcji,tcjia->tja", pull, terms.by_joint)
        return np.concatenate([self.unknowns.columns.T @ of_cameras.ravel(), of_biases, of_joints.ravel()])

    def factorized(self, state: Bundle, damping: float) -> Factorized | None:
        from scipy.linalg import LinAlgError

        try:
            return self.equations(state, damping)
        except LinAlgError:
            return None

    def moved(self, state: Bundle, step: Float[np.ndarray, " unknown"]) -> Bundle:
        n_shared = self.unknowns.n_shared
        shared, biases, joints = np.split(step, [n_shared, n_shared + self._n_biases])
        return Bundle(
            state.changes + self.unknowns.of_cameras(shared),
            state.joints_m + joints.reshape(state.joints_m.shape),
            state.bias_m + biases.reshape(state.bias_m.shape),
        )

    def step_size(self, step: Float[np.ndarray, " unknown"]) -> float:
        """The largest change of a camera, as metres."""
        scale = np.sqrt(self.unknowns.scale_m2)
        return float(np.max(scale * np.abs(step[: scale.size]), initial=0.0))

    def with_unknowns(self, unknowns: Unknowns) -> BundleProblem:
        """The same with other unknowns."""
        return BundleProblem(self.rig, self.sightings, unknowns, self._noise, self._seen_from, self._step_tolerance_m)

    def equations(self, state: Bundle, damping: float = 0.0, reduced: ReducedSystem | None = None) -> Factorized:
        """Gauss-Newton's around a state, factorised.

        Args:
            state: see linearized.
            damping: of Levenberg and Marquardt.
            reduced: what without_joints says of the state and the damping, where it is known.

        Raises:
            LinAlgError: they are not positive definite.
        """
        reduced, columns = reduced or self.without_joints(self.linearized(state), damping), self.unknowns.columns
        rows = np.diag(self._prior_weights(state).ravel())
        if self._gauge is not None:
            _, by_far = self._gauge.residual(state.changes)
            of_far = N_OF_CAMERA * self._gauge.far + np.arange(TRANSLATION.start, TRANSLATION.stop)
            rows[np.ix_(of_far, of_far)] += np.outer(by_far, by_far)
        of_shared = columns.T @ rows @ columns + damping * np.diag(self.unknowns.scale_m2)
        return Factorized(reduced, columns, of_shared, self._noise.bias_m**-2 + damping)

    @staticmethod
    def without_joints(terms: Linearized, damping: float = 0.0) -> ReducedSystem:
        """The same whatever is free of the cameras."""
        return eliminate_joints(
            terms.residual_px, terms.by_joint, terms.by_camera, terms.weights, damping, terms.by_bias
        )

    def covariance(
        self, state: Bundle, of_scores: Float[np.ndarray, "shared shared"] | None = None
    ) -> Float[np.ndarray, "camera 11 camera 11"]:
        """Marginal covariance of small changes of each camera as it is now, in its own frame; biases and joints are
        unknown too. Zero for what is held.

        Args:
            state: the optimum.
            of_scores: see Factorized.covariance.

        Raises:
            LinAlgError: they are not determined.
        """
        columns = self._own_columns(state)
        shared = self.equations(state).covariance(of_scores)
        return np.einsum("ciu,uv,djv->cidj", columns, shared, columns, optimize=True)

    def covariance_with_middle(self, state: Bundle) -> Float[np.ndarray, "row row"]:
        """Of the poses of all cameras, as in covariance, camera after camera, and then of the mean of the positions of
        the joints that two cameras see.

        Raises:
            LinAlgError: they are not determined.
        """
        from scipy.linalg import block_diag

        columns = self._own_columns(state)[:, POSE].reshape(-1, self.unknowns.n_shared)
        rows = block_diag(columns, np.eye(3))
        return rows @ self.equations(state).covariance_with_middle(self.seen_by_two) @ rows.T

    @property
    def seen_by_two(self) -> Bool[np.ndarray, "frame joint"]:
        """Joints that two cameras or more see."""
        return np.asarray(np.sum(self.sightings.weights > 0, axis=1) >= 2)

    def _own_columns(self, state: Bundle) -> Float[np.ndarray, "camera 11 shared"]:
        """The unknowns as small changes of each camera as it is now, in its own frame."""
        own_by_changes = np.tile(np.eye(N_OF_CAMERA), (self.rig.n_cameras, 1, 1))
        own_by_changes[:, POSE, POSE] = Views.of(self.rig, state.changes).own_by_pose
        return own_by_changes @ self.unknowns.columns.reshape(self.rig.n_cameras, N_OF_CAMERA, -1)

    def covariance_of_prior_scores(self, state: Bundle) -> Float[np.ndarray, "shared shared"]:
        """Of what the priors add to the gradient at the truth, which is as far from their means as they say. Those of
        the poses were too narrow if the cameras had to be moved by more, on median."""
        of_cameras = self._prior_weights(state)
        of_cameras[:, POSE] *= self._widened(state)
        of_cameras[:, OFFSET] /= self._noise.of_clocks
        return self.unknowns.columns.T @ (of_cameras.ravel()[:, None] * self.unknowns.columns)

    def shift_sigma_m(self, state: Bundle) -> float:
        """Standard deviation of each coordinate of a shift of all cameras and joints together, root mean square.

        Images hardly show it: it is known as well as the priors say, which were too narrow if the cameras had to be
        moved by more, on median.

        Raises:
            LinAlgError: the cameras are not determined.
        """
        covariance_m2 = self.equations(state).covariance_with_middle(self.seen_by_two)[-3:, -3:]
        return float(np.sqrt(np.trace(covariance_m2) / 3 * self._widened(state)))

    def _widened(self, state: Bundle) -> float:
        """By how much the variances of the priors of the poses were too small."""
        return max(1.0, float(np.median(self._moved_squared(state))) / _MEDIAN_OF_SIX)

    def _prior_weights(self, state: Bundle) -> Float[np.ndarray, "camera 11"]:
        """Information of the priors, where those of the poses are robust."""
        weights = self._prior.copy()
        weights[:, POSE] *= robust_weight(self._moved_squared(state), "cauchy", self._noise.moved_scale)[:, None]
        return weights

    def _moved_squared(self, state: Bundle) -> Float[np.ndarray, " camera"]:
        return np.sum((self._prior * state.changes**2)[:, POSE], axis=1)

    def _projection(self, state: Bundle) -> Projection:
        bias_m = np.einsum("cib,tcs,jsb->tcji", self._seen_from.axes, self._seen_from.sector, state.bias_m)
        return Projection(state.joints_m, bias_m, Views.of(self.rig, state.changes))

    def _from_detections(self, projection: Projection, state: Bundle) -> Float[np.ndarray, "frame camera joint 2"]:
        """Residuals: a camera that is late saw the joints where they are later."""
        sightings = self.sightings
        late_s = state.changes[:, OFFSET] - sightings.offsets_s
        return projection.points_px - self._measured_px + late_s[:, None, None] * sightings.velocity_pxps

    def _squared(
        self, residual_px: Float[np.ndarray, "frame camera joint 2"], in_front: Bool[np.ndarray, "frame camera joint"]
    ) -> Float[np.ndarray, "frame camera joint"]:
        """In standard deviations. As in GTSAM's factors, a joint behind a camera is off by twice the focal length."""
        behind_px2 = np.array([2 * (2 * camera.K[0, 0]) ** 2 for camera in self.rig.cameras])[:, None]
        squared_px2 = np.where(in_front, np.sum(residual_px**2, axis=-1), behind_px2)
        return squared_px2 / self._noise.sigma_px[:, None] ** 2

    def linearized(self, state: Bundle) -> Linearized:
        """Detections and their derivatives around a state."""
        projection, noise, sightings = self._projection(state), self._noise, self.sightings
        residual_px, jacobians = self._from_detections(projection, state), projection.jacobians()
        squared = self._squared(residual_px, projection.in_front)
        robust = robust_weight(squared, noise.kernel, noise.kernel_scale)
        weights = np.where(projection.in_front, sightings.weights * robust, 0.0) / noise.sigma_px[:, None] ** 2
        by_own = jacobians.by_bias @ self._seen_from.axes[:, None]
        by_bias = np.einsum("tcjib,tcs->tcjisb", by_own, self._seen_from.sector)
        return Linearized(
            residual_px=residual_px,
            by_joint=jacobians.by_joint,
            by_camera=np.concatenate([jacobians.by_camera, sightings.velocity_pxps[..., None]], axis=-1),
            by_bias=by_bias.reshape(*residual_px.shape, -1),
            weights=weights,
        )


@dataclass(frozen=True, eq=False)
class _Gauge:
    """The distance from the first camera, which is held, to the farthest one."""

    far: int
    from_first_m: Float[np.ndarray, " 3"]
    """Before any change, in the frame of that camera as it was given."""

    @staticmethod
    def of(rig: CameraRig) -> _Gauge:
        from_first_m = rig.positions_m - rig.positions_m[0]
        far = int(np.argmax(np.linalg.norm(from_first_m, axis=1)))
        return _Gauge(far, from_first_m[far] @ rig.cameras[far].world_T_camera[:3, :3])

    def residual(self, changes: Float[np.ndarray, "camera 11"]) -> tuple[float, Float[np.ndarray, " 3"]]:
        """Whitened error of the distance, and its gradient by the translation of the far camera."""
        held_m, apart_m = np.linalg.norm(self.from_first_m), self.from_first_m + changes[self.far, TRANSLATION]
        distance_m = np.linalg.norm(apart_m)
        sigma_m = _GAUGE_SHARE * held_m
        return float((distance_m - held_m) / sigma_m), apart_m / distance_m / sigma_m
