"""The lens of each camera from its own views of the board: which model, and which numbers of it.

A lens has as many coefficients as lower Akaike's information criterion: each has to explain more than it costs. The
three of the rational model, which nearly undo the others, have to explain much more, and views that they were not
fitted to.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.board.adjusting import AdjustedBoards, adjust, again_without, view_rms_px, wrong_views
from fgpose.calibration.board.lens import N_COEFFICIENTS, N_OF_LENS, LensKind, matrix_of, numbers_of
from fgpose.calibration.board.problem import BoardBundle, BoardProblem
from fgpose.calibration.board.sightings import BoardSightings
from fgpose.geometry.camera import Camera
from fgpose.geometry.lens import LensModel, without_distortion
from fgpose.sampling import spread_evenly

LensChoice = Literal["auto", "pinhole", "fisheye"]

MIN_VIEWS = 3
"""A focal length and poses are determined by two views that are tilted differently; three check each other."""

# From telephoto lenses to action cameras, as shares of the longer side of the image.
_FOCAL_SHARES = (0.4, 0.55, 0.7, 0.85, 1.05, 1.3, 1.8, 2.6)
_TRIED_VIEWS = 12  # that tell which start is the best
LADDERS: Mapping[LensModel, tuple[LensKind, ...]] = {
    "pinhole": (
        LensKind(n_distortion=0, centre=False),
        LensKind(n_distortion=1, centre=False),
        LensKind(n_distortion=1),
        LensKind(n_distortion=2),
        LensKind(n_distortion=4),
        LensKind(n_distortion=5),
    ),
    "fisheye": (LensKind("fisheye", 4, centre=False), LensKind("fisheye", 4)),
}
"""Of each model the kinds of lens, with more and more free numbers."""
_RATIONAL = LensKind(n_distortion=8)
# Pixels are square and lenses are no fisheye, unless views show clearly that they are.
_ADVANTAGE = 20.0
_GRID = 17  # points along each side of the image


@dataclass(frozen=True, eq=False)
class FittedLens:
    """A lens with the poses of the boards before it."""

    kind: LensKind
    numbers: Float[np.ndarray, " 12"]
    sightings: BoardSightings
    """Of this camera, without the views that are wrong."""
    camera_T_board: Float[np.ndarray, "moment 4 4"]
    rms_px: float


def fit_lens(sightings: BoardSightings, choice: LensChoice = "auto") -> FittedLens:
    """From what one camera saw.

    Raises:
        ValueError: there are too few views; the message names the camera.
    """
    n_views = len(sightings.time_s)
    if n_views < MIN_VIEWS:
        raise ValueError(
            f"camera {sightings.camera_names[0]}: the board is seen in {n_views} of its images, at least {MIN_VIEWS} "
            "from different sides are needed"
        )
    found = [_climbed(sightings, LADDERS[model]) for model in LADDERS if choice in ("auto", model)]
    if len(found) > 1:
        # The rational model needs twice as many numbers, and holds where there are corners only.
        advantage = 0.0 if found[0].kinds[0] == _RATIONAL else _ADVANTAGE
        if found[1].criterion > found[0].criterion - advantage:
            del found[1]
    return _without_wrong_views(found[-1])


def held_lens(sightings: BoardSightings, camera: Camera) -> FittedLens:
    """The poses of the boards before a lens that is known."""
    numbers, kind = numbers_of(camera), LensKind(camera.lens, held=True)
    poses = np.stack([board_pose(sightings, t, numbers, camera.lens)[0] for t in range(len(sightings.time_s))])
    adjusted = adjust(sightings, [kind], _alone(numbers, poses))
    return _without_wrong_views(adjusted)


def _climbed(sightings: BoardSightings, ladder: Sequence[LensKind]) -> AdjustedBoards:
    """The best of kinds of which each has more free numbers, started where the one before has ended."""
    start = _start(sightings, ladder[0].model)
    found = list[AdjustedBoards]()
    for kind in ladder:
        found.append(adjust(sightings, [kind], start))
        start = found[-1].bundle
    best = min(found, key=lambda each: each.criterion)
    if best.kinds[0] == ladder[-1] and best.kinds[0].model == "pinhole":
        best = _rational(best)
    stretched_kind = replace(best.kinds[0], square=False)
    if _gain(best, stretched_kind) < _ADVANTAGE:
        return best
    stretched = adjust(sightings, [stretched_kind], best.bundle)
    return stretched if stretched.criterion < best.criterion - _ADVANTAGE else best


def _rational(best: AdjustedBoards) -> AdjustedBoards:
    """With the rational model instead, if it explains the views clearly better and those of either half with the lens
    of the other half too, and can be undone all over the image."""
    if _gain(best, _RATIONAL) < _ADVANTAGE:
        return best
    found = adjust(best.sightings, [_RATIONAL], best.bundle)
    if not found.converged or found.criterion > best.criterion - _ADVANTAGE or not _is_invertible(found):
        return best
    halves = np.arange(len(best.sightings.time_s)) % 2 == 0
    for fitted in (halves, ~halves):
        if not _left_out_px2(found, fitted) < _left_out_px2(best, fitted):
            return best
    return found


def _gain(adjusted: AdjustedBoards, kind: LensKind) -> float:
    """By how much another kind of lens would lower the sum of the squares of the errors in standard deviations, as far
    as they are linear (the score test). It costs one step, where the adjustment costs dozens."""
    problem = BoardProblem(adjusted.sightings, [kind], adjusted.problem.sigma_px)
    gradient = problem.gradient(adjusted.bundle)
    equations = problem.factorized(adjusted.bundle, damping=0.0)
    return float(gradient @ equations.solve(gradient)) if equations else np.inf


def _left_out_px2(adjusted: AdjustedBoards, fitted: Bool[np.ndarray, " moment"]) -> float:
    """Mean square error of the views that the lens is not fitted to, where their boards fit it best; of one that is
    wrong, no more than four times the usual one counts."""
    (kind,), bundle = adjusted.kinds, adjusted.bundle
    half = adjust(
        adjusted.sightings.at_moments(fitted), [kind], replace(bundle, world_T_board=bundle.world_T_board[fitted])
    )
    others = replace(half.bundle, world_T_board=bundle.world_T_board[~fitted])
    held = adjust(adjusted.sightings.at_moments(~fitted), [replace(kind, held=True)], others)
    square_px2 = view_rms_px(held)[:, 0] ** 2
    return float(np.mean(np.minimum(square_px2, 16 * np.median(square_px2))))


def _is_invertible(adjusted: AdjustedBoards) -> bool:
    """Whether the lens tells where each pixel looks, up to the border of the image."""
    (width, height), (numbers,) = adjusted.sightings.sizes_px[0], adjusted.bundle.lenses
    x, y = np.meshgrid(np.linspace(0, width - 1, _GRID), np.linspace(0, height - 1, _GRID))
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    return bool(np.isfinite(without_distortion(pixels, matrix_of(numbers), numbers[4:], "pinhole")).all())


def _start(sightings: BoardSightings, model: LensModel) -> BoardBundle:
    """Without distortion, with the focal length that explains views best, and the principal point in the middle."""
    width, height = sightings.sizes_px[0]
    n_views = len(sightings.time_s)
    tried = spread_evenly(n_views, _TRIED_VIEWS).tolist()

    def lens(share: float) -> np.ndarray:
        focal_px = share * max(width, height)
        return np.array([focal_px, focal_px, (width - 1) / 2, (height - 1) / 2, *np.zeros(N_OF_LENS - 4)])

    errors = [np.median([board_pose(sightings, t, lens(share), model)[1] for t in tried]) for share in _FOCAL_SHARES]
    numbers = lens(_FOCAL_SHARES[int(np.argmin(errors))])
    poses = np.stack([board_pose(sightings, t, numbers, model)[0] for t in range(n_views)])
    return _alone(numbers, poses)


def _alone(numbers: Float[np.ndarray, " 12"], poses: Float[np.ndarray, "moment 4 4"]) -> BoardBundle:
    """The world is the camera."""
    return BoardBundle.on_time(np.eye(4)[None], numbers[None], poses)


def board_pose(
    sightings: BoardSightings, t: int, numbers: Float[np.ndarray, " 12"], model: LensModel
) -> tuple[Float[np.ndarray, "4 4"], float]:
    """Of the board before a camera at a moment, by Collins and Bartoli's method for planes; and its reprojection error
    in pixels."""
    import cv2

    K, coefficients = matrix_of(numbers), numbers[4 : 4 + N_COEFFICIENTS[model]]
    points_px = without_distortion(sightings.points_px[t, 0], K, coefficients, model)
    known = np.isfinite(points_px).all(axis=1)
    board_m = sightings.board.points_m
    pose, error_px = np.eye(4), np.inf
    # In front of the camera, where nothing better is known.
    pose[2, 3] = 20 * np.ptp(board_m, axis=0).max()
    if known.sum() >= 4:
        # OpenCV takes the plane z = 0 with its origin anywhere.
        n, rotations, translations, errors = cv2.solvePnPGeneric(
            board_m[known], points_px[known], K, None, flags=cv2.SOLVEPNP_IPPE
        )
        found = [i for i in range(n) if np.isfinite(rotations[i]).all() and translations[i][2, 0] > 0]
        if found:
            error_px = float(np.ravel(errors)[found[0]])
            pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(rotations[found[0]])[0], translations[found[0]][:, 0]
    return pose, error_px


def _without_wrong_views(adjusted: AdjustedBoards) -> FittedLens:
    """Again without views that the lens cannot explain."""
    wrong = wrong_views(adjusted)
    if wrong.any() and (~wrong).sum() >= MIN_VIEWS:
        adjusted = again_without(adjusted, wrong, "its corners are {0:.1f} px beside a flat board")
    bundle = adjusted.bundle
    return FittedLens(
        adjusted.kinds[0], bundle.lenses[0], adjusted.sightings, bundle.world_T_board, float(adjusted.rms_px[0])
    )
