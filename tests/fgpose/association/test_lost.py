"""How large the room is in which somebody who was lost may come back."""

from __future__ import annotations

import numpy as np
import pytest

from fgpose.association.lost import Lost


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
