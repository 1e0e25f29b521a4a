"""The chain from what cameras saw of a board to a calibrated rig.

lenses (each camera alone) -> placing (pairs that see the board together, chained) -> adjusting (bundle adjustment of
cameras and boards, with as much of the lenses as all views determine, again without views that are wrong) -> world ->
sigmas -> verdict.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from fgpose.calibration.board.adjusting import AdjustedBoards, adjust, again_without, wrong_views
from fgpose.calibration.board.lens import LensKind, camera_of
from fgpose.calibration.board.lenses import LADDERS, FittedLens, LensChoice, fit_lens, held_lens
from fgpose.calibration.board.placing import place
from fgpose.calibration.board.sightings import BoardSightings
from fgpose.calibration.board.verdict.given_lenses import given_lenses
from fgpose.calibration.board.verdict.sigmas import BoardSigmas, board_sigmas
from fgpose.calibration.board.verdict.verdict import VerdictInputs, findings
from fgpose.calibration.board.world import WorldOrigin, world_T_first
from fgpose.calibration.from_people.calibrated import CalibrationFinding, Grade, worst_grade
from fgpose.geometry.camera import CameraRig
from fgpose.shown import Shown

Progress = Callable[[int, int], None]
"""Called with the number of steps done and the number of steps in all."""

_BOARD = WorldOrigin()


@dataclass(frozen=True, eq=False, repr=False)
class CalibratedFromBoards(Shown):
    """A rig that was found from a board."""

    rig: CameraRig
    """In metres; the world is what was asked for."""
    sigmas: BoardSigmas
    sightings: BoardSightings
    """What was used; left_out names what was not."""
    world_T_board: Float[np.ndarray, "moment 4 4"]
    residual_px: Float[np.ndarray, "moment camera point"]
    """Length of the reprojection errors; NaN = not seen."""
    alone_px: Float[np.ndarray, " camera"]
    """Root mean square of the reprojection errors where the poses of the boards fit the camera alone."""
    links: Int[np.ndarray, "camera camera"]
    """Moments at which two cameras both see the board."""
    start_s: Float[np.ndarray, " camera"] | None
    """When each camera began after the first, seconds; None: they have one clock."""
    lenses: tuple[str, ...]
    """Which numbers of each lens were estimated, as "pinhole, k1 k2"."""
    world: str
    """Where the world is, in a sentence."""
    findings: tuple[CalibrationFinding, ...]

    @property
    def grade(self) -> Grade:
        """The worst of the findings."""
        return worst_grade(self.findings)

    @property
    def begins_s(self) -> Float[np.ndarray, " camera"]:
        """When each camera began after the first; with one clock all at once."""
        return np.zeros(self.rig.n_cameras) if self.start_s is None else self.start_s

    @property
    def rms_px(self) -> Float[np.ndarray, " camera"]:
        return np.sqrt(np.nanmean(self.residual_px**2, axis=(0, 2)))


def calibrate_from_boards(
    sightings: BoardSightings,
    *,
    intrinsics: CameraRig | None = None,
    lens: LensChoice = "auto",
    origin: WorldOrigin = _BOARD,
    progress: Progress | None = None,
) -> CalibratedFromBoards:
    """Calibrate cameras from what they saw of one board, at the same moments.

    Args:
        sightings: see find_boards, which makes it of videos or images.
        intrinsics: K and lens of each camera, which are held then; None: they are estimated.
        lens: the model of the lenses; auto: pinhole, or fisheye where that explains the views clearly better.
        origin: where the world is.
        progress: told after each step.

    Returns:
        The rig, with sigmas and verdict. If that is failed (grade), it must not be used.

    Raises:
        ValueError: a camera sees the board too rarely or never together with the others, or the board looks the same
            upside down; the message names it.
    """
    names = sightings.camera_names
    if len(names) > 1:
        sightings.board.check_unambiguous()
    n_steps = len(names) + 3
    fitted = list[FittedLens]()
    for c, _ in enumerate(names):
        own = sightings.of_camera(c)
        fitted.append(fit_lens(own, lens) if intrinsics is None else held_lens(own, intrinsics.cameras[c]))
        if progress:
            progress(c + 1, n_steps)
    used = _explained(sightings, fitted)
    start = place(used, fitted)
    if progress:
        progress(len(names) + 1, n_steps)
    adjusted = _richest(adjust(used, [each.kind for each in fitted], start))
    adjusted = _without_wrong_views(adjusted)
    if progress:
        progress(len(names) + 2, n_steps)
    result = _judged(adjusted, fitted, origin)
    if progress:
        progress(n_steps, n_steps)
    return result


def calibrate_lenses(
    sightings: Sequence[BoardSightings], *, lens: LensChoice = "auto", progress: Progress | None = None
) -> tuple[CalibratedFromBoards, ...]:
    """The lens of each camera by itself, whatever the others saw, and when.

    Args:
        sightings: of one camera each.
        lens: see calibrate_from_boards.
        progress: told after each camera.

    Raises:
        ValueError: a camera sees the board too rarely; the message names it.
    """
    found = list[CalibratedFromBoards]()
    for own in sightings:
        found.append(calibrate_from_boards(own, lens=lens, origin=WorldOrigin("camera")))
        if progress:
            progress(len(found), len(sightings))
    return tuple(found)


def _explained(sightings: BoardSightings, fitted: Sequence[FittedLens]) -> BoardSightings:
    """Without the views that the lens of their camera does not explain."""
    kept = np.stack([np.isin(sightings.time_s, each.sightings.time_s) for each in fitted], axis=1)
    reasons = [each for lens in fitted for each in lens.sightings.left_out if each not in sightings.left_out]
    return sightings.without(~kept, reasons)


def _richest(adjusted: AdjustedBoards) -> AdjustedBoards:
    """With more coefficients where all views together determine them: a camera alone may see too little."""
    best = adjusted
    for model, ladder in LADDERS.items():
        for least in ladder:
            kinds = [_at_least(kind, least) if kind.model == model else kind for kind in best.kinds]
            if tuple(kinds) != best.kinds:
                best = min(best, adjust(best.sightings, kinds, best.bundle), key=lambda each: each.criterion)
    return best


def _at_least(kind: LensKind, least: LensKind) -> LensKind:
    if kind.held:
        return kind
    return replace(kind, n_distortion=max(kind.n_distortion, least.n_distortion), centre=kind.centre or least.centre)


def _without_wrong_views(adjusted: AdjustedBoards) -> AdjustedBoards:
    """Again without views that contradict the other cameras, if every camera keeps most of its views."""
    wrong, sees = wrong_views(adjusted), adjusted.sightings.shows_board
    if not wrong.any() or (2 * wrong.sum(axis=0) > sees.sum(axis=0)).any():
        return adjusted
    return again_without(adjusted, wrong, "its corners are {0:.1f} px beside where the other cameras have the board")


def _judged(adjusted: AdjustedBoards, fitted: Sequence[FittedLens], origin: WorldOrigin) -> CalibratedFromBoards:
    """In the world that is asked for, with sigmas and verdict."""
    sightings, bundle = adjusted.sightings, adjusted.bundle
    world, said = world_T_first(origin, bundle.world_T_camera, bundle.world_T_board, sightings)
    rig = _rig(adjusted, world @ bundle.world_T_camera)
    sigmas = board_sigmas(adjusted, rig)
    contradiction = _contradiction(rig, sigmas, fitted)
    given = given_lenses(adjusted, rig, fitted)
    sigmas = sigmas.times(max(1.0, float(np.sqrt(np.mean(contradiction**2)))))
    sigmas = sigmas.with_moves(given.moved_m, given.turned_deg)
    residual_px = np.linalg.norm(adjusted.residual_px, axis=-1)
    alone_px = np.array([each.rms_px for each in fitted])
    links = linked(sightings)
    inputs = VerdictInputs.of(adjusted, rig, sigmas, alone_px, links, contradiction, given)
    return CalibratedFromBoards(
        rig=rig,
        sigmas=sigmas,
        sightings=sightings,
        world_T_board=world @ bundle.world_T_board,
        residual_px=residual_px,
        alone_px=alone_px,
        links=links,
        start_s=None if sightings.start_s is None else _starts_s(sightings.start_s, bundle.late_s),
        lenses=tuple("as given" if kind.held else kind.text for kind in adjusted.kinds),
        world=said,
        findings=findings(inputs),
    )


def _contradiction(rig: CameraRig, sigmas: BoardSigmas, fitted: Sequence[FittedLens]) -> Float[np.ndarray, " camera"]:
    """By how many standard deviations the focal length of each camera differs from that which it has by itself: where
    one was moved or refocused between views, the lenses of all make up for it. 0 of one that was given."""
    differs = np.zeros(rig.n_cameras)
    for c, own in enumerate(fitted):
        if rig.n_cameras > 1 and not own.kind.held:
            alone = adjust(own.sightings, [own.kind], place(own.sightings, [own]))
            camera = _rig(alone, alone.bundle.world_T_camera)
            sigma = np.hypot(board_sigmas(alone, camera).focal[0], sigmas.focal[c])
            differs[c] = np.log(camera.focal_px[0] / rig.focal_px[c]) / sigma
    return differs


def _starts_s(
    taken_s: Float[np.ndarray, " camera"], late_s: Float[np.ndarray, " camera"]
) -> Float[np.ndarray, " camera"]:
    """After the first camera."""
    return taken_s - taken_s[0] + late_s - late_s[0]


def linked(sightings: BoardSightings) -> Int[np.ndarray, "camera camera"]:
    """Moments at which two cameras both see the board."""
    sees = sightings.shows_board.astype(int)
    links = sees.T @ sees
    np.fill_diagonal(links, 0)
    return links


def _rig(adjusted: AdjustedBoards, world_T_camera: Float[np.ndarray, "camera 4 4"]) -> CameraRig:
    sightings = adjusted.sightings
    each = zip(
        sightings.camera_names, sightings.sizes_px, adjusted.bundle.lenses, adjusted.kinds, world_T_camera, strict=True
    )
    return CameraRig(tuple(camera_of(*numbers) for numbers in each))
