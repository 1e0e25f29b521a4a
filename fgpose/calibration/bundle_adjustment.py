"""Bundle adjustment over the poses of the cameras, their clocks and the joints, with the calibration as prior.

One objective serves all calibration: half the robust squared reprojection errors that the estimator minimises, plus
half the squared changes of the calibration in standard deviations of its priors. The prior of a pose has a Cauchy
kernel, so that a bumped camera moves alone. With Gaussian priors it would cost less if all cameras shared the move,
which shifts the world (25 mm instead of 12 mm on simulated recordings with one camera turned by 1 degree).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import gtsam
import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.sightings import Sightings
from fgpose.config import Config
from fgpose.estimation.elimination import ReducedSystem, eliminate_joints
from fgpose.estimation.solvers.levenberg_marquardt import Solution, levenberg_marquardt
from fgpose.geometry.camera import Camera, CameraRig
from fgpose_factors import projection_residual, robust_loss, robust_weight

_POSE, _CLOCK = slice(0, 6), 6  # where they are among the unknowns of a camera
_N_UNKNOWNS = 7  # of a camera: rotation vector, translation, offset of the clock
_MAX_ITERATIONS = 100  # about ten are needed on the tuning clips of the benchmark
# In standard deviations of the priors: 1e-4 degrees, 5 um, 0.1 ms. A tenth of what any result is stated to.
_STEP_TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False)
class Calibration:
    """A state of the problem: how the calibration differs from the given one, and where the joints are."""

    changes: Float[np.ndarray, "camera 7"]
    """Of each camera in standard deviations of its prior: rotation, translation (in its own frame), time offset."""
    joints_m: Float[np.ndarray, "frame joint 3"]


class BundleProblem:
    """The optimisation problem (a levenberg_marquardt.Problem over Calibration).

    Args:
        rig: the calibration as it was given, the mean of the priors.
        sightings: in the frames that are used.
        config: sigma and kernel of the reprojection errors; sigmas of the priors.
        poses: whether the cameras' poses are unknown; otherwise they are held.
        clocks: whether their time offsets are; that of the first camera is always held.
    """

    def __init__(self, rig: CameraRig, sightings: Sightings, config: Config, *, poses: bool, clocks: bool) -> None:
        self._rig, self._sightings, self._config = rig, sightings, config
        self._sigmas = prior_sigmas(config)
        self._sigma_px = rig.in_own_px(config.projection.sigma_px)
        free = np.zeros((rig.n_cameras, _N_UNKNOWNS), dtype=bool)
        free[:, _POSE], free[1:, _CLOCK] = poses, clocks
        self.free: Bool[np.ndarray, " unknown"] = free.ravel()

    def error(self, state: Calibration) -> float:
        squared, known = self._squared(self._residual_px(state))
        projection, scale = self._config.projection, self._config.calibration.bumped_sigmas
        loss = robust_loss(squared, projection.kernel, projection.kernel_scale)
        of_detections = float(np.sum(self._sightings.weights * np.where(known, loss, 0.0)))
        of_poses = float(np.sum(robust_loss(self._moved_squared(state), "cauchy", scale)))
        return of_detections + of_poses + 0.5 * float(np.sum(state.changes[:, _CLOCK] ** 2))

    @property
    def step_tolerance(self) -> float:
        return _STEP_TOLERANCE

    @property
    def damping_scale(self) -> Float[np.ndarray, " unknown"]:
        return np.ones(self.free.size + self._sightings.velocities_mps.size)

    def gradient(self, state: Calibration) -> Float[np.ndarray, " unknown"]:
        residual_px, by_joint, by_camera, weights = self.projection_terms(state)
        pull = weights[..., None] * residual_px
        by_changes = np.einsum("tcji,tcjik->ck", pull, by_camera).ravel() + self.prior_terms(state)[1]
        return np.append(by_changes, np.einsum("tcji,tcjia->tja", pull, by_joint))

    def factorized(self, state: Calibration, damping: float) -> _Factorized:
        return _Factorized(
            eliminate_joints(*self.projection_terms(state), damping),
            self.prior_terms(state)[0] + damping,
            self.free,
        )

    def moved(self, state: Calibration, step: Float[np.ndarray, " unknown"]) -> Calibration:
        changes, of_joints_m = step[: self.free.size], step[self.free.size :]
        return Calibration(
            state.changes + changes.reshape(state.changes.shape),
            state.joints_m + of_joints_m.reshape(state.joints_m.shape),
        )

    def step_size(self, step: Float[np.ndarray, " unknown"]) -> float:
        """The largest change of the calibration, in standard deviations of the priors."""
        return float(np.abs(step[: self.free.size]).max())

    def solve(self, start: Calibration) -> Solution[Calibration]:
        """The minimum that is reached from this state."""
        return levenberg_marquardt(self, start, _MAX_ITERATIONS)

    def sigmas(self, state: Calibration) -> Float[np.ndarray, "camera 7"]:
        """Marginal standard deviations of the changes, in those of the priors; zero for what is held."""
        sigmas = np.zeros(len(self.free))
        sigmas[self.free] = np.sqrt(np.diag(self.factorized(state, 0.0).covariance()))
        return sigmas.reshape(-1, _N_UNKNOWNS)

    def prior_terms(self, state: Calibration) -> tuple[Float[np.ndarray, " unknown"], Float[np.ndarray, " unknown"]]:
        """Information and gradient of the priors, by the changes."""
        weights = np.ones_like(state.changes)
        scale = self._config.calibration.bumped_sigmas
        weights[:, _POSE] = robust_weight(self._moved_squared(state), "cauchy", scale)[:, None]
        return weights.ravel(), (weights * state.changes).ravel()

    def projection_terms(self, state: Calibration) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Arguments of eliminate_joints."""
        cameras = [self._of_camera(c, state) for c in range(self._rig.n_cameras)]
        residual_px, by_joint, by_camera = (np.stack(each, axis=1) for each in zip(*cameras, strict=True))
        squared, known = self._squared(residual_px)
        projection = self._config.projection
        robust = robust_weight(squared, projection.kernel, projection.kernel_scale)
        weights = np.where(known, self._sightings.weights * robust, 0.0) / self._sigma_px**2
        return np.nan_to_num(residual_px), np.nan_to_num(by_joint), np.nan_to_num(by_camera), weights

    def _residual_px(self, state: Calibration) -> Float[np.ndarray, "frame camera joint 2"]:
        delays_s = self._delays_s(state)
        residuals_px = [
            moved_camera(camera, self._sigmas * state.changes[c]).project(
                state.joints_m + delays_s[c] * self._sightings.velocities_mps
            )
            - self._sightings.undistorted_px[:, c]
            for c, camera in enumerate(self._rig.cameras)
        ]
        return np.stack(residuals_px, axis=1)

    def _squared(self, residual_px: np.ndarray) -> tuple[np.ndarray, Bool[np.ndarray, "frame camera joint"]]:
        """Squared whitened residuals, and where there is a detection of a known joint. As in GTSAM's factors a joint
        behind the camera that sees it is off by twice the focal length."""
        behind_px2 = np.array([2 * (2 * camera.K[0, 0]) ** 2 for camera in self._rig.cameras])[:, None]
        squared_px2 = np.sum(residual_px**2, axis=-1)
        squared_px2 = np.where(np.isfinite(squared_px2), squared_px2, behind_px2)
        return squared_px2 / self._sigma_px**2, self._sightings.weights > 0

    def _of_camera(self, c: int, state: Calibration) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residuals (T, J, 2) of one camera and their Jacobians by the joints (3) and by the changes (7)."""
        change, velocities_mps = self._sigmas * state.changes[c], self._sightings.velocities_mps
        camera = moved_camera(self._rig.cameras[c], change)
        joints_m = state.joints_m + self._delays_s(state)[c] * velocities_mps
        residual_px, (by_joint,) = projection_residual(
            joints_m, camera.camera_T_world, camera.K, self._sightings.undistorted_px[:, c]
        )
        # Of a point q in the camera's frame, q = Exp(-w) (R0' (p - t0) - t), by w and t.
        by_rotation = (
            by_joint
            @ camera.world_T_camera[:3, :3]
            @ _cross_matrix(camera.to_camera_frame(joints_m))
            @ gtsam.Rot3.ExpmapDerivative(change[:3])
        )
        by_translation = -by_joint @ self._rig.cameras[c].world_T_camera[:3, :3]
        by_clock = by_joint @ velocities_mps[..., None]
        return residual_px, by_joint, np.concatenate([by_rotation, by_translation, by_clock], axis=-1) * self._sigmas

    def _delays_s(self, state: Calibration) -> Float[np.ndarray, " camera"]:
        """The part of the changes that the sightings do not include yet."""
        return self._sigmas[_CLOCK] * (state.changes[:, _CLOCK] - self._sightings.offset_changes)

    def _moved_squared(self, state: Calibration) -> Float[np.ndarray, " camera"]:
        return np.sum(state.changes[:, _POSE] ** 2, axis=1)


@dataclass(frozen=True, eq=False)
class _Factorized:
    """Gauss-Newton's system around a state."""

    reduced: ReducedSystem
    prior: Float[np.ndarray, " unknown"]
    """Information of the priors on the changes, and damping."""
    free: Bool[np.ndarray, " unknown"]

    def covariance(self) -> Float[np.ndarray, "free free"]:
        """Of what is free, in standard deviations of the priors; the joints are marginalised."""
        return np.linalg.inv(self._information())

    def solve(self, right_hand_side: Float[np.ndarray, " unknown"]) -> Float[np.ndarray, " unknown"]:
        n_changes = self.free.size
        of_joints = right_hand_side[n_changes:].reshape(*self.reduced.by_step.shape[:2], 3)
        eliminated = right_hand_side[:n_changes] - self.reduced.eliminated(of_joints)
        changes = np.zeros(n_changes)
        changes[self.free] = np.linalg.solve(self._information(), eliminated[self.free])
        return np.append(changes, self.reduced.joint_steps_m(changes, of_joints))

    def _information(self) -> Float[np.ndarray, "free free"]:
        return (self.reduced.information + np.diag(self.prior))[np.ix_(self.free, self.free)]


def prior_sigmas(config: Config) -> Float[np.ndarray, " 7"]:
    """Standard deviations of the changes of a camera: radians, metres, seconds."""
    prior = config.calibration
    of_pose = [np.deg2rad(prior.rotation_sigma_deg), prior.translation_sigma_m]
    return np.array([*np.repeat(of_pose, 3), prior.offset_sigma_s])


def moved_rig(rig: CameraRig, changes: Float[np.ndarray, "camera 7"], config: Config) -> CameraRig:
    """The rig with its calibration changed; see Calibration.changes."""
    moves = changes * prior_sigmas(config)
    return CameraRig(tuple(moved_camera(camera, move) for camera, move in zip(rig.cameras, moves, strict=True)))


def moved_camera(camera: Camera, change: Float[np.ndarray, " 7"]) -> Camera:
    """The camera turned (rotation vector, radians) and moved (metres), both in its own frame, and later (seconds)."""
    world_T_camera = camera.world_T_camera.copy()
    world_T_camera[:3, 3] += world_T_camera[:3, :3] @ change[3:6]
    world_T_camera[:3, :3] = world_T_camera[:3, :3] @ gtsam.Rot3.Expmap(change[:3]).matrix()
    return replace(camera, world_T_camera=world_T_camera, time_offset_s=camera.time_offset_s + float(change[_CLOCK]))


def _cross_matrix(points: Float[np.ndarray, "*points 3"]) -> Float[np.ndarray, "*points 3 3"]:
    """[q]x, with [q]x a = q x a."""
    return np.cross(points[..., None, :], np.eye(3)).swapaxes(-1, -2)
