"""Keypoints that belong to other cameras, or to mirrored images, from a moment on or until one.

What is so all the time is looked for among all causes (search). Files that were cut and put together again, cameras
that were plugged in again, and programs that were started again begin to be wrong at a moment; that a camera was bumped
then, that its clock runs at another rate, or that somebody else came, suits a part of it, and nothing well.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.diagnosis.hypotheses.consistency import NEAR_M
from fgpose.diagnosis.hypotheses.exchanged import exchange_hypotheses
from fgpose.diagnosis.hypotheses.hypothesis import Hypothesis
from fgpose.diagnosis.hypotheses.images import mirrored_hypotheses
from fgpose.diagnosis.hypotheses.scene import SynchronousViews
from fgpose.diagnosis.hypotheses.search import EXPLAINED
from fgpose.diagnosis.hypotheses.state import SearchState

# Of the frames that are looked at (two minutes of each hour, all of a few seconds), and of the time.
_FEWEST, _LEAST_S = 12, 2.0


@dataclass(frozen=True, eq=False)
class SinceAMoment:
    """A cause of a part of a recording."""

    cause: Hypothesis
    at_s: float
    """When it begins or, if it is until then, ends."""
    until: bool
    before: SearchState
    after: SearchState
    """The part as it is, and put right."""


def since_a_moment(state: SearchState) -> SinceAMoment | None:
    """The one without which cameras agree in the part that suits it best, where they do in the rest as it is.

    Args:
        state: of frames spread over the whole recording.
    """
    scene = state.scene
    if state.is_clean or scene.n_cameras < 2 or len(scene.time_s) < 2 * _FEWEST:
        return None
    given = _costs(state)
    found = []
    for cause in _causes(scene):
        gain = given - _costs(SearchState(cause.mend(scene)))
        for until in (False, True):
            part, total = _best_part(gain, until=until)
            found.append((total, part, until, cause))
    for _, part, until, cause in sorted(found, key=lambda each: -each[0])[:2]:
        if (one := _judged(scene, cause, part, until=until)) is not None:
            return one
    return None


def _causes(scene: SynchronousViews) -> Iterator[Hypothesis]:
    cameras = range(scene.n_cameras)
    for pair in combinations(cameras, 2):
        yield from exchange_hypotheses(scene, pair)
    for camera in cameras:
        yield from mirrored_hypotheses((camera,))


def _costs(state: SearchState) -> Float[np.ndarray, " frame"]:
    """Of each frame, between 0 and 1; 0 where nothing can be judged."""
    found = state.consistency
    cost = np.where(found.judged, np.minimum((found.distance_m / NEAR_M) ** 2, 1.0), 0.0).sum(axis=(1, 2))
    return cost / np.maximum(found.judged.sum(axis=(1, 2)), 1)


def _best_part(gain: Float[np.ndarray, " frame"], *, until: bool) -> tuple[Bool[np.ndarray, " frame"], float]:
    """The frames from one on, or until one, in which costs are less by most."""
    total = np.cumsum(gain if until else gain[::-1])[_FEWEST - 1 : len(gain) - _FEWEST]
    number = _FEWEST + int(np.argmax(total))
    part = np.arange(len(gain)) < number
    return part if until else part[::-1], float(total.max())


def _judged(
    scene: SynchronousViews, cause: Hypothesis, part: Bool[np.ndarray, " frame"], *, until: bool
) -> SinceAMoment | None:
    """If cameras agree as those of a right recording do, in the part with the cause put right and in the rest."""
    of_part = scene.frames(np.flatnonzero(part))
    before, after = SearchState(of_part), SearchState(cause.mend(of_part))
    rest = SearchState(scene.frames(np.flatnonzero(~part)))
    lasts_s = float(np.ptp(of_part.time_s))
    if lasts_s < _LEAST_S or before.is_normal or not after.is_normal or not rest.is_normal:
        return None
    if after.cost > EXPLAINED * before.cost:
        return None
    at_s = float(of_part.time_s[-1 if until else 0])
    return SinceAMoment(cause, at_s, until, before, after)
