"""Looking for the cause that makes cameras agree which do not."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Int

from fgpose.diagnosis.hypotheses.cameras import lens_hypotheses, other_focal, pose_hypotheses
from fgpose.diagnosis.hypotheses.consistency import SPREAD_M
from fgpose.diagnosis.hypotheses.exchanged import exchange_hypotheses, side_hypotheses
from fgpose.diagnosis.hypotheses.hypothesis import Causes, Hypothesis, mended
from fgpose.diagnosis.hypotheses.images import image_hypotheses, is_shift, shifted
from fgpose.diagnosis.hypotheses.pairs import pair_hypotheses
from fgpose.diagnosis.hypotheses.scene import SynchronousViews
from fgpose.diagnosis.hypotheses.sizes import is_common_size, is_part, resized, within_image
from fgpose.diagnosis.hypotheses.state import NORMAL_M, SearchState
from fgpose.finding import Code
from fgpose.sampling import spread_evenly

_NORMAL_OF_MANY_M = 0.03  # of two cameras of a right rig; the best of many turns of exchanged ones leaves 50 mm
# A cause is found if what is left of the cost is this share of it; the next best other one has to leave so many times
# as much.
EXPLAINED, _CLEARLY = 0.5, 1.5
# Of logarithms: a camera that was turned by 6 degrees moves the person by a sixth of half an image, by 10 degrees by a
# quarter.
_OTHER_SIZE = 0.15, 0.3
_NEARLY, _HARDLY = 1.1, 0.1  # times the cost that the best leaves, and of the cost
_WELL = 0.2  # of the cost: what leaves more may have another cause
_STEP = 0.85  # share of the cost that a first of several causes may leave, where each is of one camera
# Costs of thirds of the time with a cause that is there all the time are smaller, but for chance. A camera that was
# bumped by 2 degrees after 60 % of the time agrees better with another focal length, with twice the cost before.
_WORSE, _BY_CHANCE = 1.25, 0.005
_ENOUGH = 3  # cameras that agree are not all wrong alike
_COARSE_FRAMES, _FINE_FRAMES, _COARSE_JOINTS = 14, 40, 8
_FINALISTS = 10
_SIZE = 1.8  # children are half as large as the largest, and crouch


Whom = Literal["odd", "everybody", "each", "any"]
"""Whose input is wrong: see _candidates; any: of all alike or of each by itself."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """Causes that together make the cameras agree."""

    causes: Causes
    before: SearchState
    after: SearchState
    """Both on frames that were not looked at to find the causes."""
    rival: Hypothesis | None
    """One that explains the recording as well; None: there is none."""
    odd: tuple[int, ...] = ()
    """Cameras that disagree even so; after is of the others."""

    def of_others(self, scene: SynchronousViews) -> SynchronousViews:
        """Without the odd ones."""
        return scene.cameras([c for c in range(scene.n_cameras) if c not in self.odd]) if self.odd else scene


def explain(scene: SynchronousViews) -> Explanation | None:
    """The causes without which the cameras agree; None: none of those that are known.

    Causes are looked for in one half of the time and judged in the other.
    """
    looked_at, held_out = _halves(len(scene.time_s))
    coarse = scene.frames(looked_at[spread_evenly(len(looked_at), _COARSE_FRAMES)])
    coarse = coarse.joints(_coarse_joints(scene))
    fine = scene.frames(looked_at[spread_evenly(len(looked_at), _FINE_FRAMES)])
    judge = scene.frames(held_out[spread_evenly(len(held_out), _FINE_FRAMES)])
    found: list[Explanation] = []
    for whom in ("odd", "everybody", "each") if scene.n_cameras > 2 else ("any",):
        explanation = _found(coarse, fine, judge, whom)
        if explanation is not None:
            found.append(explanation)
            if explanation.after.cost < _WELL * explanation.before.cost:
                break
    if found:
        return min(found, key=lambda each: each.after.cost)
    return _unusual_found(coarse, fine, judge) if scene.n_cameras >= _ENOUGH else None


def _unusual_found(coarse: SynchronousViews, fine: SynchronousViews, judge: SynchronousViews) -> Explanation | None:
    """A cause beside another one, of cameras that certainly disagree."""
    found = None
    if SearchState(judge).is_normal:
        return None
    if judge.n_cameras > _ENOUGH:
        found = _found_but_for_one(coarse, fine, judge, "everybody") or _found_but_for_one(coarse, fine, judge, "each")
    found = found or _pair_found(coarse, fine, judge)
    return found if found and _CLEARLY * found.after.cost < _cost_but_for_one(judge) else None


def _cost_but_for_one(scene: SynchronousViews) -> float:
    """Of the cameras as they are, without the one without which they agree, if there is one: rather it is wrong than
    something rarer that explains hardly more."""
    everybody = range(scene.n_cameras)
    without = ([c for c in everybody if c != odd] for odd in everybody if scene.n_cameras > _ENOUGH)
    states = [SearchState(scene.cameras(kept)) for kept in without]
    return min((each.cost for each in states if each.is_normal), default=np.inf)


def _found_but_for_one(
    coarse: SynchronousViews, fine: SynchronousViews, judge: SynchronousViews, whom: Whom
) -> Explanation | None:
    """A cause with which all but one camera agree. Of another lens too much can be made agree, where one more camera
    is left out, and of one camera also of another size."""
    unlikely = (Code.WRONG_LENS,) if whom == "everybody" else (Code.WRONG_LENS, Code.IMAGE_SIZE)
    candidates = [each for each in _candidates(coarse, (), whom) if each.code not in unlikely]
    ranked = _ranked(fine, candidates, coarse)
    chosen = _first_credible(ranked, fine) if ranked else None
    if chosen is None:
        return None
    best, after = ranked[chosen]
    odd = int(np.argmax(np.nan_to_num(after.consistency.costs, nan=-1.0)))
    others = [c for c in range(judge.n_cameras) if c != odd]
    before, after = SearchState(judge.cameras(others)), SearchState(best.mend(judge).cameras(others))
    explained = after.is_normal and after.cost < EXPLAINED * before.cost and _all_the_time(before.scene, after.scene)
    return (
        Explanation((best,), SearchState(judge), after, None, (odd,)) if explained and best.cameras != (odd,) else None
    )


def _pair_found(coarse: SynchronousViews, fine: SynchronousViews, judge: SynchronousViews) -> Explanation | None:
    """Two causes of all cameras that help together only, if no other two do nearly as well."""

    def cost(causes: Causes, scene: SynchronousViews) -> float:
        return SearchState(mended(causes, scene)).cost

    first = sorted(pair_hypotheses(coarse), key=lambda causes: cost(causes, coarse))[:_FINALISTS]
    costs = [(cost(causes, fine), causes) for causes in first]
    best_cost, best = min(costs, key=lambda each: each[0])
    rivals = [causes for own, causes in costs if own < _CLEARLY * best_cost and _different(causes, best)]
    before, after = SearchState(judge), SearchState(mended(best, judge))
    explained = after.is_normal and after.cost < EXPLAINED * before.cost and _all_the_time(judge, after.scene)
    return Explanation(best, before, after, None) if explained and not rivals else None


def _different(some: Causes, others: Causes) -> bool:
    """But for whether a mirrored image has left and right exchanged, which no ray tells."""
    told = [
        [(cause.code, "" if cause.code is Code.MIRRORED_IMAGE else cause.reason) for cause in causes]
        for causes in (some, others)
    ]
    return told[0] != told[1]


def _halves(n_frames: int) -> tuple[Int[np.ndarray, " looked_at"], Int[np.ndarray, " held_out"]]:
    """Ten stretches of time, in turns."""
    stretch = np.arange(n_frames) * 10 // max(n_frames, 1)
    return np.flatnonzero(stretch % 2 == 0), np.flatnonzero(stretch % 2 == 1)


def _coarse_joints(scene: SynchronousViews) -> Int[np.ndarray, " joint"]:
    """The first ones with those of the other side: shoulders, elbows, wrists and hips of limb_joints."""
    some = np.arange(min(_COARSE_JOINTS, len(scene.mirror)))
    return np.unique(np.concatenate([some, scene.mirror[some]]))


def _found(coarse: SynchronousViews, fine: SynchronousViews, judge: SynchronousViews, whom: Whom) -> Explanation | None:
    given, before, causes = judge, SearchState(judge), ()
    while len(causes) < coarse.n_cameras:
        ranked = _ranked(fine, list(_candidates(coarse, causes, whom)), coarse)
        if not ranked:
            return None
        chosen = _first_credible(ranked, fine)
        if chosen is None or ranked[chosen][1].cost > _STEP * SearchState(fine).cost:
            return None
        (best, after), rivals = ranked[chosen], ranked[chosen + 1 :]
        causes = (*causes, best)
        coarse, fine, judge = (best.mend(each) for each in (coarse, fine, judge))
        if after.is_normal and SearchState(judge).is_normal and SearchState(judge).cost < EXPLAINED * before.cost:
            if not _all_the_time(given, judge):
                return None
            return Explanation(causes, before, SearchState(judge), _rival(best, after, rivals))
        if len(best.cameras) == coarse.n_cameras and best.code is not Code.EXCHANGED_CAMERAS:
            return None
    return None


def _all_the_time(before: SynchronousViews, after: SynchronousViews) -> bool:
    """Whether the causes make no third of the time worse: where they do, something has changed since."""
    thirds = np.array_split(np.arange(len(before.time_s)), 3)
    costs = [
        (SearchState(before.frames(third)).cost, SearchState(after.frames(third)).cost)
        for third in thirds
        if len(third)
    ]
    return all(own_after < _WORSE * own_before + _BY_CHANCE for own_before, own_after in costs)


def _first_credible(ranked: list[tuple[Hypothesis, SearchState]], scene: SynchronousViews) -> int | None:
    """Of those that are nearly as good as the best, or leave hardly anything: sizes are common ones, which the best on
    a grid may miss, and with two cameras some focal length suits almost everything."""
    enough = max(_NEARLY * ranked[0][1].cost, _HARDLY * SearchState(scene).cost)
    for place, (cause, after) in enumerate(ranked):
        if after.cost > enough:
            return None
        if _is_credible(cause, scene):
            return place
    return None


def _is_credible(cause: Hypothesis, scene: SynchronousViews) -> bool:
    """Two cameras agree on so little that almost any size or focal length can be found that makes them agree; and a
    camera that was turned agrees better with images of another size, but not of one that anybody uses."""
    if cause.of_many and scene.n_cameras == 2:
        return bool((SearchState(cause.mend(scene)).medians_m < _NORMAL_OF_MANY_M).all())
    if cause.code is Code.IMAGE_SIZE:
        factors = cause.numbers["factor_x"], cause.numbers["factor_y"]
        change = float(np.abs(np.log(factors)).max())
        if len(cause.cameras) < scene.n_cameras and change < _OTHER_SIZE[0]:
            return False
        squeezed = factors[0] != factors[1] and 1.0 in factors  # no pose does that
        plain = (change > _OTHER_SIZE[1] or squeezed) and scene.n_cameras > 2
        return within_image(cause, scene) and (plain or is_part(cause) or is_common_size(cause, scene))
    return cause.code is not Code.WRONG_LENS or (scene.n_cameras > 2 and _has_size(cause.mend(scene)))


def _has_size(scene: SynchronousViews) -> bool:
    """Whether the body is neither a doll nor a giant: the longer the focal length, the nearer together are its joints,
    and the less rays miss each other that are of nothing."""
    positions_m = SearchState(scene).consistency.positions_m
    known = np.isfinite(positions_m).all(axis=(1, 2))
    if not known.any():
        return True
    offsets_m = positions_m[known] - positions_m[known].mean(axis=1, keepdims=True)
    return SPREAD_M / _SIZE < float(np.median(np.linalg.norm(offsets_m, axis=-1))) < SPREAD_M * _SIZE


def _rival(best: Hypothesis, after: SearchState, others: Iterable[tuple[Hypothesis, SearchState]]) -> Hypothesis | None:
    """The next best that is another cause, or of other cameras, if it is nearly as good."""
    for other, state in others:
        if _remedied(other) != _remedied(best) and state.is_normal:
            return other if state.cost < _CLEARLY * after.cost else None
    return None


def _remedied(cause: Hypothesis) -> tuple[Code, tuple[int, ...], bool]:
    return cause.code, cause.cameras, is_part(cause)


def _ranked(
    fine: SynchronousViews, candidates: Iterable[Hypothesis], coarse: SynchronousViews
) -> list[tuple[Hypothesis, SearchState]]:
    """The best ones by the finer sample, sizes and focal lengths to within a thousandth."""
    first = [(SearchState(each.mend(coarse)).cost, each) for each in candidates]
    finalists = [each for _, each in sorted(first, key=lambda pair: pair[0])[: 3 * _FINALISTS]]
    second = sorted(((SearchState(each.mend(fine)).cost, each) for each in finalists), key=lambda pair: pair[0])
    refined = [_refined(each, fine) for _, each in second[:_FINALISTS]]
    states = [(each, SearchState(each.mend(fine))) for each in refined]
    return sorted(states, key=lambda pair: pair[1].cost + 0.003 * (pair[0].preference + len(pair[0].cameras)))


def _candidates(scene: SynchronousViews, causes: tuple[Hypothesis, ...], whom: Whom) -> Iterator[Hypothesis]:
    """Of the cameras that do not agree with three others that do, of all alike, or of each by itself."""
    everybody = tuple(range(scene.n_cameras))
    changed = {c for cause in causes for c in cause.cameras}
    if whom == "odd":
        odd = tuple(np.flatnonzero(~(SearchState(scene).medians_m < NORMAL_M)).tolist())
        if scene.n_cameras - len(odd) >= _ENOUGH:
            yield from exchange_hypotheses(scene, odd)
            yield from _of_group_each([(c,) for c in odd if c not in changed], scene)
        return
    if whom != "each":
        if not causes:
            yield from pose_hypotheses(scene)
            yield from _of_group_each([everybody], scene)
        if not causes or causes[0].code is Code.EXCHANGED_CAMERAS:
            yield from exchange_hypotheses(scene, everybody)
    if whom != "everybody":
        yield from _of_group_each([(c,) for c in everybody if c not in changed], scene)


def _of_group_each(groups: Iterable[tuple[int, ...]], scene: SynchronousViews) -> Iterator[Hypothesis]:
    """What may be wrong of cameras alike."""
    for group in groups:
        yield from image_hypotheses(scene, group)
        yield from lens_hypotheses(scene, group)
        yield from side_hypotheses(group)


def _refined(hypothesis: Hypothesis, scene: SynchronousViews) -> Hypothesis:
    """With the best size, focal length or shift near that of the grid."""
    make: Callable[[float], Hypothesis]
    cameras, numbers = hypothesis.cameras, hypothesis.numbers
    is_size = hypothesis.code is Code.IMAGE_SIZE and not is_part(hypothesis)
    if is_size and numbers["factor_x"] == numbers["factor_y"]:
        make = lambda factor: resized(scene, cameras, (factor, factor))  # noqa: E731
        first, step = numbers["factor_x"], 0.02
    elif "focal_factor" in numbers:
        make = lambda factor: other_focal(scene, cameras, factor)  # noqa: E731
        first, step = numbers["focal_factor"], 0.02
    elif is_shift(hypothesis):
        ((name, first),) = numbers.items()
        make = lambda px: shifted(scene, cameras, {name: px})  # noqa: E731
        step = 0.3
    else:
        return hypothesis
    while step > 0.001:
        tried = [make(first * np.exp(change)) for change in (-step, 0.0, step)]
        best = min(tried, key=lambda each: SearchState(each.mend(scene)).cost)
        first, step = first * float(np.exp((-step, 0.0, step)[tried.index(best)])), step / 2
    return make(first)
