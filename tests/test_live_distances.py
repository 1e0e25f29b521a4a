"""Minutes and an hour of the simulated live system with faults and a robot: distances against the truth."""

from __future__ import annotations

import pytest

import live_distances
import live_storm
from distance_truth import Result


@pytest.mark.slow
def test_no_distance_is_too_large_without_a_fault() -> None:
    result = live_distances.simulate(minutes=3, seed=4)
    assert result.n_faults >= 3
    assert result.n_said > 500  # somebody was there
    assert result.n_nobody == 0
    assert result.too_large < 0.01  # the quantile allows so many
    assert result.availability > 0.995


def test_no_distance_is_too_large_in_a_minute_of_faults() -> None:
    """Of messages, clocks, cameras, tracker, processes and robot; the estimation alone is a stand-in."""
    result = live_storm.simulate(n_sessions=1, seed=46, session_s=60.0)
    check(result)
    assert result.n_faults >= 5
    assert result.n_said > 100


@pytest.mark.slow
def test_no_distance_is_too_large_in_an_hour_of_faults_of_every_kind() -> None:
    result = live_storm.simulate(n_sessions=6, seed=1)
    check(result)
    assert result.n_faults > 150
    assert result.n_said > 5000
    assert result.n_calm > 1000


def check(result: Result) -> None:
    assert result.n_nobody == 0
    assert result.is_good  # no more are too large than the quantile allows
    assert result.availability > 0.995 or not result.n_calm
