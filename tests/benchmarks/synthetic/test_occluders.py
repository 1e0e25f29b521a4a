"""Occluders over the person in videos: the rule of the benchmark."""

from __future__ import annotations

import numpy as np
import pytest

from fgpose_benchmarks.synthetic import Occlusion
from occluders import draw_periods, load_cutouts

CUTOUT = np.full((4, 4, 4), 255, np.uint8)


@pytest.mark.parametrize("n_views", [1, 3, 4])
def test_so_many_views_are_occluded_at_any_time(n_views: int):
    rule = Occlusion(n_views=n_views, min_duration_s=0.2, max_duration_s=0.4)
    periods = draw_periods(np.random.default_rng(0), 10.0, 4, [CUTOUT], rule)
    assert 25 <= len(periods) <= 51
    for period in periods:
        assert sum(len(occluders) > 0 for occluders in period.occluders) == n_views
        assert {len(occluders) for occluders in period.occluders} <= {0, rule.n_occluders}
        scales = [occluder.scale for occluders in period.occluders for occluder in occluders]
        assert all(0.5 <= scale <= 1.0 for scale in scales)
    again = draw_periods(np.random.default_rng(0), 10.0, 4, [CUTOUT], rule)
    assert [period.end_s for period in again] == [period.end_s for period in periods]


def test_the_cutouts_are_there_and_have_transparent_rims():
    cutouts = load_cutouts()
    assert len(cutouts) == 18
    assert all(cutout.shape[2] == 4 and cutout[..., 3].min() == 0 and cutout[..., 3].max() > 200 for cutout in cutouts)
