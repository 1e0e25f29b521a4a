"""The bundle adjustment of cameras and boards: reprojection errors, their Jacobians, and the normal equations.

The pose of the first camera is held, which fixes the gauge, and so is its clock. The clocks of the others are free
where the sightings say how fast corners move. Changes of a pose are a rotation vector (radians) and a translation
(metres) in its own frame. Boards are eliminated by the Schur complement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from fgpose.calibration.adjustment.unknowns import DISTANCE_M
from fgpose.calibration.board.lens import N_OF_LENS, LensKind, image_of, moved_lens
from fgpose.calibration.board.sightings import BoardSightings
from fgpose.estimation.solvers.levenberg_marquardt import Solution, levenberg_marquardt
from fgpose_factors.kernels import robust_loss, robust_weight

N_OF_CAMERA = 6 + N_OF_LENS + 1
POSE, LENS, CLOCK = slice(0, 6), slice(6, 6 + N_OF_LENS), 6 + N_OF_LENS
# A corner that is wrong is off by many pixels. Of errors that are normal, 1 % are beyond this.
_KERNEL, _KERNEL_SCALE = "huber", 3.0
_STEP_TOLERANCE_M = 1e-6  # a hundredth of the standard deviation of a good calibration
_MAX_ITERATIONS = 100
_MIN_DEPTH_M = 1e-3
_BEHIND_PX = 1e4  # residual of a corner behind its camera
# A moment says something of directions of the unknowns that have this share of its information, beside rounding.
_TOLD = 1e-6
_CARRIED_M_S = 0.3  # about as fast as a board is: in a second of a clock it moves by so much


@dataclass(frozen=True, eq=False)
class BoardBundle:
    """A state of the adjustment."""

    world_T_camera: Float[np.ndarray, "camera 4 4"]
    lenses: Float[np.ndarray, "camera 12"]
    world_T_board: Float[np.ndarray, "moment 4 4"]
    late_s: Float[np.ndarray, " camera"]
    """How much later than the sightings say each camera saw them."""

    @staticmethod
    def on_time(
        world_T_camera: Float[np.ndarray, "camera 4 4"],
        lenses: Float[np.ndarray, "camera 12"],
        world_T_board: Float[np.ndarray, "moment 4 4"],
    ) -> BoardBundle:
        """With the times of the sightings."""
        return BoardBundle(world_T_camera, lenses, world_T_board, np.zeros(len(world_T_camera)))


class _Image(NamedTuple):
    """What the cameras see."""

    residual_px: Float[np.ndarray, "moment camera point 2"]
    """NaN where a corner is not seen."""
    by_point: Float[np.ndarray, "moment camera point 2 3"]
    """Jacobian by the point in the frame of the camera."""
    by_lens: Float[np.ndarray, "moment camera point 2 12"]
    points_m: Float[np.ndarray, "moment camera point 3"]
    """In the frame of the camera."""


@dataclass(frozen=True, eq=False)
class _Factorized:
    """The equations, boards eliminated."""

    reduced: tuple[Float[np.ndarray, "shared shared"], bool]
    cross: Float[np.ndarray, "moment shared 6"]
    inverse_boards: Float[np.ndarray, "moment 6 6"]

    def solve(self, right_hand_side: Float[np.ndarray, " unknown"]) -> Float[np.ndarray, " unknown"]:
        from scipy.linalg import cho_solve

        n_shared = self.cross.shape[1]
        of_shared, of_boards = right_hand_side[:n_shared], right_hand_side[n_shared:].reshape(-1, 6)
        eliminated = np.einsum("tab,tb->ta", self.inverse_boards, of_boards)
        shared = cho_solve(self.reduced, of_shared - np.einsum("tsa,ta->s", self.cross, eliminated))
        boards = eliminated - np.einsum("tab,tsb,s->ta", self.inverse_boards, self.cross, shared)
        return np.concatenate([shared, boards.ravel()])

    def covariance(self) -> Float[np.ndarray, "shared shared"]:
        from scipy.linalg import cho_solve

        return np.asarray(cho_solve(self.reduced, np.eye(self.cross.shape[1])))


class BoardProblem:
    """See the module."""

    def __init__(
        self, sightings: BoardSightings, kinds: Sequence[LensKind], sigma_px: Float[np.ndarray, " camera"]
    ) -> None:
        self._sightings, self._kinds = sightings, tuple(kinds)
        self.sigma_px = sigma_px
        self._points_m = sightings.board.points_m
        self._seen, self._velocity_px_s = sightings.seen, sightings.velocity_px_s
        self.columns = _columns(self._kinds, has_clocks=self._velocity_px_s is not None)
        self._last: tuple[BoardBundle, _Image] | None = None

    @property
    def n_shared(self) -> int:
        """Unknowns of the cameras."""
        return self.columns.shape[1]

    @property
    def freedom(self) -> float:
        """Share of the residuals that is not used up by unknowns."""
        n_residuals = 2 * int(self._seen.sum())
        return max(1 - (self.n_shared + 6 * len(self._seen)) / n_residuals, 1e-2)

    def with_sigma(self, sigma_px: Float[np.ndarray, " camera"]) -> BoardProblem:
        return BoardProblem(self._sightings, self._kinds, sigma_px)

    def solve(self, start: BoardBundle) -> Solution[BoardBundle]:
        return levenberg_marquardt(self, start, _MAX_ITERATIONS)

    @property
    def step_tolerance(self) -> float:
        return _STEP_TOLERANCE_M

    @property
    def damping_scale(self) -> Float[np.ndarray, " unknown"]:
        of_pose = np.repeat([DISTANCE_M**2, 1.0], 3)
        of_camera = np.concatenate([of_pose, np.full(N_OF_LENS, DISTANCE_M**2), [_CARRIED_M_S**2]])
        shared = np.max(np.tile(of_camera, len(self._kinds))[:, None] * self.columns, axis=0, initial=0.0)
        return np.append(shared, np.tile(of_pose, len(self._seen)))

    def step_size(self, step: Float[np.ndarray, " unknown"]) -> float:
        return float(np.max(np.sqrt(self.damping_scale) * np.abs(step), initial=0.0))

    def moved(self, state: BoardBundle, step: Float[np.ndarray, " unknown"]) -> BoardBundle:
        shared, boards = step[: self.n_shared], step[self.n_shared :].reshape(-1, 6)
        changes = (self.columns @ shared).reshape(-1, N_OF_CAMERA)
        lenses = np.stack([moved_lens(lens, change[LENS]) for lens, change in zip(state.lenses, changes, strict=True)])
        return BoardBundle(
            moved_poses(state.world_T_camera, changes[:, POSE]),
            lenses,
            moved_poses(state.world_T_board, boards),
            state.late_s + changes[:, CLOCK],
        )

    def residual_px(self, state: BoardBundle) -> Float[np.ndarray, "moment camera point 2"]:
        """NaN where a corner is not seen."""
        return self._image(state).residual_px

    def error(self, state: BoardBundle) -> float:
        return float(np.sum(self.losses(state)))

    def losses(self, state: BoardBundle) -> Float[np.ndarray, " camera"]:
        """The share of each camera in the error."""
        squared = self._squared(self.residual_px(state))
        return np.sum(robust_loss(squared, _KERNEL, _KERNEL_SCALE), axis=(0, 2))

    def gradient(self, state: BoardBundle) -> Float[np.ndarray, " unknown"]:
        residual, jacobian = self._linearized(state)
        pull = np.einsum("tcr,tcrk->tck", residual, jacobian)
        return np.concatenate([self.columns.T @ pull[..., :-6].sum(axis=0).ravel(), pull[..., -6:].sum(axis=1).ravel()])

    def factorized(self, state: BoardBundle, damping: float) -> _Factorized | None:
        try:
            return self.equations(state, damping)
        except np.linalg.LinAlgError:
            return None

    def equations(self, state: BoardBundle, damping: float = 0.0) -> _Factorized:
        """Gauss-Newton's around a state. Raises LinAlgError: they are not positive definite."""
        from scipy.linalg import cho_factor

        _, jacobian = self._linearized(state)
        products = jacobian.swapaxes(-1, -2) @ jacobian
        n_cameras = products.shape[1]
        of_cameras = np.zeros((n_cameras, N_OF_CAMERA, n_cameras, N_OF_CAMERA))
        of_cameras[np.arange(n_cameras), :, np.arange(n_cameras)] = products[..., :-6, :-6].sum(axis=0)
        n_rows = n_cameras * N_OF_CAMERA
        shared = self.columns.T @ of_cameras.reshape(n_rows, n_rows) @ self.columns
        cross, boards = self._of_boards(products)
        scale = self.damping_scale
        inverse_boards = np.linalg.inv(boards + damping * np.diag(scale[self.n_shared :][:6]))
        reduced = shared + damping * np.diag(scale[: self.n_shared])
        reduced -= np.einsum("tsa,tra->sr", cross @ inverse_boards, cross, optimize=True)
        return _Factorized(cho_factor(reduced), cross, inverse_boards)  # pyrefly: ignore[bad-argument-type]

    def covariance(self, state: BoardBundle) -> Float[np.ndarray, "camera 19 camera 19"]:
        """Marginal covariance of changes of the cameras; zero for what is held.

        Raises:
            LinAlgError: they are not determined.
        """
        full = self.columns @ self.equations(state).covariance() @ self.columns.T
        n_cameras = len(self._kinds)
        return full.reshape(n_cameras, N_OF_CAMERA, n_cameras, N_OF_CAMERA)

    def disagreement(self, state: BoardBundle) -> float:
        """How many times as far as the noise of corners explains moments disagree about the cameras, at a minimum: 1
        where all corners err independently, more where those of a view err together.

        Each moment alone, its board eliminated, asks for a change of the cameras. In standard deviations, the sum of
        the squares of these changes is chi-squared; the unknowns take one degree of freedom each.
        """
        residual, jacobian = self._linearized(state)
        products, pull = jacobian.swapaxes(-1, -2) @ jacobian, np.einsum("tcr,tcrk->tck", residual, jacobian)
        by_shared = self.columns.reshape(len(self._kinds), N_OF_CAMERA, self.n_shared)
        information = np.zeros((len(products), self.n_shared, self.n_shared))
        for c, block in enumerate(by_shared):
            own = np.flatnonzero(block.any(axis=0))
            of_camera = block[:, own].T @ products[:, c, :-6, :-6] @ block[:, own]
            information[:, own[:, None], own] = of_camera
        cross, boards = self._of_boards(products)
        taken = cross @ np.linalg.inv(boards)
        information -= taken @ cross.swapaxes(1, 2)
        pulls = np.einsum("cks,tck->ts", by_shared, pull[..., :-6])
        pulls -= np.einsum("tsa,ta->ts", taken, pull[..., -6:].sum(axis=1))
        # The unknowns have different units: each is counted in what all moments say of it.
        scale = np.sqrt(np.einsum("tss->s", information))
        strength, directions = np.linalg.eigh(information / np.outer(scale, scale))
        told = strength > _TOLD * strength.max(axis=-1, keepdims=True, initial=0.0)
        squares = np.einsum("tsk,ts->tk", directions, pulls / scale) ** 2
        freedom = int(told.sum()) - self.n_shared
        return float(np.sqrt(np.sum(squares[told] / strength[told]) / freedom)) if freedom > 0 else 1.0

    def _of_boards(
        self, products: Float[np.ndarray, "moment camera 25 25"]
    ) -> tuple[Float[np.ndarray, "moment shared 6"], Float[np.ndarray, "moment 6 6"]]:
        """The information of each moment between the cameras and its board, and of the board alone."""
        n_moments, n_cameras = products.shape[:2]
        between = products[..., :-6, -6:].reshape(n_moments, n_cameras * N_OF_CAMERA, 6)
        return self.columns.T @ between, products[..., -6:, -6:].sum(axis=1)

    def _squared(self, residual_px: Float[np.ndarray, "moment camera point 2"]) -> Float[np.ndarray, ...]:
        """In standard deviations; zero where nothing is seen."""
        squared = np.sum(residual_px**2, axis=-1) / self.sigma_px[:, None] ** 2
        return np.where(self._seen, squared, 0.0)

    def _image(self, state: BoardBundle) -> _Image:
        # The error, the gradient and the equations of a state are asked for one after the other.
        if self._last is None or self._last[0] is not state:
            self._last = state, self._imaged(state)
        return self._last[1]

    def _imaged(self, state: BoardBundle) -> _Image:
        board_R, board_t = state.world_T_board[:, :3, :3], state.world_T_board[:, :3, 3]
        in_world_m = self._points_m @ board_R.swapaxes(1, 2) + board_t[:, None]
        camera_R, camera_t = state.world_T_camera[:, :3, :3], state.world_T_camera[:, :3, 3]
        points_m = (in_world_m[:, None] - camera_t[:, None]) @ camera_R
        residual_px = np.full((*self._seen.shape, 2), np.nan)
        by_point, by_lens = np.zeros((*residual_px.shape, 3)), np.zeros((*residual_px.shape, N_OF_LENS))
        for c, kind in enumerate(self._kinds):
            seen = self._seen[:, c]
            own_m = points_m[:, c][seen]
            image_px, own_by_point, own_by_lens = image_of(own_m, state.lenses[c], kind.model)
            behind = own_m[:, 2] < _MIN_DEPTH_M
            own_by_point[behind], own_by_lens[behind] = 0.0, 0.0
            points_px = self._sightings.points_px[:, c][seen]
            if self._velocity_px_s is not None:
                points_px = points_px - state.late_s[c] * self._velocity_px_s[:, c][seen]
            difference = np.where(behind[:, None], _BEHIND_PX, image_px - points_px)
            for array, own in ((residual_px, difference), (by_point, own_by_point), (by_lens, own_by_lens)):
                array[:, c][seen] = own
        return _Image(residual_px, by_point, by_lens, points_m)

    def _linearized(
        self, state: BoardBundle
    ) -> tuple[Float[np.ndarray, "moment camera row"], Float[np.ndarray, "moment camera row 25"]]:
        """Whitened and weighted by the kernel: residuals and Jacobians by camera, lens and board."""
        residual_px, by_point, by_lens, points_m = self._image(state)
        weight = np.sqrt(robust_weight(self._squared(residual_px), _KERNEL, _KERNEL_SCALE)) / self.sigma_px[:, None]
        weight = np.where(self._seen, weight, 0.0)[..., None]
        camera_R_board = np.einsum("cji,tjk->tcik", state.world_T_camera[:, :3, :3], state.world_T_board[:, :3, :3])
        by_board = by_point @ camera_R_board[:, :, None]
        by_clock = np.zeros((*residual_px.shape, 1)) if self._velocity_px_s is None else self._velocity_px_s[..., None]
        jacobian = np.concatenate(
            [
                by_point @ cross_matrix(points_m),
                -by_point,
                by_lens,
                np.where(self._seen[..., None, None], by_clock, 0.0),
                -by_board @ cross_matrix(self._points_m),
                by_board,
            ],
            axis=-1,
        )
        n_moments, n_cameras, n_points = self._seen.shape
        residual = weight * np.where(self._seen[..., None], residual_px, 0.0)
        return (
            residual.reshape(n_moments, n_cameras, 2 * n_points),
            (weight[..., None] * jacobian).reshape(n_moments, n_cameras, 2 * n_points, -1),
        )


def cross_matrix(vectors: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3 3"]:
    """v -> the matrix of v x."""
    matrix = np.zeros((*vectors.shape, 3))
    for row, column, axis in ((2, 1, 0), (0, 2, 1), (1, 0, 2)):
        matrix[..., row, column], matrix[..., column, row] = vectors[..., axis], -vectors[..., axis]
    return matrix


def moved_poses(poses: Float[np.ndarray, "n 4 4"], changes: Float[np.ndarray, "n 6"]) -> Float[np.ndarray, "n 4 4"]:
    """After small changes in their own frames."""
    from scipy.spatial.transform import Rotation

    moved = poses.copy()
    moved[:, :3, :3] = poses[:, :3, :3] @ Rotation.from_rotvec(changes[:, :3]).as_matrix()
    moved[:, :3, 3] += np.einsum("nij,nj->ni", poses[:, :3, :3], changes[:, 3:])
    return moved


def _columns(kinds: Sequence[LensKind], *, has_clocks: bool) -> Float[np.ndarray, "row shared"]:
    """Changes of all cameras by the unknowns; the pose and the clock of the first have none."""
    blocks = []
    for c, kind in enumerate(kinds):
        lens = kind.columns
        n_pose, n_clock = (6 if c else 0), int(has_clocks and c > 0)
        n_both = n_pose + lens.shape[1]
        block = np.zeros((N_OF_CAMERA, n_both + n_clock))
        block[POSE, :n_pose] = np.eye(6)[:, :n_pose]
        block[LENS, n_pose:n_both] = lens
        block[CLOCK, n_both:] = 1.0
        blocks.append(block)
    columns = np.zeros((N_OF_CAMERA * len(kinds), sum(block.shape[1] for block in blocks)))
    at = 0
    for c, block in enumerate(blocks):
        columns[N_OF_CAMERA * c : N_OF_CAMERA * (c + 1), at : at + block.shape[1]] = block
        at += block.shape[1]
    return columns
