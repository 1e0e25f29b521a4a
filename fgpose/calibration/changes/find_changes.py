"""Which cameras change while a recording lasts, and how: one change after the other, the clearest first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from jaxtyping import Float

from fgpose.calibration.changes.candidate import CLEARLY, Candidate, chosen_of
from fgpose.calibration.changes.change import Change, Kind
from fgpose.calibration.changes.clock_changes import MIN_BLOCKS, ClockFit, clock_fits, score
from fgpose.calibration.changes.credible import (
    JUMP_FRAMES,
    NOTICEABLE_FRAMES,
    WHOLE_FRAMES,
    clock_matters,
    holds,
    is_clear,
    lens_matters,
    move_matters,
)
from fgpose.calibration.changes.lag_costs import (
    BLOCK_S,
    PER_STEP,
    Blocks,
    LagCosts,
    blocks_of,
    lag_costs,
    somebody_walks,
)
from fgpose.calibration.changes.lenses import Lens, LensFit, lens_fits, with_lens
from fgpose.calibration.changes.pose_changes import PoseFit, misses_m, pose_fit, pose_fits
from fgpose.calibration.changes.rays import Rays, grid_step_s, rays_of
from fgpose.calibration.changes.turning_point import turning_point_s
from fgpose.freed_memory import hand_back
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.sampling import usual_step_s

AGREES_M = 0.06
"""Half of the rays of each camera that is right pass the joints by less: real recordings have 6 to 32 mm (embedded
ones, with calibrations that are off by up to 60 mm), 53 mm where occluders hide a third of the joints."""
LEAST_S = 8.0
"""Shorter recordings do not tell what changes in time."""
MAX_LAG_S = 1.5
"""Of one camera behind another; what is found here may be more."""
_MAX_CHANGES = 6
_LONGEST_STEP_S = 0.5  # between images: nothing is told of clocks by less than two a second
# In a ring of cameras that see people as high in all images these are within 1 % of each other, whichever it is.
_ALIKE, _AS_GOOD = ({Lens.HEIGHT, Lens.CENTRE_Y}, {Lens.WIDTH, Lens.CENTRE_X}), 0.98
_ROUNDS = 5
_SETTLED, _SETTLED_M = np.deg2rad(0.1), 0.005


@dataclass(frozen=True, eq=False)
class Changes:
    """What was found of a recording."""

    changes: tuple[Change, ...]
    """In the order in which they were found, the clearest first; each on top of those before."""
    step_s: float
    """Of the images."""
    duration_s: float
    compared: bool
    """Whether two cameras saw the same person for some seconds; else nothing could be found."""
    lenses: tuple[LensFit, ...] = ()
    """That are not those of the calibration: a camera with another one looks as if it was moved."""
    agree: bool = False
    """Whether all cameras agree with them; where rays meet nowhere, some lens always suits."""


def find_changes(people: Sequence[Observations], rig: CameraRig) -> Changes:
    """Find clocks that are late, jump or drift, and cameras that were moved or bumped, from two cameras on.

    Of each camera every kind of change, and another focal length, is fitted to the angles by which its rays miss those
    of the others, on every other second, and judged by the seconds between. The one that makes most better is taken, if
    that is not by chance and matters; then the next is looked for, until there is none.

    Args:
        people: what the cameras saw of each, by their stamps.
        rig: the cameras.
    """
    step_s = min(usual_step_s(own.frame_time_s) for own in people)
    begin_s = min(float(own.frame_time_s[0]) for own in people)
    duration_s = max(float(own.frame_time_s[-1]) for own in people) - begin_s
    changes: list[Change] = []
    lenses: list[LensFit] = []
    compared = rig.n_cameras >= 2 and bool(step_s < _LONGEST_STEP_S) and _compared(people)
    if compared:
        while len(changes) + len(lenses) < _MAX_CHANGES and (found := _next(people, rig, changes, step_s)):
            if isinstance(found, LensFit):
                lenses.append(found)
                rig = with_lens(rig, found)
            else:
                changes += found
    agree = bool(lenses) and _all_agree(people, rig, changes)
    return Changes(tuple(changes), step_s, duration_s, compared, tuple(lenses), agree)


def _compared(people: Sequence[Observations]) -> bool:
    """Whether two cameras see somebody in half of some seconds."""
    by_two = sum(int((own.seen.any(axis=2).sum(axis=1) >= 2).sum()) * usual_step_s(own.frame_time_s) for own in people)
    return by_two > 2 * MIN_BLOCKS * BLOCK_S


def _rays(people: Sequence[Observations], rig: CameraRig, changes: Sequence[Change]) -> Rays:
    """With the changes so far undone."""
    hand_back()
    grid_s = grid_step_s(people)
    return rays_of(people, rig, changes, grid_s, _n_lags(grid_s))


def _n_lags(grid_s: float) -> int:
    return round(MAX_LAG_S / grid_s)


def _next(
    people: Sequence[Observations], rig: CameraRig, changes: Sequence[Change], step_s: float
) -> list[Change] | LensFit:
    """The clearest change on top of others; none if there is no other."""
    rays = _rays(people, rig, changes)
    blocks = blocks_of(rays, rays.direction.shape[2])
    costs = lag_costs(rays, blocks, _n_lags(rays.step_s))
    walks = somebody_walks(rays, blocks)
    each_camera = range(rig.n_cameras)
    candidates = [each for c in each_camera for each in _poses_of(rays, costs, c, walks=walks)]
    candidates += [each for c in each_camera for each in _clocks_of(costs, c, step_s)]
    fits = lens_fits(rays, costs, rig) if walks else []
    fits = [fit for fit in fits if is_clear(_of_motion(fit, costs)) and lens_matters(fit) and holds(fit)]
    # What needs no number goes before what does.
    lens = max(fits, key=lambda fit: fit.gain.sum() * (CLEARLY if len(fit.lens.values) == 2 else 1.0), default=None)
    if lens is not None:
        lens = replace(lens, or_else=_as_good(lens, fits))
    while candidates:
        chosen = chosen_of(candidates, step_s / costs.step_s)
        # A lens is one number, a pose are six.
        if lens is not None and float(lens.gain.sum()) * CLEARLY > chosen.gain:
            return lens
        found = _placed(chosen, people, rig, changes, rays, blocks, step_s)
        if isinstance(chosen.fit, ClockFit) or _agrees(chosen.fit, found, people, rig, changes, blocks):
            return found
        candidates = [
            each for each in candidates if each.change.camera != chosen.change.camera or each.change.is_of_clock
        ]
    return lens if lens is not None else []


def _as_good(lens: LensFit, fits: Sequence[LensFit]) -> LensFit | None:
    """That of the same cameras which looks like it, if it fits as well."""
    alike = [fit for fit in fits if fit.cameras == lens.cameras and {fit.lens, lens.lens} in _ALIKE]
    return next((fit for fit in alike if fit.gain.sum() > _AS_GOOD * lens.gain.sum()), None)


def _agrees(
    fit: PoseFit,
    found: Sequence[Change],
    people: Sequence[Observations],
    rig: CameraRig,
    changes: Sequence[Change],
    blocks: Blocks,
) -> bool:
    """Whether the camera sees the same as the others, if it was moved: one that shows somebody else for a while, or a
    reflection, agrees better somewhere, and not well anywhere."""
    rays = _rays(people, rig, [*changes, *found])
    return misses_m(rays, blocks, found[0].camera, fit.held) < AGREES_M


def _all_agree(people: Sequence[Observations], rig: CameraRig, changes: Sequence[Change]) -> bool:
    """Whether the rays of every camera meet those of the others."""
    rays = _rays(people, rig, changes)
    blocks = blocks_of(rays, rays.direction.shape[2])
    everywhere = np.ones(blocks.n_blocks, dtype=bool)
    return all(misses_m(rays, blocks, c, everywhere) < AGREES_M for c in range(rig.n_cameras))


def _clocks_of(costs: LagCosts, c: int, step_s: float) -> list[Candidate]:
    found = []
    for fit in clock_fits(costs, c, step_s):
        lag_s = fit.lag * costs.step_s
        if is_clear(fit) and clock_matters(fit.kind, lag_s / step_s):
            found.append(Candidate(Change(fit.kind, c), fit, float(fit.gain.sum())))
    return found


def _poses_of(rays: Rays, costs: LagCosts, c: int, *, walks: bool) -> list[Candidate]:
    poses = [fit for fit in pose_fits(rays, costs, c) if is_clear(fit)]
    best = max(poses, key=lambda fit: float(fit.gain.sum()), default=None)
    noticeable = [fit for fit in poses if move_matters(fit, walks=walks, of_posture=_is_of_posture(fit, rays, costs))]
    found = [fit for fit in noticeable if best in noticeable and holds(fit)]
    return [Candidate(Change(fit.kind, c), fit, float(fit.gain.sum())) for fit in found]


def _is_of_posture(fit: PoseFit, rays: Rays, costs: LagCosts) -> bool:
    """Whether a bump is there while nobody walks, and somebody moves when it begins or ends: then the posture that the
    camera sees is another one too."""
    first, last = fit.edges
    changes = bool(costs.moves[max(first - 2, 0) : last + 1].any())
    return fit.kind is Kind.BUMP and changes and not somebody_walks(rays, costs.blocks.only(fit.held))


def _of_motion(fit: LensFit, costs: LagCosts) -> LensFit:
    """As far as somebody moves: errors that a network makes of one posture look like another lens, however long."""
    return replace(fit, gain=fit.gain * costs.moves)


def _placed(
    candidate: Candidate,
    people: Sequence[Observations],
    rig: CameraRig,
    changes: Sequence[Change],
    rays: Rays,
    blocks: Blocks,
    step_s: float,
) -> list[Change]:
    """As changes by the stamps of the camera."""
    fit, change = candidate.fit, replace(candidate.change, reliability=score(candidate.fit.gain))
    if isinstance(fit, ClockFit):
        lag_step_s = rays.step_s / PER_STEP
        lag_s = fit.lag * lag_step_s
        adds_up, free = (float(np.ptp(lag) if fit.kind is Kind.RATE else lag[0]) for lag in (fit.lag, fit.free_lag))
        change = replace(change, sigma=fit.change_sigma(adds_up, free) * lag_step_s)
        if fit.kind is Kind.OFFSET:
            return [replace(change, offset_s=float(lag_s[0]))]
        if fit.kind is Kind.RATE:
            return [_rate(change, lag_s, blocks, changes)]
        return _jump(change, fit, lag_s, people, rig, changes, rays, blocks, step_s)
    moved = _move(change, fit, people, rig, changes, blocks)
    if fit.kind is Kind.MOVED:
        return [moved]
    until = bool(fit.held[0])
    edge = int(np.flatnonzero(fit.held)[-1]) + 1 if until else int(np.flatnonzero(fit.held)[0])
    near_s = blocks.time_s[min(edge, blocks.n_blocks - 1)] - blocks.length_s / 2
    before, after = ([*changes, moved], list(changes)) if until else (list(changes), [*changes, moved])
    at_s = turning_point_s(people, rig, before, after, change.camera, rays.step_s, near_s, 2 * blocks.length_s)
    moved = replace(moved, between_s=_between_s(fit.edges, at_s, blocks))
    return [replace(moved, until_s=at_s) if until else replace(moved, at_s=at_s)]


def _between_s(edges: tuple[int, int], at_s: float, blocks: Blocks) -> tuple[float, float]:
    """A block to either side: where in a block it changes is not told by blocks."""
    begin_s, end_s = (float(blocks.time_s[min(edge, blocks.n_blocks - 1)]) for edge in edges)
    return min(begin_s - 1.5 * blocks.length_s, at_s), max(end_s + 0.5 * blocks.length_s, at_s)


def _move(
    change: Change,
    fit: PoseFit,
    people: Sequence[Observations],
    rig: CameraRig,
    changes: Sequence[Change],
    blocks: Blocks,
) -> Change:
    """Until nothing is left of it: a large one makes the angles so wide that some of them look like usual ones."""
    c = change.camera
    given = rig.cameras[c].world_T_camera
    for each in changes:
        if each.camera == c and each.kind is Kind.MOVED:
            given = each.moved_pose(given)
    pose = np.array(given)
    for _ in range(_ROUNDS):
        pose[:3, 3] += fit.translation_m
        pose[:3, :3] = gtsam.Rot3.Expmap(fit.rotation).matrix() @ pose[:3, :3]
        relative = np.linalg.inv(given) @ pose
        change = replace(
            change,
            rotation=gtsam.Rot3.Logmap(gtsam.Rot3(relative[:3, :3])),
            translation_m=relative[:3, 3],
            sigma=fit.sigma_rotation,
            translation_sigma_m=fit.sigma_translation_m,
        )
        if np.linalg.norm(fit.rotation) < _SETTLED and np.linalg.norm(fit.translation_m) < _SETTLED_M:
            break
        rays = _rays(people, rig, [*changes, change])
        fit = pose_fit(rays, lag_costs(rays, blocks, _n_lags(rays.step_s)), c, fit.kind, fit.held)
    return change


def _rate(change: Change, lag_s: Float[np.ndarray, " block"], blocks: Blocks, changes: Sequence[Change]) -> Change:
    """A lag that grows by s per second of common time t is s / (1 - s) per second of stamps t - lag."""
    duration_s = float(blocks.time_s[-1] - blocks.time_s[0])
    slope = float(lag_s[-1] - lag_s[0]) / duration_s
    rate = slope / (1 - slope)
    return replace(change, rate=rate, offset_s=(float(lag_s[0]) - slope * float(blocks.time_s[0])) / (1 - slope))


def _jump(
    change: Change,
    fit: ClockFit,
    lag_s: Float[np.ndarray, " block"],
    people: Sequence[Observations],
    rig: CameraRig,
    changes: Sequence[Change],
    rays: Rays,
    blocks: Blocks,
    step_s: float,
) -> list[Change]:
    found: list[Change] = []
    if abs(lag_s[0]) > NOTICEABLE_FRAMES * step_s:
        offset_s = float(lag_s[0])
        found.append(
            Change(Kind.OFFSET, change.camera, offset_s=offset_s, sigma=change.sigma, reliability=change.reliability)
        )
    for first, edges in zip(fit.firsts, fit.edges, strict=True):
        by_s = float(lag_s[first] - lag_s[first - 1])
        free, lag_step_s = float(fit.free_lag[first] - fit.free_lag[first - 1]), rays.step_s / PER_STEP
        frames = by_s / step_s
        if abs(frames - round(frames)) < WHOLE_FRAMES:
            by_s = round(frames) * step_s
        if abs(by_s) < JUMP_FRAMES * step_s:
            continue
        jump = replace(change, offset_s=by_s, sigma=fit.change_sigma(by_s / lag_step_s, free) * lag_step_s)
        near_s = blocks.time_s[first] - blocks.length_s / 2
        before, after = [*changes, *found], [*changes, *found, jump]
        at_s = turning_point_s(people, rig, before, after, change.camera, rays.step_s, near_s, 2 * blocks.length_s)
        found.append(replace(jump, at_s=at_s, between_s=_between_s(edges, at_s, blocks)))
    return found
