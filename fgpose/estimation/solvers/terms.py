"""The factors of fgpose.estimation.frame_factors as terms of a cost in numpy, all of a kind in one expression."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.geometry.camera import Camera
from fgpose_factors import Kernel, bone_length_and_direction, projection_residual, robust_loss, robust_weight


@dataclass(frozen=True, eq=False)
class BatchState:
    """Everything that is unknown in a segment of frames, or a step or a gradient of it."""

    joints: Float[np.ndarray, "frame kind joint 3"]
    """Positions in m and, with constant velocity, velocities in m/s."""
    lengths_m: Float[np.ndarray, " length"]


class Information:
    """Gauss-Newton's information matrix of a cost around a state. A frame's unknowns are ordered by kind, joint, axis.

    Args:
        frames: to be filled; it is given because it is by far the largest array of a run.
        n_lengths: how many lengths there are.
    """

    def __init__(self, frames: Float[np.ndarray, "frame kind joint 3 kind joint 3"], n_lengths: int) -> None:
        frames[:] = 0.0
        self.frames = frames
        self.border = np.zeros((*frames.shape[:4], n_lengths))
        self.corner = np.zeros((n_lengths, n_lengths))

    @property
    def positions(self) -> Float[np.ndarray, "frame joint 3 joint 3"]:
        """Of the positions of a frame; a view."""
        return self.frames[:, 0, :, :, 0]

    @property
    def single_positions(self) -> Float[np.ndarray, "frame joint 3 3"]:
        """Of each position alone; a view."""
        return np.einsum("tjajb->tjab", self.positions)

    @property
    def single_axes(self) -> Float[np.ndarray, "frame kind kind joint 3"]:
        """Between the kinds of one joint along one axis; a view."""
        return np.einsum("tkjalja->tklja", self.frames)

    def add_rows(
        self, joints: Sequence[Int[np.ndarray, " row"]], jacobians: Sequence[Float[np.ndarray, "frame row 3"]]
    ) -> None:
        """J^T J of scalar residuals, each on the positions of several joints of a frame.

        No two rows may share a pair of joints.
        """
        for first, by_first in zip(joints, jacobians, strict=True):
            for second, by_second in zip(joints, jacobians, strict=True):
                product = by_first[..., :, None] * by_second[..., None, :]
                if first is second:
                    for row, joint in enumerate(first.tolist()):
                        self.positions[:, joint, :, joint] += product[:, row]
                else:
                    self.positions[:, first, :, second] += product.swapaxes(0, 1)


def _add_by_joint(
    gradient: BatchState, joints: Int[np.ndarray, " row"], by_row: Float[np.ndarray, "frame row 3"]
) -> None:
    """Add to the gradient by the positions of some joints, of which one may occur in several rows."""
    for row, joint in enumerate(joints.tolist()):
        gradient.joints[:, 0, joint] += by_row[:, row]


@runtime_checkable
class Term(Protocol):
    """A part of the cost: half the sum of squared whitened residuals, or of their robust losses."""

    def error(self, state: BatchState) -> float: ...

    def add_gradient(self, gradient: BatchState, state: BatchState) -> None: ...

    def add_information(self, information: Information, state: BatchState) -> None: ...


@dataclass(frozen=True, eq=False)
class Projections:
    """Reprojection errors in one camera, fgpose_factors.projection_factor."""

    camera: Camera
    measured_px: Float[np.ndarray, "frame joint 2"]
    """Finite everywhere."""
    precision: Float[np.ndarray, "frame joint"]
    """1 / sigma^2, 1/px^2; zero where there is no detection."""
    kernel: Kernel
    kernel_scale: float

    def error(self, state: BatchState) -> float:
        residual_px, _ = self._project(state)
        return float(robust_loss(self._squared(residual_px), self.kernel, self.kernel_scale).sum())

    def add_gradient(self, gradient: BatchState, state: BatchState) -> None:
        weighted, _, residual_px = self._linearized(state)
        gradient.joints[:, 0] += (weighted @ residual_px[..., None])[..., 0]

    def add_information(self, information: Information, state: BatchState) -> None:
        information.single_positions[:] += self.information(state)

    def information(self, state: BatchState) -> Float[np.ndarray, "frame joint 3 3"]:
        """On each position."""
        weighted, jacobian, _ = self._linearized(state)
        return weighted @ jacobian

    def _linearized(self, state: BatchState) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Weighted transposed Jacobian, Jacobian and residual."""
        residual_px, jacobian = self._project(state)
        weight = self.precision * robust_weight(self._squared(residual_px), self.kernel, self.kernel_scale)
        return (weight[..., None, None] * jacobian).swapaxes(-1, -2), jacobian, residual_px

    def _squared(self, residual_px: np.ndarray) -> Float[np.ndarray, "frame joint"]:
        return self.precision * np.einsum("tji,tji->tj", residual_px, residual_px)

    def _project(self, state: BatchState) -> tuple[np.ndarray, np.ndarray]:
        """Residual and its Jacobian; at or behind the camera, as GTSAM has it, twice the focal length and no slope."""
        camera, K = self.camera.camera_T_world, self.camera.K
        residual_px, (jacobian,) = projection_residual(state.joints[:, 0], camera, K, self.measured_px)
        behind = np.isnan(residual_px[..., 0])
        if behind.any():
            residual_px[behind], jacobian[behind] = 2 * K[0, 0], 0.0
        return residual_px, jacobian


@dataclass(frozen=True, eq=False)
class PointPriors:
    """Robust priors on positions, frame_factors.anchor_factors and depth_factors."""

    positions_m: Float[np.ndarray, "frame joint 3"]
    """Finite everywhere."""
    information: Float[np.ndarray, "frame joint 3 3"]
    """Inverse covariance, 1/m^2; zero where there is no prior."""
    kernel: Kernel
    kernel_scale: float

    def error(self, state: BatchState) -> float:
        residual_m = state.joints[:, 0] - self.positions_m
        return float(robust_loss(self._squared(residual_m), self.kernel, self.kernel_scale).sum())

    def add_gradient(self, gradient: BatchState, state: BatchState) -> None:
        residual_m = state.joints[:, 0] - self.positions_m
        gradient.joints[:, 0] += (self._weighted(residual_m) @ residual_m[..., None])[..., 0]

    def add_information(self, information: Information, state: BatchState) -> None:
        information.single_positions[:] += self._weighted(state.joints[:, 0] - self.positions_m)

    def _weighted(self, residual_m: np.ndarray) -> Float[np.ndarray, "frame joint 3 3"]:
        weight = robust_weight(self._squared(residual_m), self.kernel, self.kernel_scale)
        return weight[..., None, None] * self.information

    def _squared(self, residual_m: np.ndarray) -> Float[np.ndarray, "frame joint"]:
        return np.einsum("tji,tjik,tjk->tj", residual_m, self.information, residual_m)


@dataclass(frozen=True, eq=False)
class SharedLengths:
    """Every bone has its shared length, fgpose_factors.shared_bone_length_factor."""

    start: Int[np.ndarray, " bone"]
    end: Int[np.ndarray, " bone"]
    length: Int[np.ndarray, " bone"]
    present: Bool[np.ndarray, "frame bone"]
    sigma_m: float

    def error(self, state: BatchState) -> float:
        residual, _ = self._whitened(state)
        return 0.5 * float(np.sum(residual**2))

    def add_gradient(self, gradient: BatchState, state: BatchState) -> None:
        residual, direction = self._whitened(state)
        pull = residual[..., None] * direction
        _add_by_joint(gradient, self.start, -pull)
        _add_by_joint(gradient, self.end, pull)
        np.subtract.at(gradient.lengths_m, self.length, np.sum(self._weight * residual, axis=0))

    def add_information(self, information: Information, state: BatchState) -> None:
        _, direction = self._whitened(state)
        information.add_rows((self.start, self.end), (-direction, direction))
        push = self._weight[..., None] * direction
        for bone, (start, end, length) in enumerate(zip(self.start, self.end, self.length, strict=True)):
            information.border[:, 0, start, :, length] += push[:, bone]
            information.border[:, 0, end, :, length] -= push[:, bone]
            information.corner[length, length] += np.sum(self._weight[:, bone] ** 2)

    def add_tension(self, information: Information, state: BatchState) -> None:
        """The curvature that Gauss-Newton leaves out, across every bone that is longer than its length.

        A taut bone resists being swung (the geometric stiffness of mechanics). Without it steps go too far there and
        swing to and fro. That of a bone that is too short is negative and stays out.
        """
        positions_m = state.joints[:, 0]
        distance_m, direction = bone_length_and_direction(positions_m[:, self.start], positions_m[:, self.end])
        excess_m = np.maximum(distance_m - state.lengths_m[self.length], 0.0)
        stiffness = self._weight**2 * np.divide(excess_m, distance_m, out=np.zeros_like(excess_m), where=excess_m > 0)
        along = direction[..., :, None] * direction[..., None, :]
        across = stiffness[..., None, None] * (np.eye(3) - along)
        for bone, (start, end) in enumerate(zip(self.start.tolist(), self.end.tolist(), strict=True)):
            information.positions[:, start, :, start] += across[:, bone]
            information.positions[:, end, :, end] += across[:, bone]
            information.positions[:, start, :, end] -= across[:, bone]
            information.positions[:, end, :, start] -= across[:, bone]

    @property
    def _weight(self) -> Float[np.ndarray, "frame bone"]:
        return self.present / self.sigma_m

    def _whitened(self, state: BatchState) -> tuple[np.ndarray, np.ndarray]:
        """Residual, and its derivative by the end of the bone; zero where the bone is not there."""
        positions_m = state.joints[:, 0]
        distance_m, direction = bone_length_and_direction(positions_m[:, self.start], positions_m[:, self.end])
        return self._weight * (distance_m - state.lengths_m[self.length]), self._weight[..., None] * direction


@dataclass(frozen=True, eq=False)
class FrameSymmetry:
    """Left bones are as long as right ones (eq. 4), fgpose_factors.symmetric_bone_length_factor."""

    joints: Int[np.ndarray, "4 pair"]
    """Start and end of the left bone, start and end of the right one."""
    present: Bool[np.ndarray, "frame pair"]
    sigma_m: float

    def error(self, state: BatchState) -> float:
        residual, _ = self._whitened(state)
        return 0.5 * float(np.sum(residual**2))

    def add_gradient(self, gradient: BatchState, state: BatchState) -> None:
        residual, jacobians = self._whitened(state)
        for joints, jacobian in zip(self.joints, jacobians, strict=True):
            _add_by_joint(gradient, joints, residual[..., None] * jacobian)

    def add_information(self, information: Information, state: BatchState) -> None:
        _, jacobians = self._whitened(state)
        information.add_rows(tuple(self.joints), jacobians)

    def _whitened(self, state: BatchState) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        positions_m, weight = state.joints[:, 0], self.present / self.sigma_m
        left_start, left_end, right_start, right_end = (positions_m[:, joints] for joints in self.joints)
        left_m, left = bone_length_and_direction(left_start, left_end)
        right_m, right = bone_length_and_direction(right_start, right_end)
        left, right = weight[..., None] * left, weight[..., None] * right
        return weight * (left_m - right_m), (-left, left, right, -right)


@dataclass(frozen=True, eq=False)
class Motion:
    """x_{t+1} = F_t x_t with white noise, for each joint that is there in both frames."""

    strength: Float[np.ndarray, "step joint"]
    """1 / q of each joint; zero where it is not there in both frames."""
    transition: Float[np.ndarray, "step kind kind"]
    """F_t."""
    precision: Float[np.ndarray, "step kind kind"]
    """Inverse covariance of noise of density q = 1."""

    @property
    def coupling(self) -> Float[np.ndarray, "step kind kind"]:
        """Information between an earlier and a later frame, q = 1."""
        return -np.swapaxes(self.transition, 1, 2) @ self.precision

    def error(self, state: BatchState) -> float:
        unforeseen = self._unforeseen(state)
        return 0.5 * float(np.sum(unforeseen * self._weighted(self.precision, unforeseen)))

    def add_gradient(self, gradient: BatchState, state: BatchState) -> None:
        unforeseen = self._unforeseen(state)
        gradient.joints[1:] += self._weighted(self.precision, unforeseen)
        gradient.joints[:-1] += self._weighted(self.coupling, unforeseen)

    def add_information(self, information: Information, state: BatchState) -> None:
        strength = self.strength[:, None, None, :, None]
        earlier = -self.coupling @ self.transition
        information.single_axes[1:] += strength * self.precision[..., None, None]
        information.single_axes[:-1] += strength * earlier[..., None, None]

    def _unforeseen(self, state: BatchState) -> Float[np.ndarray, "step kind joint 3"]:
        return state.joints[1:] - _by_kind(self.transition, state.joints[:-1])

    def _weighted(self, matrices: np.ndarray, unforeseen: np.ndarray) -> Float[np.ndarray, "step kind joint 3"]:
        return self.strength[:, None, :, None] * _by_kind(matrices, unforeseen)


def _by_kind(matrices: np.ndarray, joints: np.ndarray) -> Float[np.ndarray, "step kind joint 3"]:
    return np.einsum("tkl,tlja->tkja", matrices, joints)


@dataclass(frozen=True, eq=False)
class Fading:
    """Velocities of unseen joints fade to that of a neighbour or to zero, fgpose_factors.fading_velocity_factor."""

    frame: Int[np.ndarray, " term"]
    joint: Int[np.ndarray, " term"]
    reference: Int[np.ndarray, " term"]
    """The neighbour; -1 for standing still."""
    precision: Float[np.ndarray, " term"]
    """1 / sigma^2, s^2/m^2."""

    def error(self, state: BatchState) -> float:
        return 0.5 * float(np.sum(self.precision[:, None] * self._residual(state) ** 2))

    def add_gradient(self, gradient: BatchState, state: BatchState) -> None:
        pull, held = self.precision[:, None] * self._residual(state), self.reference >= 0
        by_velocity = gradient.joints[:, 1]
        by_velocity[self.frame, self.joint] += pull
        np.subtract.at(by_velocity, (self.frame[held], self.reference[held]), pull[held])  # many may hang on one

    def add_information(self, information: Information, state: BatchState) -> None:
        held = self.reference >= 0
        frame, joint, reference, precision = (
            values[held] for values in (self.frame, self.joint, self.reference, self.precision)
        )
        of_velocity = information.single_axes[:, 1, 1]
        of_velocity[self.frame, self.joint] += self.precision[:, None]
        np.add.at(of_velocity, (frame, reference), precision[:, None])
        for axis in range(3):
            information.frames[frame, 1, joint, axis, 1, reference, axis] -= precision
            information.frames[frame, 1, reference, axis, 1, joint, axis] -= precision

    def _residual(self, state: BatchState) -> Float[np.ndarray, "term 3"]:
        velocities_mps = state.joints[:, 1]
        reference_mps = velocities_mps[self.frame, self.reference] * (self.reference >= 0)[:, None]
        return velocities_mps[self.frame, self.joint] - reference_mps


@dataclass(frozen=True, eq=False)
class Priors:
    """Weak priors on joints that enter, and on the shared lengths: prior_factors, length_prior_factors."""

    joints: Float[np.ndarray, "frame kind joint 3"]
    precision: Float[np.ndarray, "frame kind joint"]
    """Zero where there is no prior."""
    lengths_m: Float[np.ndarray, " length"]
    length_precision: float

    def error(self, state: BatchState) -> float:
        of_joints = self.precision[..., None] * (state.joints - self.joints) ** 2
        of_lengths = self.length_precision * (state.lengths_m - self.lengths_m) ** 2
        return 0.5 * float(of_joints.sum() + of_lengths.sum())

    def add_gradient(self, gradient: BatchState, state: BatchState) -> None:
        gradient.joints[:] += self.precision[..., None] * (state.joints - self.joints)
        gradient.lengths_m[:] += self.length_precision * (state.lengths_m - self.lengths_m)

    def add_information(self, information: Information, state: BatchState) -> None:
        for kind in range(self.precision.shape[1]):
            information.single_axes[:, kind, kind] += self.precision[:, kind, :, None]
        information.corner += self.length_precision * np.eye(len(self.lengths_m))
