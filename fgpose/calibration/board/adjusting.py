"""The adjustment with a noise that is measured from its own residuals, and without views that are wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from fgpose.assessment.metrics import mean_known
from fgpose.calibration.board.lens import LensKind
from fgpose.calibration.board.problem import BoardBundle, BoardProblem
from fgpose.calibration.board.sightings import BoardSightings, LeftOut
from fgpose_factors.robust_statistics import known_median, robust_sigma

_ROUNDS = 3  # of noise and solution in turns; the noise changes by less than a hundredth in the third
_LEAST_SIGMA_PX = 1e-6  # of corners without any noise
# Of views of which all is right, the root mean square is never twice the usual one; one of a board that bends, or whose
# first corner is another one, is off by many times as much.
_WRONG_VIEW = 4.0
_LEAST_WRONG_PX = 0.3  # corners that are better are not wrong, however good the others are


@dataclass(frozen=True, eq=False)
class AdjustedBoards:
    """A minimum of the adjustment."""

    sightings: BoardSightings
    """What was used."""
    kinds: tuple[LensKind, ...]
    problem: BoardProblem
    bundle: BoardBundle
    converged: bool

    @property
    def criterion(self) -> float:
        """Akaike's, for a noise that is not known: n log(error) of each camera, and two for each unknown."""
        n_residuals = 2 * self.sightings.seen.sum(axis=(0, 2))
        # The losses are in units of the sigmas, halved as in a graph.
        square_px2 = 2 * self.problem.losses(self.bundle) * self.problem.sigma_px**2 / n_residuals
        told = float(np.sum(n_residuals * np.log(np.maximum(square_px2, _LEAST_SIGMA_PX**2))))
        return told + 2 * self.problem.n_shared

    @property
    def residual_px(self) -> Float[np.ndarray, "moment camera point 2"]:
        return self.problem.residual_px(self.bundle)

    @property
    def rms_px(self) -> Float[np.ndarray, " camera"]:
        """Root mean square of the lengths of the reprojection errors; NaN: none."""
        by_camera = np.sum(self.residual_px**2, axis=-1).swapaxes(0, 1)
        return np.sqrt(mean_known(by_camera.reshape(len(by_camera), -1), axis=1))


def adjust(sightings: BoardSightings, kinds: Sequence[LensKind], start: BoardBundle) -> AdjustedBoards:
    """To the minimum that is reached from a start, with the noise of each camera as its residuals show it."""
    problem = BoardProblem(sightings, kinds, np.ones(len(kinds)))
    bundle, converged = start, False
    for _ in range(_ROUNDS):
        problem = problem.with_sigma(_sigma_px(problem, bundle))
        solution = problem.solve(bundle)
        bundle, converged = solution.state, solution.convergence.converged
    problem = problem.with_sigma(_sigma_px(problem, bundle))
    return AdjustedBoards(sightings, tuple(kinds), problem, bundle, converged)


def wrong_views(adjusted: AdjustedBoards) -> Bool[np.ndarray, "moment camera"]:
    """Views that do not agree with the rest."""
    rms_px = view_rms_px(adjusted)
    usual_px = np.array([known_median(rms_px[:, c]) for c in range(rms_px.shape[1])])
    return np.asarray(rms_px > np.maximum(_WRONG_VIEW * usual_px, _LEAST_WRONG_PX))


def view_rms_px(adjusted: AdjustedBoards) -> Float[np.ndarray, "moment camera"]:
    """NaN where the board is not seen."""
    squared, seen = np.sum(adjusted.residual_px**2, axis=-1), adjusted.sightings.seen
    with np.errstate(invalid="ignore"):
        return np.sqrt(np.where(seen, squared, 0.0).sum(axis=-1) / seen.sum(axis=-1))


def again_without(adjusted: AdjustedBoards, wrong: Bool[np.ndarray, "moment camera"], why: str) -> AdjustedBoards:
    """Adjusted again without some views.

    Args:
        adjusted: with them.
        wrong: the views.
        why: the reason, in which {0} is the root mean square of a view in pixels.
    """
    before, bundle = adjusted.sightings, adjusted.bundle
    sightings = before.without(wrong, _left_out(adjusted, wrong, why))
    kept = np.isin(before.time_s, sightings.time_s)
    return adjust(sightings, adjusted.kinds, replace(bundle, world_T_board=bundle.world_T_board[kept]))


def _left_out(adjusted: AdjustedBoards, wrong: Bool[np.ndarray, "moment camera"], why: str) -> list[LeftOut]:
    rms_px, sightings = view_rms_px(adjusted), adjusted.sightings
    return [
        LeftOut(sightings.camera_names[c], float(sightings.time_s[t]), why.format(float(rms_px[t, c])))
        for t, c in np.argwhere(wrong).tolist()
    ]


def _sigma_px(problem: BoardProblem, bundle: BoardBundle) -> Float[np.ndarray, " camera"]:
    """Standard deviation of a coordinate of a corner, by camera."""
    residual_px = problem.residual_px(bundle)
    own = np.array([robust_sigma(residual_px[:, c]) for c in range(residual_px.shape[1])])
    return np.maximum(own / np.sqrt(problem.freedom), _LEAST_SIGMA_PX)
