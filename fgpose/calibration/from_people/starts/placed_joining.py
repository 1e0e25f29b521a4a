"""Whole shifts between the clocks of cameras whose poses are known, by the joints themselves.

At the right moment a joint lies on the epipolar line that another camera's image of it has, wherever it is; at others
it does not, unless nobody has moved. So all shifts are tried, and what decides between two of them is how often the
joints fit better at one than at the other. Cameras without poses are joined by signals of the motion (joining.py).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from jaxtyping import Float, Int

from fgpose.calibration.from_people.starts.correlation import Correlation, chance_of, peaks
from fgpose.calibration.from_people.starts.epipolar_shift import INDEPENDENT_S, SPREAD
from fgpose.calibration.from_people.starts.joining import Joined, Joining
from fgpose.calibration.from_people.starts.views import View
from fgpose.estimation.noise import TELLING_HZ
from fgpose.sampling import spread_evenly

# Somebody who walks is 50 mm further after this, twice what detectors miss a joint by.
_STEP_S = 1 / TELLING_HZ
_MAX_SAMPLES = 300
_MAX_PEAKS = 6
# Two videos of which less than this shows the same time are not compared.
_LEAST_S = 1.5
# The best of some tens of independent shifts is seldom this many standard deviations better than the next where neither
# is right: at 2.5 no camera of 100 simulated takes of 6 and 8 s joined at a wrong moment.
_DECISIVE = 3.0
# By how much better than chance the joints may fit at another moment, relative to the best. One stride beside it a
# simulated walk through a room fits 0.1 to 0.35 times as well, on a treadmill 0.67 to 1.0 times: there the strides
# differ by little more than the errors of detectors, and these repeat themselves with the gait.
_MAX_ALIKE = 0.6
# One other moment is no repetition, unless it is the next stride, which even a slow walker makes within this time.
_REPEATED, _STRIDE_S = 2, 1.4
# All pairs see the same motion: where nearly all of so many see it repeat itself, it does for the others. Of a motion
# that does not, some pairs see too little.
_FEWEST_PAIRS, _NEARLY_ALL = 5, 0.8


@dataclass(frozen=True, eq=False)
class _Pair:
    """Epipolar distances in the image of one camera, of the joints that the other saw at some of its times."""

    time_s: Float[np.ndarray, " sample"]
    """By the clock of the other camera."""
    lines: Float[np.ndarray, "sample joint 3"]
    """In the image of the camera, of unit normal; NaN = not seen."""
    view: View

    @staticmethod
    def of(other: View, view: View) -> _Pair:
        """Lines of the joints of the other view, spread over its time."""
        seen = np.flatnonzero(np.isfinite(other.xy).all(axis=-1).any(axis=-1))
        some = seen[spread_evenly(len(seen), _MAX_SAMPLES)] if len(seen) else seen
        homogeneous = np.concatenate([other.xy[some], np.ones((*other.xy[some].shape[:2], 1))], axis=-1)
        lines = homogeneous @ view.essential_with(other).T
        normal = np.linalg.norm(lines[..., :2], axis=-1, keepdims=True)
        return _Pair(other.time_s[some], lines / np.maximum(normal, 1e-12), view)

    def costs(self, shift_s: float) -> Float[np.ndarray, " sample"]:
        """Mean over the joints of r^2 / (1 + r^2), r the distance relative to what detectors miss a joint by; NaN where
        the camera sees none of them.

        Args:
            shift_s: time of the other clock = time of the camera's + shift_s.
        """
        own_s = self.time_s - shift_s
        distance = np.einsum("sjk,sjk->sj", self.lines[..., :2], self.view.at(own_s)) + self.lines[..., 2]
        square = (distance / (SPREAD * self.view.radius_at(own_s)[:, None])) ** 2
        known = np.isfinite(square)
        costs = np.where(known, square / (1 + square), 0.0).sum(axis=1)
        return np.where(known.any(axis=1), costs / np.maximum(known.sum(axis=1), 1), np.nan)


@dataclass(frozen=True, eq=False)
class _Compared:
    """A camera and another one: how well the joints fit at every shift."""

    pair: _Pair
    first: int
    """The first shift, in steps."""
    gain: Float[np.ndarray, " shift"]
    """Sum over independent samples of how much better they fit than by chance; 0 where too little is in common."""
    chance: float
    """Cost of a sample at a shift that is not the right one."""

    @staticmethod
    def of(other: View, view: View) -> _Compared:
        pair = _Pair.of(other, view)
        low = int(np.ceil((other.time_s[0] - view.time_s[-1] + _LEAST_S) / _STEP_S))
        high = int(np.floor((other.time_s[-1] - view.time_s[0] - _LEAST_S) / _STEP_S))
        costs = [pair.costs(shift * _STEP_S) for shift in range(low, high + 1)]
        if not costs or not np.isfinite(costs).any():
            return _Compared(pair, low, np.zeros(len(costs)), 1.0)
        means = np.array([np.nan if np.isnan(each).all() else np.nanmean(each) for each in costs])
        chance = float(np.nanmedian(means))
        gain = np.array([np.nansum(chance - each) for each in costs]) * _independent(pair.time_s)
        return _Compared(pair, low, gain, chance)

    def at(self, shifts: Int[np.ndarray, " shift"]) -> Float[np.ndarray, " shift"]:
        """The gain; 0 outside."""
        index = shifts - self.first
        inside = (index >= 0) & (index < len(self.gain))
        return np.where(inside, self.gain[np.clip(index, 0, max(len(self.gain) - 1, 0))] if len(self.gain) else 0.0, 0)

    def blocks(self, shift_s: float) -> Float[np.ndarray, " block"]:
        """Of stretches of time whose errors are independent, how much better they fit than by chance."""
        gain = np.nan_to_num(self.chance - self.pair.costs(shift_s))
        _, block = np.unique(np.floor(self.pair.time_s / INDEPENDENT_S), return_inverse=True)
        return np.bincount(block, gain) / np.maximum(np.bincount(block), 1)


def fits_at_shifts(other: View, view: View) -> Correlation:
    """How much better than by chance the joints of two tracks fit, at every shift between the clocks of placed cameras;
    in units of what chance makes of that."""
    compared = _Compared.of(other, view)
    return Correlation(compared.first, compared.gain / chance_of(compared.gain[compared.gain != 0]))


def _independent(time_s: Float[np.ndarray, " sample"]) -> float:
    """Share of the samples that there would be if there were one for each independent error."""
    blocks = len(np.unique(np.floor(time_s / INDEPENDENT_S)))
    return blocks / max(len(time_s), 1)


@dataclass(frozen=True)
class _Proposed:
    """How a camera would join others."""

    joined: Joined
    clear: float
    """By how many standard deviations the best moment is better than the next, and than chance."""

    def one_of_many(self, stride_s: float) -> _Proposed:
        """Of a motion that repeats itself after this time: another moment would fit as well, but for chance."""
        joined = self.joined
        alike_s = joined.alike_s or (joined.best_s - stride_s, joined.best_s + stride_s)
        return _Proposed(replace(joined, is_decisive=False, alike_s=alike_s), 0.0)


def _repeated_s(pairs: Sequence[Joined]) -> float | None:
    """After which time the motion repeats itself, as nearly all pairs of cameras see it; None: it does not."""
    strides_s = [min(abs(each - pair.best_s) for each in pair.alike_s) for pair in pairs if pair.alike_s]
    if len(pairs) < _FEWEST_PAIRS or len(strides_s) < _NEARLY_ALL * len(pairs):
        return None
    return float(np.median(strides_s))


@dataclass
class _Cameras:
    """All pairs that were compared so far."""

    views: Sequence[View]
    _compared: dict[tuple[int, int], _Compared] = field(default_factory=dict)

    def propose(self, camera: int, others_s: Mapping[int, float]) -> _Proposed | None:
        """The best moment for a camera to join others; None if no moment is possible."""
        compared = {other: self._pair(other, camera) for other in others_s}
        steps = {other: round(offset_s / _STEP_S) for other, offset_s in others_s.items()}
        low = min(each.first + steps[other] for other, each in compared.items())
        high = max(each.first + len(each.gain) + steps[other] for other, each in compared.items())
        offsets = np.arange(low, high)
        # The shift between two clocks is the difference of their offsets.
        gain = np.sum([each.at(offsets - steps[other]) for other, each in compared.items()], axis=0)
        moments_s: list[float] = (offsets[peaks(gain, _MAX_PEAKS)] * _STEP_S).tolist()
        if not moments_s:
            return None

        def blocks(offset_s: float) -> np.ndarray:
            return np.concatenate([each.blocks(offset_s - others_s[other]) for other, each in compared.items()])

        best_s, *next_s = moments_s
        at_best = blocks(best_s)
        better = {other_s: _sigmas(at_best - blocks(other_s)) for other_s in next_s}
        second_s = min(better, key=lambda other_s: better[other_s], default=None)
        outstanding = _sigmas(at_best)
        clear = min([outstanding, *better.values()])
        fits = dict(
            zip(moments_s, gain[np.round(np.array(moments_s) / _STEP_S).astype(int) - low].tolist(), strict=True)
        )
        alike_s = tuple(other_s for other_s in next_s if fits[other_s] > _MAX_ALIKE * fits[best_s])
        if len(alike_s) < _REPEATED and not any(abs(each - best_s) < _STRIDE_S for each in alike_s):
            alike_s = ()
        is_decisive = clear >= _DECISIVE and not alike_s
        clear = 0.0 if alike_s else clear
        joined = Joined(camera, best_s, second_s, outstanding >= _DECISIVE, is_decisive, alike_s)
        return _Proposed(joined, clear)

    def _pair(self, other: int, camera: int) -> _Compared:
        if (other, camera) not in self._compared:
            self._compared[other, camera] = _Compared.of(self.views[other], self.views[camera])
        return self._compared[other, camera]


def _sigmas(blocks: Float[np.ndarray, " block"]) -> float:
    """Sum of independent differences, in its standard deviations if their mean were zero."""
    return float(blocks.sum() / max(np.sqrt(np.sum(blocks**2)), 1e-12))


def join_placed(views: Sequence[View], offsets_s: Mapping[int, float] | None = None) -> Joining:
    """Whole offsets of all cameras that can be joined.

    It begins with the two cameras whose moment is clearest; then always the camera joins whose moment, by all that have
    joined, is clearest.

    Args:
        views: of all cameras, with their poses; empty where nobody is seen.
        offsets_s: of cameras that have joined already.
    """
    cameras, joining = _Cameras(views), Joining(dict(offsets_s or {}), {})
    waiting = {c for c, view in enumerate(views) if np.isfinite(view.xy).any()} - set(joining.offsets_s)
    while waiting:
        known_s = joining.offsets_s
        tries = [(c, known_s) for c in waiting] if known_s else [(b, {a: 0.0}) for a, b in combinations(waiting, 2)]
        proposed = [(each, others_s) for c, others_s in tries if (each := cameras.propose(c, others_s)) is not None]
        if not proposed:
            break
        if not known_s and (stride_s := _repeated_s([each.joined for each, _ in proposed])) is not None:
            proposed = [(each.one_of_many(stride_s), others_s) for each, others_s in proposed]
        for each, others_s in sorted(proposed, key=lambda found: found[0].clear):
            joining.joined.update(dict.fromkeys([each.joined.camera, *(() if known_s else others_s)], each.joined))
        best, others_s = max(proposed, key=lambda found: found[0].clear)
        if not best.joined.is_decisive:
            break
        joining.offsets_s.update({**others_s, best.joined.camera: best.joined.best_s})
        waiting -= set(joining.offsets_s)
    return joining
