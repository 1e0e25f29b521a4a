"""Three minutes of the simulated live system with faults and a robot: distances against the truth."""

from __future__ import annotations

import pytest
from live_distances import simulate


@pytest.mark.slow
def test_no_distance_is_too_large_without_a_fault() -> None:
    result = simulate(minutes=3, seed=4)
    assert result.n_faults >= 3
    assert result.n_said > 500  # somebody was there
    assert result.n_nobody == 0
    assert result.too_large < 0.01  # the quantile allows so many
    assert result.availability > 0.995
