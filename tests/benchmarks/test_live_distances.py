"""Minutes and an hour of the simulated live system with faults and a robot: distances against the truth."""

from __future__ import annotations

import json
import logging
from pathlib import Path

import pytest

import live_distances
import live_storm
from distance_truth import DistanceResult
from storm_plan import FROM_THE_START


@pytest.fixture(autouse=True)
def _without_log(caplog: pytest.LogCaptureFixture) -> None:
    """What fails hundreds of times is not written hundreds of times."""
    caplog.set_level(logging.CRITICAL, "fgpose.live")


@pytest.mark.slow
def test_no_distance_is_too_large_without_a_fault() -> None:
    result = live_distances.simulate(minutes=3, seed=4)
    assert result.n_faults >= 3
    assert result.n_said > 500  # somebody was there
    assert result.n_nobody == 0
    assert result.too_large < 0.01  # the quantile allows so many
    assert result.availability > 0.995


@pytest.mark.parametrize(
    ("session", "duration_s"), [(0, 300.0), *(pytest.param(n, 600.0, marks=pytest.mark.slow) for n in range(6))]
)
def test_no_distance_is_too_large_in_an_hour_of_faults_of_every_kind(
    session: int, duration_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of messages, clocks, cameras, tracker, processes and robot. The estimation alone is a stand-in."""
    monkeypatch.setattr(live_storm, "SESSION_S", duration_s)
    result = live_storm.simulate(session, seed=2)
    assert result.n_faults > duration_s / 40
    assert result.n_said > 500
    assert result.n_nobody == 0
    assert result.too_large < 0.01  # the quantile allows so many
    assert result.longest_silence_s <= 0.3
    # With a fault from the start on, something is always wrong.
    assert result.n_calm > 100 or result.faults.keys() & set(FROM_THE_START)
    assert result.availability >= 0.995 or not result.n_calm


@pytest.mark.slow
def test_a_storm_is_continued(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is simulated now and what was before are the same as all at once; other seeds are added."""
    monkeypatch.setattr(live_storm, "SESSION_S", 30.0)
    for hours in (0.01, 0.02):
        live_storm.main(hours, seed=2, output=tmp_path / "in parts")
    live_storm.main(0.02, seed=2, output=tmp_path / "at once")
    parts, whole = ((tmp_path / name / "seed_2.json").read_text() for name in ("in parts", "at once"))
    assert parts == whole
    one, other = (DistanceResult(**json.loads(whole)) for _ in range(2))
    one.add(other)
    assert (one.n_sessions, one.n_said) == (6, 2 * other.n_said)
    assert one.faults == {kind: 2 * n for kind, n in other.faults.items()}
    assert (one.largest_m, one.worst) == (other.largest_m, other.worst)
