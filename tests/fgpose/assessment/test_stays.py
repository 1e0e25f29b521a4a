"""Who comes is found, recognised or taken for somebody else; and tracks of nobody."""

from __future__ import annotations

import numpy as np
import pytest
from made_up_people import FPS, only, people, standing

from fgpose.assessment.people import evaluate_people
from fgpose.assessment.stays import Stay, confirmation_delays_s

N = 500  # 10 s
GONE = slice(100, 300)  # 4 s
BEFORE, AFTER = slice(100), slice(300, None)


def there(frames: slice | list[int], x_m: float = 0.0) -> np.ndarray:
    return only(standing(x_m, N), frames)


def visitor(x_m: float = 0.0) -> np.ndarray:
    """There for 2 s, away for 4, then back for good."""
    positions_m = standing(x_m, N)
    positions_m[GONE] = np.nan
    return positions_m


def test_a_return_recognised() -> None:
    scores = evaluate_people(people(visitor()), people(visitor()))
    first, back = scores.stays
    assert (first.begin_s, first.end_s, first.away_s, first.first_match_s) == (0.0, 99 / FPS, np.inf, 0.0)
    assert (back.begin_s, back.first_match_s, back.is_recognised, back.is_mistaken) == (6.0, 6.0, True, False)
    assert back.away_s == pytest.approx(201 / FPS)
    assert scores.returns == scores.arrivals == (back,)


@pytest.mark.parametrize(("last_s", "n_returns"), [(0.9, 0), (1.1, 1)])
def test_who_is_back_for_less_than_a_second_need_not_be_recognised(last_s: float, n_returns: int) -> None:
    brief_m = visitor()
    brief_m[300 + int(last_s * FPS) :] = np.nan
    assert len(evaluate_people(people(there(BEFORE)), people(brief_m)).returns) == n_returns


def test_a_return_as_somebody_new() -> None:
    scores = evaluate_people(people(there(BEFORE), there(AFTER)), people(visitor()))
    assert [(stay.is_recognised, stay.is_mistaken) for stay in scores.returns] == [(False, False)]


def test_a_return_as_somebody_else_who_is_there() -> None:
    """The first has the number of the second, who is called anew."""
    taken_m = there(BEFORE, 3.0)
    taken_m[GONE], taken_m[AFTER] = standing(3.0, 200), standing(0.0, 200)
    estimate = people(there(BEFORE), taken_m, there(AFTER, 3.0))
    scores = evaluate_people(estimate, people(visitor(), standing(3.0, N)))
    assert [(stay.person, stay.is_recognised, stay.is_mistaken) for stay in scores.returns] == [(1, False, True)]


def test_somebody_new_taken_for_somebody_who_has_left() -> None:
    left_m, came_m = there(slice(200)), there(AFTER, 2.0)
    scores = evaluate_people(people(np.where(np.isnan(left_m), came_m, left_m)), people(left_m, came_m))
    assert scores.returns == ()
    (new,) = scores.arrivals
    assert (new.person, new.away_s, new.is_recognised, new.is_mistaken) == (2, np.inf, False, True)


@pytest.mark.parametrize(("renamed_s", "recognised"), [(2.0, True), (3.5, False)])
def test_a_name_may_take_three_seconds(renamed_s: float, recognised: bool) -> None:
    """Called anew at first, then as before."""
    change = 300 + round(renamed_s * FPS)
    own_m, new_m = there(BEFORE), there(slice(300, change))
    own_m[change:] = standing(0.0, N - change)
    (back,) = evaluate_people(people(own_m, new_m), people(visitor())).returns
    assert (back.is_recognised, back.is_mistaken) == (recognised, False)


def test_a_gap_in_the_truth_is_no_absence() -> None:
    blinking_m = standing(0.0, N)
    blinking_m[100:148] = np.nan
    assert evaluate_people(people(blinking_m), people(blinking_m)).returns == ()


def test_an_identity_is_that_of_whom_it_followed_most() -> None:
    """For the last second before one leaves the two names are exchanged: they stay those of the nine seconds before."""
    a_m, b_m = standing(0.0, 1000), standing(3.0, 1000)
    b_m[500:800] = np.nan
    first_m, second_m = standing(0.0, 1000), standing(3.0, 1000)
    first_m[450:500], second_m[450:500] = standing(3.0, 50), standing(0.0, 50)
    second_m[500:800] = np.nan
    (back,) = evaluate_people(people(first_m, second_m), people(a_m, b_m)).returns
    assert (back.person, back.is_recognised, back.is_mistaken) == (2, True, False)


def test_who_is_never_found_after_returning() -> None:
    (back,) = evaluate_people(people(there(BEFORE)), people(visitor())).returns
    assert (back.first_match_s, back.is_recognised, back.is_mistaken) == (np.inf, False, False)


def test_confirmation_after_a_fifth_of_a_second() -> None:
    """Seen by two cameras from 0.1 s and from 6.02 s on, found from 0.3 s and 6 s on."""
    found_m = visitor()
    found_m[:15] = np.nan
    scores = evaluate_people(people(found_m), people(visitor()))
    time_s = np.arange(N) / FPS
    seen = {1: (time_s >= 0.1) & (time_s < 2.0) | (time_s >= 6.02)}
    assert confirmation_delays_s(scores.stays, seen, time_s) == pytest.approx((0.2, 0.0))
    assert confirmation_delays_s(scores.stays, {1: time_s >= 6.0}, time_s) == (0.0,)
    missed = evaluate_people(people(there(AFTER)), people(visitor()))
    assert confirmation_delays_s(missed.stays, {1: time_s >= 0}, time_s) == (np.inf, 0.0)


def test_a_false_track_of_0_4_seconds() -> None:
    truth, true_m = people(standing(0.0, N)), standing(0.0, N)
    made_up_m, double_m = there(slice(50, 70), 5.0), there(slice(200, 300), 0.1)
    scores = evaluate_people(people(true_m, made_up_m, double_m), truth)
    assert scores.false_tracks_s == pytest.approx((0.4, 2.0))
    # Half of the time with somebody: theirs.
    half_m = there(slice(100), 5.0)
    half_m[100:200] = standing(0.0, 100)
    assert evaluate_people(people(half_m), truth).false_tracks_s == ()
    half_m[100] = np.nan
    assert evaluate_people(people(half_m), truth).false_tracks_s == pytest.approx((199 / FPS,))


def test_nobody_there_and_nobody_found() -> None:
    empty = evaluate_people({}, people(there([])))
    assert (empty.stays, empty.encounters, empty.false_tracks_s, empty.arrivals) == ((), (), (), ())
    missed = evaluate_people({}, people(standing(0.0, 10)))
    assert missed.stays == (Stay(1, 0.0, 9 / FPS, np.inf, np.inf, False, False),)
