"""Whether lenses that were given are right: what the views make of them, were they unknown, and what that does to the
poses of all cameras.

With a lens that is wrong a camera agrees with itself and with the others nearly as well: its pose makes up for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.board.adjusting import AdjustedBoards, adjust
from fgpose.calibration.board.lens import LensKind, image_of, numbers_of
from fgpose.calibration.board.lenses import LADDERS, MIN_VIEWS, FittedLens
from fgpose.calibration.board.placing import place
from fgpose.calibration.board.problem import BoardBundle
from fgpose.calibration.board.verdict.sigmas import beyond_turns, board_sigmas, rays_of
from fgpose.calibration.from_people.verdict.alignment import onto_centroid
from fgpose.geometry.camera import Camera, CameraRig

_BY_CHANCE = 1e-3  # lenses that are right are doubted so often
_KNOWN = 0.02  # a focal length that views of a camera tell less well, as few of them or from afar, they do not tell
_FEWEST_COEFFICIENTS = 2  # of a pinhole camera that is given without distortion, to see whether it has some


@dataclass(frozen=True, eq=False)
class GivenLenses:
    """How lenses that were given differ from those that the views show; zero where they do not, and of others."""

    doubtful: Bool[np.ndarray, " camera"]
    """Whether the views of the camera alone contradict its lens, and tell another."""
    focal: Float[np.ndarray, " camera"]
    """How much longer the focal length of one that is doubtful seems to be, as a share of it."""
    centre_px: Float[np.ndarray, " camera"]
    """How far from the given one its principal point seems to be."""
    border_px: Float[np.ndarray, " camera"]
    """How far from where its distortion has them pixels seem to be, where in the image that is most. What a turn of the
    camera does is not counted."""
    moved_m: Float[np.ndarray, " camera"]
    """How far away the cameras are with their lenses estimated: about the centroid of the rig, and beyond chance ..."""
    turned_deg: Float[np.ndarray, " camera"]
    """... and how far they are turned."""


def given_lenses(adjusted: AdjustedBoards, rig: CameraRig, fitted: Sequence[FittedLens]) -> GivenLenses:
    """Of lenses that an adjustment has held.

    Args:
        adjusted: of all cameras.
        rig: its cameras, in any world.
        fitted: the lens of each camera, with its own views.
    """
    n_cameras = rig.n_cameras
    doubtful = np.zeros(n_cameras, dtype=bool)
    focal, centre_px, border_px, moved_m, turned_deg = np.zeros((5, n_cameras))
    for c, (own, camera) in enumerate(zip(fitted, rig.cameras, strict=True)):
        if not own.kind.held or len(own.sightings.time_s) < MIN_VIEWS:
            continue
        start = place(own.sightings, [own])
        alone = adjust(own.sightings, [_freed(camera)], start)
        if _contradicts(alone, start) and board_sigmas(alone, rig.subset((camera.name,))).focal[0] < _KNOWN:
            given, shown = own.numbers, alone.bundle.lenses[0]
            doubtful[c] = True
            focal[c] = np.expm1(np.mean(np.log(shown[:2] / given[:2])))
            centre_px[c] = np.linalg.norm(shown[2:4] - given[2:4])
            border_px[c] = _border_px(camera, shown)
    if n_cameras > 1 and any(kind.held for kind in adjusted.kinds):
        moved_m, turned_deg = _moves(adjusted, rig)
    return GivenLenses(doubtful, focal, centre_px, border_px, moved_m, turned_deg)


def _freed(camera: Camera) -> LensKind:
    """With all coefficients that the given lens has; of focal lengths each its own."""
    if camera.lens == "fisheye":
        return LensKind("fisheye", 4, square=False)
    n_given = int(np.flatnonzero(camera.distortion).max(initial=-1)) + 1
    n_usual = [kind.n_distortion for kind in LADDERS["pinhole"] if kind.n_distortion >= _FEWEST_COEFFICIENTS]
    return LensKind(n_distortion=next((n for n in n_usual if n >= n_given), 8), square=False)


def _contradicts(freed: AdjustedBoards, held: BoardBundle) -> bool:
    """The test of the ratio of likelihoods, with the noise by which moments disagree. The covariance of what is free
    would not do: views from afar, or few, make it of any size."""
    from scipy.stats import chi2

    problem = freed.problem
    disagreement = max(problem.disagreement(freed.bundle), 1.0)
    ratio = 2 * (problem.error(held) - problem.error(freed.bundle)) / disagreement**2
    n_lenses = problem.n_shared - 6 * (len(freed.kinds) - 1)
    return freed.converged and ratio > float(chi2.isf(_BY_CHANCE, n_lenses))


def _border_px(given: Camera, shown: Float[np.ndarray, " 12"]) -> float:
    """See GivenLenses."""
    rays, before = rays_of(given), numbers_of(given)
    after = np.concatenate([before[:4], shown[4:]])
    moves_px = image_of(rays, after, given.lens)[0] - image_of(rays, before, given.lens)[0]
    left_px = beyond_turns(given, rays, moves_px.reshape(-1, 1)).reshape(-1, 2)
    return float(np.linalg.norm(left_px, axis=1).max(initial=0.0))


def _moves(
    adjusted: AdjustedBoards, rig: CameraRig
) -> tuple[Float[np.ndarray, " camera"], Float[np.ndarray, " camera"]]:
    """See GivenLenses."""
    pairs = zip(adjusted.kinds, rig.cameras, strict=True)
    kinds = [_freed(camera) if kind.held else kind for kind, camera in pairs]
    freed = adjust(adjusted.sightings, kinds, adjusted.bundle)
    if not _contradicts(freed, adjusted.bundle):
        return np.zeros(rig.n_cameras), np.zeros(rig.n_cameras)
    poses = zip(adjusted.bundle.world_T_camera, freed.bundle.world_T_camera, strict=True)
    moves = np.array([gtsam.Pose3.Logmap(gtsam.Pose3(before).between(gtsam.Pose3(after))) for before, after in poses])
    moves = (onto_centroid(rig, with_scale=False) @ moves.ravel()).reshape(-1, 2, 3)
    turned_deg, moved_m = np.rad2deg(np.linalg.norm(moves[:, 0], axis=1)), np.linalg.norm(moves[:, 1], axis=1)
    sigmas = board_sigmas(freed, rig)
    return _beyond(moved_m, sigmas.position_m), _beyond(turned_deg, sigmas.direction_deg)


def _beyond(change: Float[np.ndarray, " camera"], sigma: Float[np.ndarray, " camera"]) -> Float[np.ndarray, " camera"]:
    """What chance does not explain; zero where nothing is known."""
    return np.sqrt(np.maximum(change**2 - sigma**2, 0.0))
