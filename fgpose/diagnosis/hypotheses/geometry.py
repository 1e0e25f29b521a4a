"""Whether cameras agree where the body is; and if not, why."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float, Int

from fgpose.calibration.changes.find_changes import LEAST_S
from fgpose.diagnosis.hypotheses.cameras import other_focal
from fgpose.diagnosis.hypotheses.consistency import STEADY
from fgpose.diagnosis.hypotheses.exchanged import side_hypotheses
from fgpose.diagnosis.hypotheses.images import turned_hypotheses
from fgpose.diagnosis.hypotheses.one_camera import OddCamera, clocks_differ, why_odd
from fgpose.diagnosis.hypotheses.scene import SynchronousViews
from fgpose.diagnosis.hypotheses.search import EXPLAINED, Explanation, explain
from fgpose.diagnosis.hypotheses.state import NORMAL_M, SearchState
from fgpose.finding import Code
from fgpose.sampling import spread_evenly

Scene = Callable[[Int[np.ndarray, " sample"]], SynchronousViews]

_FRAMES = 120
# Two cameras whose rays pass each other by this are not of one recording: see state.NORMAL_M.
_FAR_M = 0.12
# Of two cameras that agree where occluders hide a third of the joints it is 53 mm.
_HARDLY_M = 0.1
# A camera with twice the error of the others has a systematic one of 1.7 times the random one (camera_checks.py).
_STANDS_OUT = 2.5
_FEW_NEAR = 0.4
_NO_BODY = 0.8  # unsteadiness: limbs that change by nearly as much as they are long
_DENSE_S, _DENSE_FRAMES = 60.0, 600
_ZOOMS = (0.65, 0.8, 0.9, 1.1, 1.25, 1.5)
# Two cameras agree on much. With a third that is wrong, the two right ones see a body that is so much steadier than the
# other pairs do.
_CLEARLY_STEADIER = 2.0
# Times the cost of the next pair. Of a camera that was turned by 6 degrees one pair may still be normal.
_CLEARLY_NEARER = 4.0


@dataclass(frozen=True, eq=False)
class Geometry:
    """What was found of a recording and its rig."""

    state: SearchState
    """Of frames spread over the whole recording."""
    explanation: Explanation | None = None
    agreeing: tuple[int, ...] = ()
    """The cameras that agree, where not all do and nothing explains it."""
    odd: tuple[tuple[int, OddCamera], ...] = ()
    """The others, and what is known of them."""
    clocks_differ: bool = False
    """Whether no cameras agree, but all do if their clocks differ."""

    @property
    def normal(self) -> bool:
        """Whether all cameras agree as those of a right recording do."""
        return self.state.is_normal

    @property
    def usable(self) -> bool:
        """Whether a body can be judged from what they see."""
        medians_m = self.state.medians_m[~np.isnan(self.state.medians_m)]
        return self.explanation is None and bool(medians_m.size) and not bool((medians_m > _FAR_M).any())

    @property
    def wrong(self) -> bool:
        """Whether they disagree by more than hidden joints cause."""
        medians_m = self.state.medians_m
        far = bool((medians_m[~np.isnan(medians_m)] > _FAR_M).any()) or bool(np.isnan(medians_m).all())
        if self.state.scene.n_cameras == 2:  # what either hallucinates, both miss
            far &= bool((self.state.consistency.shares < _FEW_NEAR).any())
        unsteady = bool(self.state.unsteadiness > _NO_BODY)
        return far or (self.state.scene.n_cameras == 2 and unsteady and self._parallax)

    @property
    def hardly_agrees(self) -> bool:
        """Whether two cameras miss most joints by more than those that see the same, be much of it hidden; not where
        their rays are too nearly parallel to tell."""
        medians_m = self.state.medians_m
        return self.state.scene.n_cameras == 2 and bool((np.isfinite(medians_m) & (medians_m > _HARDLY_M)).any())

    @property
    def stands_out(self) -> bool:
        """Whether one camera disagrees much more than the others do."""
        medians_m = np.nan_to_num(self.state.medians_m, nan=0.0)
        worst = int(np.argmax(medians_m))
        usual_m = float(np.median(np.delete(medians_m, worst)))
        return bool(len(medians_m) > 2 and medians_m[worst] > max(_STANDS_OUT * usual_m, NORMAL_M))

    @property
    def _parallax(self) -> bool:
        """Whether two cameras look from sides that differ by 20 to 160 degrees: else depths are not known."""
        forward = [view.camera.world_T_camera[:3, 2] for view in self.state.scene.views]
        return bool(abs(forward[0] @ forward[1]) < np.cos(np.deg2rad(20)))


def examine(scene: Scene, time_s: Float[np.ndarray, " frame"]) -> Geometry:
    """Of a recording of one person.

    Args:
        scene: what was seen in some frames, of limbs at least.
        time_s: of all frames.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of what is not known: infinite, or NaN
        return _examined(scene, time_s)


def _examined(scene: Scene, time_s: Float[np.ndarray, " frame"]) -> Geometry:
    sample = scene(spread_evenly(len(time_s), _FRAMES))
    first = Geometry(SearchState(sample))
    if sample.n_cameras < 2 or not first.state.consistency.judged.any():
        return first
    if first.state.is_clean and not _clearly_better(sample):
        return first
    explanation = explain(sample)
    if explanation is not None and first.normal and _is_told_by_time(explanation, time_s):
        return first
    if explanation is not None or not (first.wrong or first.stands_out):
        return Geometry(first.state, explanation)
    kept, dense = agreeing(sample), scene(_dense(time_s))
    if not kept:
        return Geometry(first.state, clocks_differ=first.wrong and clocks_differ(dense))
    others = [c for c in range(sample.n_cameras) if c not in kept]
    return Geometry(first.state, None, kept, tuple((c, why_odd(sample, dense, c, kept)) for c in others))


def _is_told_by_time(explanation: Explanation, time_s: Float[np.ndarray, " frame"]) -> bool:
    """Whether rays that hardly miss each other miss by even less with another lens: so they do where a camera was
    bumped, or from one side. From enough seconds find_changes tells it apart from that, or that nothing does."""
    lenses = all(cause.code is Code.WRONG_LENS for cause in explanation.causes)
    return lenses and float(np.ptp(time_s)) >= LEAST_S


def _clearly_better(scene: SynchronousViews) -> bool:
    """Whether cameras that agree do so much better with a cause that may hardly make rays miss each other.

    Another focal length of all, as long as the body is in the middle of the images, which two cameras cannot tell; and
    where the body is nearly the same, seen from the front and from behind, exchanged sides and mirrored images.
    """
    everybody = tuple(range(scene.n_cameras))
    causes = [cause for c in everybody for cause in side_hypotheses((c,))]
    causes += turned_hypotheses(scene, everybody)
    if scene.n_cameras == 2:
        causes += [cause for c in everybody for cause in turned_hypotheses(scene, (c,))]
    else:
        causes += [other_focal(scene, everybody, factor) for factor in _ZOOMS]
    return min(SearchState(cause.mend(scene)).cost for cause in causes) < EXPLAINED * SearchState(scene).cost


def _dense(time_s: Float[np.ndarray, " frame"]) -> Int[np.ndarray, " sample"]:
    """At most a minute from the middle."""
    middle_s = (time_s[0] + time_s[-1]) / 2
    within = np.flatnonzero(np.abs(time_s - middle_s) <= _DENSE_S / 2)
    return within[spread_evenly(len(within), _DENSE_FRAMES)]


def agreeing(scene: SynchronousViews) -> tuple[int, ...]:
    """The largest part of the cameras that agree; none where that is not clear.

    It is found by leaving out the worst one time after the other; of three, by which two alone agree, or see a body.
    """
    kept = tuple(range(scene.n_cameras))
    while len(kept) >= 3:
        state = SearchState(scene.cameras(kept))
        if state.is_normal:
            return kept
        if len(kept) == 3:
            return _pair_that_sees_a_body(scene, kept)
        costs = np.nan_to_num(state.consistency.costs, nan=-1.0)
        kept = tuple(c for place, c in enumerate(kept) if place != int(np.argmax(costs)))
    return ()


def _pair_that_sees_a_body(scene: SynchronousViews, cameras: tuple[int, ...]) -> tuple[int, ...]:
    states = {pair: SearchState(scene.cameras(pair)) for pair in combinations(cameras, 2)}
    ranked = sorted(states, key=lambda pair: np.nan_to_num(states[pair].unsteadiness, nan=np.inf))
    best, second = states[ranked[0]], states[ranked[1]]
    agree = [pair for pair in ranked if states[pair].is_normal]
    if len(agree) == 1:
        return agree[0]
    nearest, next_nearest = sorted(states, key=lambda pair: states[pair].cost)[:2]
    if states[nearest].is_normal and states[next_nearest].cost > _CLEARLY_NEARER * states[nearest].cost:
        return nearest
    clear = best.is_normal and second.unsteadiness > max(_CLEARLY_STEADIER * best.unsteadiness, STEADY)
    return ranked[0] if clear else ()
