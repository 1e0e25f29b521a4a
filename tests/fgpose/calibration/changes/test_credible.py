"""What is believed of clocks and moves: what many seconds and joints say, by more than they differ by chance."""

from __future__ import annotations

import numpy as np
import pytest

from fgpose.calibration.changes.change import Kind
from fgpose.calibration.changes.clock_changes import ClockFit
from fgpose.calibration.changes.credible import holds, is_clear
from fgpose.calibration.changes.poses.pose_changes import PoseFit

EVENLY = np.full(10, 8.0)
OF_ONE = np.array([0.0, -1.0, 0.5, 4.0, -2.0, 60.0, 8.0, 7.0, -5.0, 8.5])  # as much in all


def fit(kind: Kind, gain: np.ndarray, by_chance: float) -> ClockFit:
    lag = np.linspace(0, 4, len(gain))
    return ClockFit(kind, lag, lag, (), gain, by_chance, (), 0.3)


@pytest.mark.parametrize("kind", [Kind.OFFSET, Kind.RATE])
def test_a_fit_is_clear_that_most_seconds_are_better_with(kind: Kind) -> None:
    assert is_clear(fit(kind, EVENLY, by_chance=3.0))


def test_a_rate_that_one_second_shows_is_an_error_of_the_detector() -> None:
    assert is_clear(fit(Kind.OFFSET, OF_ONE, by_chance=3.0))
    assert not is_clear(fit(Kind.RATE, OF_ONE, by_chance=3.0))


def test_seconds_that_each_suit_another_lag_say_nothing() -> None:
    assert not is_clear(fit(Kind.OFFSET, EVENLY, by_chance=40.0))


@pytest.mark.parametrize(("of_most_joints", "is_held"), [(0.6, True), (0.1, False)])
def test_a_limb_that_a_view_shows_elsewhere_is_no_move(of_most_joints: float, is_held: bool) -> None:
    held, turn = np.ones(10, dtype=bool), np.array([0.0, 0.0, 0.02])
    assert holds(PoseFit(Kind.BUMP, turn, turn, held, EVENLY, (0, 1), 0.01, 0.02, 1.0, 0.05, of_most_joints)) is is_held
