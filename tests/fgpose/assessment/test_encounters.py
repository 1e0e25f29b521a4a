"""Two people come near one another; whether their identities survive is counted by how near."""

from __future__ import annotations

import numpy as np
import pytest
from made_up_people import FPS, make, people, standing

from fgpose.assessment.encounters import Encounter
from fgpose.assessment.people import evaluate_people

N, MIDDLE = 201, 100
STEP_M = 0.02  # 1 m/s: 2 m/s of each other


def passing(aside_m: float) -> tuple[np.ndarray, np.ndarray]:
    """They come towards each other along x, and are aside_m apart in the middle frame."""
    along_m = STEP_M * (np.arange(N) - MIDDLE)[:, None]
    a_m, b_m = standing(0.0, N), standing(0.0, N)
    a_m[..., 0] += along_m
    b_m[..., 0] -= along_m
    b_m[..., 1] += aside_m
    return a_m, b_m


def exchanged(a_m: np.ndarray, b_m: np.ndarray, frame: int) -> list[np.ndarray]:
    return [np.concatenate([one_m[:frame], other_m[frame:]]) for one_m, other_m in ((a_m, b_m), (b_m, a_m))]


@pytest.mark.parametrize("aside_m", [0.7, 0.2])
def test_a_crossing_with_a_switch(aside_m: float) -> None:
    a_m, b_m = passing(aside_m)
    # 20 frames later the two are 0.8 m farther apart along x, which no match bridges.
    (encounter,) = evaluate_people(people(*exchanged(a_m, b_m, MIDDLE + 20)), people(a_m, b_m)).encounters
    assert (encounter.people, encounter.n_switches) == ((1, 2), 2)
    assert encounter.distance_m == pytest.approx(aside_m)
    n_near = int((1.0 - 1e-9 - aside_m**2) ** 0.5 / (2 * STEP_M))
    assert (encounter.begin_s, encounter.end_s) == pytest.approx(((MIDDLE - n_near) / FPS, (MIDDLE + n_near) / FPS))


def test_a_crossing_without_a_switch() -> None:
    truth = people(*passing(0.7))
    assert [each.n_switches for each in evaluate_people(truth, truth).encounters] == [0]


def test_people_who_stay_apart_do_not_meet() -> None:
    truth = people(*passing(1.1))
    assert evaluate_people(truth, truth).encounters == ()


@pytest.mark.parametrize(("after_s", "n_switches"), [(0.3, 2), (0.7, 0)])
def test_a_switch_long_after_the_crossing_is_none_of_it(after_s: float, n_switches: int) -> None:
    a_m, b_m = passing(0.6)
    # They are within 1 m of each other until frame 120.
    scores = evaluate_people(people(*exchanged(a_m, b_m, MIDDLE + 20 + round(after_s * FPS))), people(a_m, b_m))
    assert scores.switches == 2
    assert [each.n_switches for each in scores.encounters] == [n_switches]


def test_a_switch_among_three_is_that_of_the_nearest_two() -> None:
    a_m, b_m = passing(0.4)
    c_m = standing(0.0, N)
    c_m[..., 1] = -0.8
    estimate = people(*exchanged(a_m, b_m, MIDDLE + 15), c_m)
    found = evaluate_people(estimate, people(a_m, b_m, c_m)).encounters
    assert {each.people: each.n_switches for each in found} == {(1, 2): 2, (1, 3): 0}


def test_people_who_meet_twice_have_two_encounters() -> None:
    a_m, b_m = passing(0.6)
    twice = [np.concatenate([each, each[::-1]]) for each in (a_m, b_m)]
    found = evaluate_people(people(*twice), people(*twice)).encounters
    assert [each.people for each in found] == [(1, 2), (1, 2)]
    assert found[0].end_s < found[1].begin_s


def test_the_name_of_a_return_is_no_switch_of_an_encounter() -> None:
    """Somebody comes back beside another, is called anew, and recognised after a second."""
    a_m, b_m = standing(0.0, 400), standing(0.7, 400)
    b_m[100:250] = np.nan
    own_m, new_m = b_m.copy(), b_m.copy()
    own_m[100:300], new_m[:250], new_m[300:] = np.nan, np.nan, np.nan
    scores = evaluate_people(people(a_m, own_m, new_m), people(a_m, b_m))
    assert scores.switches == 2
    assert [(each.distance_m, each.n_switches) for each in scores.encounters] == [(pytest.approx(0.7), 0)] * 2
    # Not recognised, but called by a third name: a switch.
    third_m = own_m.copy()
    own_m[300:], third_m[:300] = np.nan, np.nan
    scores = evaluate_people(people(a_m, own_m, new_m, third_m), people(a_m, b_m))
    assert [each.n_switches for each in scores.encounters] == [0, 1]


def test_the_distance_is_of_the_joints_that_both_have() -> None:
    a_m, b_m = standing(0.0, 10), standing(0.6, 10)
    a_m[:, 3], b_m[:, 0] = np.nan, np.nan
    (encounter,) = evaluate_people({1: make(a_m)}, {4: make(b_m), 2: make(a_m)}).encounters
    assert encounter == Encounter((2, 4), 0.0, 9 / FPS, encounter.distance_m, 0)
    assert encounter.distance_m == pytest.approx(0.6)
