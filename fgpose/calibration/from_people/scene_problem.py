"""The objective of the adjustment: reprojection errors, bones of constant length, and what is usual of lenses, clocks
and biases.

A network takes a joint to be beside where it is, by 20 to 40 mm, and always to the same side while it sees the body
from the same direction. Such errors do not average out. So each joint has in each camera, for each sector of
directions, an unknown bias.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.from_people.elimination import Eliminated, NormalEquations
from fgpose.calibration.from_people.evidence import Evidence
from fgpose.calibration.from_people.projection import CENTRE, FOCAL, N_OF_CAMERA, OFFSET, RADIAL, TRANSLATION, projected
from fgpose.calibration.from_people.scene import SceneState
from fgpose.calibration.from_people.sectors import SeenFrom
from fgpose.calibration.from_people.unknowns import Unknowns
from fgpose.geometry.camera import CameraRig
from fgpose_factors import Kernel, bone_length_and_direction, robust_loss, robust_weight

# 0.5 mm, 0.006 degrees, 0.01 % of the focal length: a fiftieth of what any result is stated to.
_STEP_TOLERANCE_M = 5e-4
_GAUGE_SHARE = 1e-5  # of the held distance; nothing else knows the scale but the priors of biases, which only pull
_LEAST_INFORMATION = 1e-6  # 1/m^2: keeps a joint that nothing determines invertible


@dataclass(frozen=True)
class SceneNoise:
    """Standard deviations of everything that enters the objective."""

    sigma_px: float
    """Of a good detection but for its bias."""
    kernel: Kernel
    kernel_scale: float
    bias_m: float
    """Of each coordinate of a bias."""
    bone_m: float
    """Of a bone around its constant length."""
    focal: float
    """Of the guess of the focal length, as a share of it."""
    k1: float
    centre: float
    """Of a principal point, each coordinate, as a share of the diagonal of the image."""
    offset_s: float


@dataclass(frozen=True, eq=False)
class _Linearized:
    """The detections around a state."""

    pull: Float[np.ndarray, "frame camera joint 2"]
    """Residuals times their information, 1/px."""
    weights: Float[np.ndarray, "frame camera joint"]
    """Information, 1/px^2."""
    by_joint: Float[np.ndarray, "frame camera joint 2 3"]
    by_camera: Float[np.ndarray, "frame camera joint 2 11"]
    by_bias: Float[np.ndarray, "frame camera joint 2 2"]


class SceneProblem:
    """A levenberg_marquardt.Problem over SceneState; steps are of shared unknowns, biases and joints.

    The first camera is held, and so is the distance from it to the farthest one: the images determine the scene but for
    a similarity.

    Args:
        rig: what the lenses start from.
        evidence: the detections.
        seen_from: directions from which the cameras see the body.
        unknowns: what is free.
        noise: standard deviations.
        start: of the optimisation.
    """

    def __init__(
        self,
        rig: CameraRig,
        evidence: Evidence,
        seen_from: SeenFrom,
        unknowns: Unknowns,
        noise: SceneNoise,
        start: SceneState,
    ) -> None:
        self._rig, self._evidence, self._seen_from, self._unknowns, self._noise = (
            rig,
            evidence,
            seen_from,
            unknowns,
            noise,
        )
        self._sector = seen_from.sector
        from_first_m = np.linalg.norm(start.positions_m - start.positions_m[0], axis=1)
        self._far = int(np.argmax(from_first_m))
        self._far_m = float(from_first_m[self._far])
        self._prior = _prior_information(unknowns, noise)
        self._stiffness = 1 / (noise.bone_m**2 * evidence.counted_as_one)
        known = np.asarray((evidence.weights > 0).any(axis=1))
        self._present = known[:, evidence.bones[:, 0]] & known[:, evidence.bones[:, 1]]
        self._n_sectors, self._in_common = len(start.bias_m), start.bias_m.shape[1] == 1
        self._start, self._n_biases, self._n_coordinates = start, start.bias_m.size, start.joints_m.size

    @property
    def unknowns(self) -> Unknowns:
        return self._unknowns

    @property
    def step_tolerance(self) -> float:
        return _STEP_TOLERANCE_M

    @property
    def damping_scale(self) -> Float[np.ndarray, " unknown"]:
        return np.append(self._unknowns.scale_m2, np.ones(self._n_biases + self._n_coordinates))

    def error(self, state: SceneState) -> float:
        residual_px, in_front = self._residual_px(state)
        noise, weights = self._noise, self._evidence.weights
        loss = robust_loss(self._squared(residual_px, in_front), noise.kernel, noise.kernel_scale)
        of_bones = np.sum(self._bones(state)[0] ** 2) * self._stiffness
        of_priors = np.sum(self._prior * state.camera_values**2) + np.sum(state.bias_m**2) / noise.bias_m**2
        return float(np.sum(weights * loss) + 0.5 * (of_bones + of_priors + self._gauge(state)[0] ** 2))

    def residual_px(self, state: SceneState) -> Float[np.ndarray, "frame camera joint"]:
        """Lengths of the reprojection errors; NaN where there is no detection, or the joint is behind the camera."""
        residual_px, in_front = self._residual_px(state)
        return np.where(in_front & (self._evidence.weights > 0), np.linalg.norm(residual_px, axis=-1), np.nan)

    def gradient(self, state: SceneState) -> Float[np.ndarray, " unknown"]:
        terms, evidence = self._linearized(state), self._evidence
        of_cameras = np.einsum("tcji,tcjik->ck", terms.pull, terms.by_camera) + self._prior * state.camera_values
        gauge, by_far = self._gauge(state)
        of_cameras[self._far, TRANSLATION] += gauge * by_far
        of_joints = np.einsum("tcji,tcjia->tja", terms.pull, terms.by_joint)
        of_biases = self._by_sector(np.einsum("tcji,tcjib->tcjb", terms.pull, terms.by_bias))
        if self._in_common:
            of_biases = of_biases.sum(axis=1, keepdims=True)
        excess_m, direction = self._bones(state)
        tension = excess_m * self._stiffness
        for bone, (start, end) in enumerate(evidence.bones.tolist()):
            of_joints[:, start] -= tension[:, bone, None] * direction[:, bone]
            of_joints[:, end] += tension[:, bone, None] * direction[:, bone]
        of_lengths = -np.bincount(evidence.length_of_bone, tension.sum(axis=0), minlength=evidence.n_lengths)
        shared = self._unknowns.columns.T @ np.append(of_cameras, of_lengths)
        of_biases += state.bias_m / self._noise.bias_m**2
        return np.concatenate([shared, of_biases.ravel(), of_joints.ravel()])

    def factorized(self, state: SceneState, damping: float) -> Eliminated | None:
        from scipy.linalg import LinAlgError

        try:
            return Eliminated(self.equations(state, damping))
        except LinAlgError:
            return None

    def moved(self, state: SceneState, step: Float[np.ndarray, " unknown"]) -> SceneState:
        n_shared = self._unknowns.n_shared
        shared, biases, joints = np.split(step, [n_shared, n_shared + self._n_biases])
        return state.moved(
            self._unknowns.of_cameras(shared),
            self._unknowns.of_lengths(shared),
            biases.reshape(state.bias_m.shape),
            joints.reshape(state.joints_m.shape),
        )

    def step_size(self, step: Float[np.ndarray, " unknown"]) -> float:
        """The largest change of a camera or a length, as metres."""
        scale = np.sqrt(self._unknowns.scale_m2)
        return float(np.max(scale * np.abs(step[: scale.size]), initial=0.0))

    def with_unknowns(self, unknowns: Unknowns) -> SceneProblem:
        """The same with other unknowns."""
        return SceneProblem(self._rig, self._evidence, self._seen_from, unknowns, self._noise, self._start)

    def equations(self, state: SceneState, damping: float = 0.0) -> NormalEquations:
        """Gauss-Newton's around a state."""
        terms, unknowns = self._linearized(state), self._unknowns
        weighted_camera = terms.weights[..., None, None] * terms.by_camera
        weighted_bias = terms.weights[..., None, None] * terms.by_bias
        n_rows, n_frames, n_of_cameras = len(unknowns.columns), len(self._sector), N_OF_CAMERA * unknowns.n_cameras
        each = np.arange(unknowns.n_cameras)
        cameras = np.zeros((*2 * (unknowns.n_cameras, N_OF_CAMERA),))
        cameras[each, :, each] = np.einsum("tcjik,tcjil->ckl", weighted_camera, terms.by_camera)
        _, by_far = self._gauge(state)
        cameras[self._far, TRANSLATION, self._far, TRANSLATION] += np.outer(by_far, by_far)
        rows = np.zeros((n_rows, n_rows))
        rows[:n_of_cameras, :n_of_cameras] = cameras.reshape(n_of_cameras, -1) + np.diag(self._prior.ravel())
        rows_joints = np.zeros((n_frames, n_rows, self._n_coordinates // n_frames))
        rows_joints[:, :n_of_cameras] = np.einsum("tcjik,tcjia->tckja", weighted_camera, terms.by_joint).reshape(
            n_frames, n_of_cameras, -1
        )
        joints = np.einsum("tcjia,tcjib->tjab", terms.weights[..., None, None] * terms.by_joint, terms.by_joint)
        joints = self._with_bones(joints, rows, rows_joints, state, damping)
        sums = self._by_sector(np.einsum("tcjik,tcjib->tcjkb", weighted_camera, terms.by_bias))
        biases = self._by_sector(np.einsum("tcjia,tcjib->tcjab", weighted_bias, terms.by_bias))
        rows_biases = np.zeros((n_rows, *biases.shape[:-1]))
        for c in range(unknowns.n_cameras):
            rows_biases[N_OF_CAMERA * c : N_OF_CAMERA * (c + 1), :, c] = np.moveaxis(sums[:, c], 2, 0)
        return NormalEquations(
            shared=unknowns.columns.T @ rows @ unknowns.columns + damping * np.diag(unknowns.scale_m2),
            biases=biases,
            joints=joints,
            shared_biases=np.tensordot(unknowns.columns.T, rows_biases, 1),
            shared_joints=unknowns.columns.T @ rows_joints,
            biases_joints=np.einsum("tcjib,tcjia->tjcba", weighted_bias, terms.by_joint),
            sector=self._sector,
            in_common=self._in_common,
            bias_prior=1 / self._noise.bias_m**2 + damping,
        )

    def camera_covariance(self, state: SceneState) -> Float[np.ndarray, "camera 11 camera 11"]:
        """Marginal covariance of the unknowns of each camera (projection.N_OF_CAMERA); zero for what is held.

        Raises:
            LinAlgError: they are not determined.
        """
        shared = Eliminated(self.equations(state)).shared_covariance()
        return self._unknowns.camera_covariance(shared)

    def _residual_px(
        self, state: SceneState
    ) -> tuple[Float[np.ndarray, "frame camera joint 2"], Bool[np.ndarray, "frame camera joint"]]:
        seen = projected(state.joints_m, self._bias_m(state), state.views(self._rig))
        return self._from_detections(seen.points_px, state), seen.in_front

    def _bias_m(self, state: SceneState) -> Float[np.ndarray, "frame camera joint 2"]:
        """Of each detection, along the axes of the image."""
        views = np.arange(self._rig.n_cameras) % state.bias_m.shape[1]
        return np.einsum("cib,tcjb->tcji", self._seen_from.axes, state.bias_m[self._sector, views])

    def _from_detections(
        self, points_px: Float[np.ndarray, "frame camera joint 2"], state: SceneState
    ) -> Float[np.ndarray, "frame camera joint 2"]:
        """A camera that is late shows at the time of a frame where the joints were before."""
        evidence = self._evidence
        return points_px - evidence.undistorted_px + state.offset_s[:, None, None] * evidence.velocity_pxps

    def _squared(
        self, residual_px: Float[np.ndarray, "frame camera joint 2"], in_front: Bool[np.ndarray, "frame camera joint"]
    ) -> Float[np.ndarray, "frame camera joint"]:
        """In standard deviations. As in GTSAM's factors, a joint behind a camera is off by twice the focal length."""
        behind_px2 = np.array([2 * (2 * camera.K[0, 0]) ** 2 for camera in self._rig.cameras])[:, None]
        return np.where(in_front, np.sum(residual_px**2, axis=-1), behind_px2) / self._noise.sigma_px**2

    def _linearized(self, state: SceneState) -> _Linearized:
        seen = projected(state.joints_m, self._bias_m(state), state.views(self._rig))
        residual_px, noise = self._from_detections(seen.points_px, state), self._noise
        robust = robust_weight(self._squared(residual_px, seen.in_front), noise.kernel, noise.kernel_scale)
        weights = np.where(seen.in_front, self._evidence.weights * robust, 0.0) / noise.sigma_px**2
        return _Linearized(
            pull=weights[..., None] * residual_px,
            weights=weights,
            by_joint=seen.by_joint,
            by_camera=np.concatenate([seen.by_camera, self._evidence.velocity_pxps[..., None]], axis=-1),
            by_bias=seen.by_bias @ self._seen_from.axes[:, None],
        )

    def _bones(self, state: SceneState) -> tuple[Float[np.ndarray, "frame bone"], Float[np.ndarray, "frame bone 3"]]:
        """By how much each bone is too long, zero where a joint is not known, and its direction."""
        start, end = self._evidence.bones.T
        distance_m, direction = bone_length_and_direction(state.joints_m[:, start], state.joints_m[:, end])
        excess_m = distance_m - state.lengths_m[self._evidence.length_of_bone]
        return np.where(self._present, excess_m, 0.0), np.where(self._present[..., None], direction, 0.0)

    def _gauge(self, state: SceneState) -> tuple[float, Float[np.ndarray, " 3"]]:
        """Whitened error of the distance that is held, and its gradient by the translation of the farthest camera."""
        apart_m = state.positions_m[self._far] - state.positions_m[0]
        distance_m = float(np.linalg.norm(apart_m))
        sigma_m = _GAUGE_SHARE * self._far_m
        by_far = apart_m / distance_m @ state.world_T_camera[self._far, :3, :3]
        return (distance_m - self._far_m) / sigma_m, by_far / sigma_m

    def _with_bones(
        self,
        of_detections: Float[np.ndarray, "frame joint 3 3"],
        rows: Float[np.ndarray, "row row"],
        rows_joints: Float[np.ndarray, "frame row coordinate"],
        state: SceneState,
        damping: float,
    ) -> Float[np.ndarray, "frame coordinate coordinate"]:
        """Information of the joints of each frame; that of the lengths is added to the rows."""
        n_frames, n_joints = state.joints_m.shape[:2]
        joints = np.zeros((n_frames, n_joints, 3, n_joints, 3))
        every = np.arange(n_joints)
        joints[:, every, :, every] = of_detections.swapaxes(0, 1) + (_LEAST_INFORMATION + damping) * np.eye(3)
        by_coordinate = rows_joints.reshape(n_frames, -1, n_joints, 3)
        _, direction = self._bones(state)
        stiffness = self._stiffness
        of_lengths = len(rows) - self._evidence.n_lengths + self._evidence.length_of_bone
        for bone, (a, b) in enumerate(self._evidence.bones.tolist()):
            along, length = direction[:, bone], of_lengths[bone]
            square = stiffness * along[:, :, None] * along[:, None, :]
            for one, other, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
                joints[:, one, :, other] += sign * square
            by_coordinate[:, length, a] += stiffness * along
            by_coordinate[:, length, b] -= stiffness * along
            rows[length, length] += stiffness * self._present[:, bone].sum() + _LEAST_INFORMATION
        return joints.reshape(n_frames, 3 * n_joints, -1)

    def _by_sector(self, of_views: Float[np.ndarray, "frame camera *rest"]) -> Float[np.ndarray, "sector camera *rest"]:
        n_cameras = of_views.shape[1]
        sums = np.zeros((self._n_sectors, *of_views.shape[1:]))
        np.add.at(sums, (self._sector, np.arange(n_cameras)), of_views)
        return sums


def _prior_information(unknowns: Unknowns, noise: SceneNoise) -> Float[np.ndarray, "camera 11"]:
    """Of what is usual of lenses and clocks; what a group shares counts once."""
    information = np.zeros((unknowns.n_cameras, N_OF_CAMERA))
    information[:, OFFSET] = 1 / noise.offset_s**2
    information[list(unknowns.centres), CENTRE] = 1 / noise.centre**2
    for row, groups, sigma in ((FOCAL, unknowns.focal, noise.focal), (RADIAL, unknowns.radial, noise.k1)):
        for group in groups:
            information[list(group), row] = 1 / (len(group) * sigma**2)
    return information
