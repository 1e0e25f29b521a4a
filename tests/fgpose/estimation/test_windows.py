"""How a recording is cut into windows."""

from __future__ import annotations

import numpy as np
import pytest

from fgpose.estimation.windows import cut_windows


def test_windows_cover_the_recording_and_see_beyond_what_they_contribute() -> None:
    time_s = np.arange(900) / 30
    windows = cut_windows(time_s, 10.0, 2.0)
    contributed = [each.contributed for each in windows]
    assert contributed == [slice(0, 300), slice(300, 600), slice(600, 900)]
    assert [each.solved for each in windows] == [slice(0, 360), slice(240, 660), slice(540, 900)]


@pytest.mark.parametrize("unit", [1e3, 1e6, 1e9])
def test_times_in_other_units_cut_no_more_windows_than_there_are_frames(unit: float) -> None:
    """Nanoseconds taken for seconds: ten seconds are three centuries, with 500 million windows."""
    time_s = 1.7e9 * unit + np.arange(300) / 30 * unit
    contributed = [each.contributed for each in cut_windows(time_s, 20.0, 2.0)]
    assert len(contributed) <= 300
    assert [each.start for each in contributed[1:]] == [each.stop for each in contributed[:-1]]
    assert (contributed[0].start, contributed[-1].stop) == (0, 300)
