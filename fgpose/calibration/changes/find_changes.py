"""Which cameras change while a recording lasts, and how: one change after the other, the clearest first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fgpose.association.recording import Progress
from fgpose.calibration.changes.breathing import Breathing, breathing_lenses
from fgpose.calibration.changes.candidate import CLEARLY, Candidate, chosen_of
from fgpose.calibration.changes.change import Change, Kind
from fgpose.calibration.changes.clock_changes import MIN_BLOCKS, ClockFit, clock_fits
from fgpose.calibration.changes.comparison import Comparison
from fgpose.calibration.changes.credible import (
    clock_matters,
    holds,
    is_clear,
    lens_matters,
    move_matters,
)
from fgpose.calibration.changes.lag_costs import BLOCK_S, PER_STEP, LagCosts, somebody_walks
from fgpose.calibration.changes.lenses import Lens, LensFit, lens_fits, with_lens
from fgpose.calibration.changes.lost_images.lost_images import lost_images
from fgpose.calibration.changes.placed import placed
from fgpose.calibration.changes.poses.pose_changes import PoseFit, misses_m, pose_fits
from fgpose.calibration.changes.rays import Rays
from fgpose.freed_memory import hand_back
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.sampling import usual_step_s

AGREES_M = 0.06
"""Half of the rays of each camera that is right pass the joints by less: real recordings have 6 to 32 mm (embedded
ones, with calibrations that are off by up to 60 mm), 53 mm where occluders hide a third of the joints."""
LEAST_S = 8.0
"""Shorter recordings do not tell what changes in time."""
_MAX_CHANGES = 6
_LONGEST_STEP_S = 0.5  # between images: nothing is told of clocks by less than two a second
# In a ring of cameras that see people as high in all images these are within 1 % of each other, whichever it is.
_ALIKE, _AS_GOOD = ({Lens.HEIGHT, Lens.CENTRE_Y}, {Lens.WIDTH, Lens.CENTRE_X}), 0.98
_ROUNDS = 10


@dataclass(frozen=True, eq=False)
class Changes:
    """What was found of a recording."""

    changes: tuple[Change, ...]
    """Each on top of those before."""
    step_s: float
    """Of the images."""
    duration_s: float
    compared: bool
    """Whether two cameras saw the same person for some seconds; else nothing could be found."""
    lenses: tuple[LensFit, ...] = ()
    """That are not those of the calibration: a camera with another one looks as if it was moved."""
    agree: bool = False
    """Whether all cameras agree with them; where rays meet nowhere, some lens always suits."""
    breathing: tuple[Breathing, ...] = ()
    """Lenses whose focal length changes to and fro."""


class _Steps:
    """How far it is, in steps of about the same length: the cameras and the kinds of lenses that are looked at for each
    change, and what is looked for at the end."""

    def __init__(self, progress: Progress | None, n_cameras: int) -> None:
        self._progress, self._of_round, self._done = progress, n_cameras + len(Lens), 0
        self._before, self._at_end = 0, n_cameras

    def begin_round(self) -> None:
        self._before, self._done = self._before + self._done, 0

    def one(self) -> None:
        self._done = min(self._done + 1, self._of_round)
        if self._progress:
            self._progress(self._before + self._done, self._before + self._of_round + self._at_end)


def find_changes(people: Sequence[Observations], rig: CameraRig, progress: Progress | None = None) -> Changes:
    """Find clocks that are late, jump or drift, and cameras that were moved or bumped, from two cameras on.

    Of each camera every kind of change, and another focal length, is fitted to the angles by which its rays miss those
    of the others, on every other second, and judged by the seconds between. The one that makes most better is taken, if
    that is not by chance and matters, and those before it are looked for again beside it; then the next, until there is
    none.

    Args:
        people: what the cameras saw of each, by their stamps.
        rig: the cameras.
        progress: told how many of how many steps are done; each change that is found takes more.
    """
    steps = _Steps(progress, rig.n_cameras)
    step_s = min(usual_step_s(own.frame_time_s) for own in people)
    begin_s = min(float(own.frame_time_s[0]) for own in people)
    duration_s = max(float(own.frame_time_s[-1]) for own in people) - begin_s
    compared = rig.n_cameras >= 2 and bool(step_s < _LONGEST_STEP_S) and _compared(people)
    if not compared:
        return Changes((), step_s, duration_s, compared)
    changes, lenses, beside_all = _one_by_one(people, rig, step_s, steps)
    poses, clocks = _by_cause(changes)
    seen_through = _with_lenses(rig, lenses)
    beside_poses = Comparison.of(people, seen_through, step_s, poses) if clocks else beside_all
    del beside_all  # of an hour it takes 0.15 GB
    hand_back()
    jumps = lost_images(beside_poses, clocks)
    if jumps:
        # Clocks that jump again and again look like moved cameras and other lenses: these are looked for beside them.
        changes, lenses, _ = _one_by_one(people, rig, step_s, steps, jumps)
        poses, seen_through = _by_cause(changes)[0], _with_lenses(rig, lenses)
        changes = [*(lost_images(Comparison.of(people, seen_through, step_s, poses), clocks) or jumps), *poses]
    with_all = Comparison.of(people, seen_through, step_s, changes) if jumps or clocks else beside_poses
    agree = bool(lenses) and _all_agree(with_all)
    breathing = breathing_lenses(with_all) if somebody_walks(with_all.rays, with_all.blocks) else ()
    return Changes(tuple(changes), step_s, duration_s, compared, tuple(lenses), agree, breathing)


def _one_by_one(
    people: Sequence[Observations], rig: CameraRig, step_s: float, steps: _Steps, clocks: Sequence[Change] = ()
) -> tuple[list[Change], list[LensFit], Comparison]:
    """One change after the other, the clearest first; beside clocks that are known, of poses and lenses only. And what
    cameras saw beside all of them."""
    groups: list[list[Change]] = []
    lenses: list[LensFit] = []
    compared = Comparison.of(people, rig, step_s, clocks)
    for _ in range(_MAX_CHANGES):
        steps.begin_round()
        found = _next(compared, steps, clocks=not clocks)
        if not found:
            break
        del compared  # before the next is made
        if isinstance(found, LensFit):
            lenses.append(found)
            rig = with_lens(rig, found)
        else:
            groups = _settled(people, rig, [*groups, found], step_s, clocks)
        compared = Comparison.of(people, rig, step_s, [*clocks, *_of_all(groups)])
    return _of_all(groups), lenses, compared


def _by_cause(changes: Sequence[Change]) -> tuple[list[Change], list[Change]]:
    """Of poses and of clocks."""
    return [each for each in changes if not each.is_of_clock], [each for each in changes if each.is_of_clock]


def _with_lenses(rig: CameraRig, lenses: Sequence[LensFit]) -> CameraRig:
    for each in lenses:
        rig = with_lens(rig, each)
    return rig


def _of_all(groups: Sequence[Sequence[Change]]) -> list[Change]:
    return [change for group in groups for change in group]


def _settled(
    people: Sequence[Observations],
    rig: CameraRig,
    groups: list[list[Change]],
    step_s: float,
    clocks: Sequence[Change] = (),
) -> list[list[Change]]:
    """What was found, each looked for again beside the others until all stay: it was measured by cameras of which some
    were wrong themselves, so that it may be another change of its camera, at another time, or none."""
    n_steady = 1  # the newest was found beside all others
    for _ in range(_ROUNDS * len(groups)):
        if n_steady >= len(groups):
            break
        # What is found goes to the end: the one that was fitted longest ago comes first.
        former, *groups = groups
        found = _again(Comparison.of(people, rig, step_s, [*clocks, *_of_all(groups)]), former[0])
        groups = [*groups, found] if found else groups
        n_steady = n_steady + 1 if _are_alike(found, former, people) else min(len(found), 1)
    return groups


def _are_alike(some: Sequence[Change], others: Sequence[Change], people: Sequence[Observations]) -> bool:
    begin_s, end_s = people[0].frame_time_s[[0, -1]]
    second_s = np.arange(begin_s, end_s, BLOCK_S)
    return len(some) == len(others) and all(a.is_like(b, second_s) for a, b in zip(some, others, strict=True))


def _compared(people: Sequence[Observations]) -> bool:
    """Whether two cameras see somebody in half of some seconds."""
    by_two = sum(int((own.seen.any(axis=2).sum(axis=1) >= 2).sum()) * usual_step_s(own.frame_time_s) for own in people)
    return by_two > 2 * MIN_BLOCKS * BLOCK_S


def _next(compared: Comparison, steps: _Steps, *, clocks: bool) -> list[Change] | LensFit:
    """The clearest change on top of others, with clocks also of these; none if there is no other."""
    rays, costs = compared.rays, compared.costs()
    walks = somebody_walks(rays, compared.blocks)
    each_camera = range(compared.rig.n_cameras)
    candidates = []
    for c in each_camera:
        candidates += _poses_of(rays, costs, c, walks=walks)
        hand_back()
        steps.one()
    candidates += [each for c in each_camera if clocks for each in _clocks_of(costs, c, compared.step_s)]
    fits = lens_fits(rays, costs, compared.rig, steps.one) if walks else []
    fits = [fit for fit in fits if is_clear(_of_motion(fit, costs)) and lens_matters(fit) and holds(fit)]
    # What needs no number goes before what does.
    lens = max(fits, key=lambda fit: fit.gain.sum() * (CLEARLY if len(fit.lens.values) == 2 else 1.0), default=None)
    if lens is not None:
        lens = replace(lens, or_else=_as_good(lens, fits))
    return _clearest(candidates, lens, compared)


def _again(compared: Comparison, change: Change) -> list[Change]:
    """A change of the clock or the pose of the same camera, on top of others."""
    c = change.camera
    costs = compared.costs(of_camera=c)
    if change.is_of_clock:
        candidates = _clocks_of(costs, c, compared.step_s)
    else:
        candidates = _poses_of(compared.rays, costs, c, walks=somebody_walks(compared.rays, compared.blocks))
    found = _clearest(candidates, None, compared)
    assert not isinstance(found, LensFit)
    return found


def _clearest(candidates: Sequence[Candidate], lens: LensFit | None, compared: Comparison) -> list[Change] | LensFit:
    while candidates:
        chosen = chosen_of(candidates, PER_STEP * compared.step_s / compared.rays.step_s)
        # A lens is one number, a pose are six.
        if lens is not None and float(lens.gain.sum()) * CLEARLY > chosen.gain:
            return lens
        found = placed(chosen, compared)
        if isinstance(chosen.fit, ClockFit) or _agrees(chosen.fit, compared.beside(*found), found[0].camera):
            return found
        candidates = [
            each for each in candidates if each.change.camera != chosen.change.camera or each.change.is_of_clock
        ]
    return lens if lens is not None else []


def _as_good(lens: LensFit, fits: Sequence[LensFit]) -> LensFit | None:
    """That of the same cameras which looks like it, if it fits as well."""
    alike = [fit for fit in fits if fit.cameras == lens.cameras and {fit.lens, lens.lens} in _ALIKE]
    return next((fit for fit in alike if fit.gain.sum() > _AS_GOOD * lens.gain.sum()), None)


def _agrees(fit: PoseFit, moved: Comparison, c: int) -> bool:
    """Whether the camera sees the same as the others, if it was moved: one that shows somebody else for a while, or a
    reflection, agrees better somewhere, and not well anywhere."""
    return misses_m(moved.rays, moved.blocks, c, fit.held) < AGREES_M


def _all_agree(compared: Comparison) -> bool:
    """Whether the rays of every camera meet those of the others."""
    everywhere = np.ones(compared.blocks.n_blocks, dtype=bool)
    cameras = range(compared.rig.n_cameras)
    return all(misses_m(compared.rays, compared.blocks, c, everywhere) < AGREES_M for c in cameras)


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
    edges = [fit.edges] if fit.end_edges is None else [fit.edges, fit.end_edges]
    changes = any(bool(costs.moves[max(first - 2, 0) : last + 1].any()) for first, last in edges)
    return fit.kind is Kind.BUMP and changes and not somebody_walks(rays, costs.blocks.only(fit.held))


def _of_motion(fit: LensFit, costs: LagCosts) -> LensFit:
    """As far as somebody moves: errors that a network makes of one posture look like another lens, however long."""
    return replace(fit, gain=fit.gain * costs.moves)
