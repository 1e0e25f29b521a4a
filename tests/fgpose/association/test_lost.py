"""In how large a room somebody who was lost may come back, and who comes back, where bones or place tell it."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from fgpose.association.identity.likeness import RECOGNISED, UNAMBIGUOUS, Lengths, Likeness, Passage
from fgpose.association.identity.lost import Lost, links
from fgpose.skeleton import Skeleton


def walked(lost: Lost, extent_m: tuple[float, float], first_s: int, last_s: int) -> None:
    """Somebody is anywhere in a rectangle, ten moments a second."""
    rng = np.random.default_rng(first_s)
    for tenth in range(10 * first_s, 10 * last_s):
        place_m = np.append(rng.uniform((0.0, 0.0), extent_m), 1.0)
        lost.room.add([place_m], tenth / 10)


def test_one_false_track_far_away_does_not_make_the_room_larger() -> None:
    lost = Lost(forget_s=600.0)
    walked(lost, (4.0, 6.0), 0, 400)
    before_m2 = lost.room.area_m2
    # A hundredth at both ends is left out of each side; 400 places draw the sides to some percent.
    assert before_m2 == pytest.approx(24.0 * 0.98**2, rel=0.05)
    for second in range(400, 403):
        lost.room.add([np.array([75.0, 0.0, 1.0])], float(second))
    assert lost.room.area_m2 < 1.1 * before_m2


def test_the_room_is_that_of_late_and_takes_a_bounded_memory() -> None:
    lost = Lost(forget_s=60.0)
    walked(lost, (40.0, 60.0), 0, 100)
    walked(lost, (4.0, 6.0), 100, 200)
    assert lost.room.area_m2 < 25.0
    assert len(lost.room._places) <= 61


def test_nobody_has_been_anywhere_at_first() -> None:
    assert Lost(forget_s=60.0).room.area_m2 == 0.0


ROOM_M2 = 40.0


def looks(skeleton: Skeleton, scale: float) -> Likeness:
    """Of somebody whose lengths were measured 50 times, to 3 cm each."""
    likeness = Likeness(skeleton)
    n, variance_m2 = np.full(skeleton.n_lengths, 50.0), 0.03**2
    likeness.before = Lengths(n, n / variance_m2, np.full_like(n, 0.35 * scale), n)
    return likeness


def passage(skeleton: Skeleton, begin_s: float, end_s: float, scale: float, x_m: float = 0.0) -> Passage:
    place_m = np.array([x_m, 0.0, 1.0])
    return Passage(begin_s, place_m, end_s, place_m, looks(skeleton, scale))


def pairs(passages: dict[int, Passage]) -> list[tuple[int, int]]:
    return [(link.before, link.after) for link in links(passages, ROOM_M2)]


def test_two_who_leave_and_return_are_told_apart_by_their_bones(skeleton: Skeleton) -> None:
    """They come back in the other order, each where the other one left."""
    passages = {
        0: passage(skeleton, 0.0, 10.0, 1.0, -1.0),
        1: passage(skeleton, 0.0, 11.0, 1.15, 1.0),
        2: passage(skeleton, 15.0, 20.0, 1.15, -1.0),
        3: passage(skeleton, 16.0, 20.0, 1.0, 1.0),
    }
    assert pairs(passages) == [(1, 2), (0, 3)]


def test_one_identity_over_several_absences(skeleton: Skeleton) -> None:
    passages = {n: passage(skeleton, 10.0 * n, 10.0 * n + 5.0, 1.1) for n in range(3)}
    assert pairs(passages) == [(0, 1), (1, 2)]


def test_twins_are_not_guessed(skeleton: Skeleton) -> None:
    """Two of equal size leave at one place, and one of them comes back."""
    passages = {n: passage(skeleton, 0.0, 10.0, 1.0) for n in range(2)} | {2: passage(skeleton, 15.0, 20.0, 1.0)}
    assert pairs(passages) == []


def test_twins_are_told_apart_by_the_place(skeleton: Skeleton) -> None:
    passages = {n: passage(skeleton, 0.0, 10.0, 1.0, 3.0 * n) for n in range(2)}
    passages |= {2 + n: passage(skeleton, 10.5, 20.0, 1.0, 3.0 * n) for n in range(2)}
    assert pairs(passages) == [(0, 2), (1, 3)]


def test_nobody_is_somebody_who_is_there(skeleton: Skeleton) -> None:
    passages = {0: passage(skeleton, 0.0, 20.0, 1.0), 1: passage(skeleton, 10.0, 30.0, 1.0)}
    assert pairs(passages) == []


def test_somebody_of_another_size_is_somebody_else(skeleton: Skeleton) -> None:
    passages = {0: passage(skeleton, 0.0, 10.0, 1.0), 1: passage(skeleton, 12.0, 20.0, 1.2)}
    assert pairs(passages) == []


def test_nobody_and_somebody_alone(skeleton: Skeleton) -> None:
    assert pairs({}) == []
    assert pairs({7: passage(skeleton, 0.0, 1.0, 1.0)}) == []


@pytest.mark.parametrize("seed", range(20))
def test_the_links_are_the_best_of_all(skeleton: Skeleton, seed: int) -> None:
    """Against all ways of giving four who come to four who were lost, or to nobody, tried one by one."""
    rng = np.random.default_rng(seed)
    before = {n: passage(skeleton, 0.0, 10.0, rng.uniform(0.9, 1.1), rng.uniform(-3, 3)) for n in range(4)}
    after = {4 + n: passage(skeleton, 14.0, 20.0, rng.uniform(0.9, 1.1), rng.uniform(-3, 3)) for n in range(4)}
    worth = np.array([[a.log_ratio(b, ROOM_M2) for b in after.values()] for a in before.values()])
    worth = np.maximum(worth - (RECOGNISED - UNAMBIGUOUS), 0.0)

    def best(worth: np.ndarray) -> tuple[float, tuple[int, ...]]:
        return max((worth[range(4), order].sum(), order) for order in permutations(range(4)))

    total, order = best(worth)
    expected = set()
    for n, m in enumerate(order):
        without = worth.copy()
        without[n, m] = 0.0
        if worth[n, m] > 0 and total - best(without)[0] >= UNAMBIGUOUS:
            expected.add((n, 4 + m))
    assert set(pairs(before | after)) == expected
