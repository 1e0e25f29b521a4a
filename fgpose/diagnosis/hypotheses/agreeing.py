"""Which cameras agree, where not all do."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from fgpose.diagnosis.hypotheses.scene import Scene
from fgpose.diagnosis.hypotheses.search import State
from fgpose.diagnosis.hypotheses.steadiness import STEADY

# Two cameras agree on much. With a third that is wrong, the two right ones see a body that is so much steadier than the
# other pairs do.
_CLEARLY_STEADIER = 2.0
# Times the cost of the next pair. Of a camera that was turned by 6 degrees one pair may still be normal.
_CLEARLY_NEARER = 4.0


def agreeing(scene: Scene) -> tuple[int, ...]:
    """The largest part of the cameras that agree; none where that is not clear.

    It is found by leaving out the worst one time after the other; of three, by which two alone agree, or see a body.
    """
    kept = tuple(range(scene.n_cameras))
    while len(kept) >= 3:
        state = State(scene.cameras(kept))
        if state.is_normal:
            return kept
        if len(kept) == 3:
            return _pair_that_sees_a_body(scene, kept)
        costs = np.nan_to_num(state.agreement.costs, nan=-1.0)
        kept = tuple(c for place, c in enumerate(kept) if place != int(np.argmax(costs)))
    return ()


def _pair_that_sees_a_body(scene: Scene, cameras: tuple[int, ...]) -> tuple[int, ...]:
    states = {pair: State(scene.cameras(pair)) for pair in combinations(cameras, 2)}
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
