"""Occluders pasted into images: the rule of the benchmark."""

from __future__ import annotations

import numpy as np
import pytest
from occluders import Occluder, draw_periods, load_cutouts

from fgpose.synthetic import Occlusion

BOX_PX = np.array([40.0, 20.0, 30.0, 60.0])


def solid(width: int, height: int, alpha: int = 255) -> np.ndarray:
    cutout = np.full((height, width, 4), alpha, np.uint8)
    cutout[..., :3] = [200, 100, 50]
    return cutout


def changed(image: np.ndarray) -> np.ndarray:
    """Rows and columns of the pixels that are not grey."""
    return np.argwhere((image != 90).any(axis=-1))


def test_short_side_is_a_share_of_that_of_the_box_and_the_centre_lies_where_it_says():
    image = np.full((100, 120, 3), 90, np.uint8)
    pasted = Occluder(solid(20, 40), 0.5, np.array([0.5, 0.25])).pasted(image, BOX_PX)
    (top, left), (bottom, right) = changed(pasted).min(axis=0), changed(pasted).max(axis=0)
    assert (right - left + 1, bottom - top + 1) == (15, 30)
    # half a pixel of rounding
    assert abs((left + right + 1) / 2 - 55) <= 0.5
    assert abs((top + bottom + 1) / 2 - 35) <= 0.5
    assert pasted[35, 55].tolist() == [200, 100, 50]
    assert (image == 90).all()


def test_what_reaches_beyond_the_image_is_clipped():
    image = np.full((100, 120, 3), 90, np.uint8)
    pasted = Occluder(solid(30, 30), 1.0, np.array([0.0, 0.0])).pasted(image, np.array([0.0, 0.0, 40.0, 40.0]))
    assert changed(pasted).max(axis=0).tolist() == [19, 19]
    beyond = Occluder(solid(30, 30), 1.0, np.array([0.0, 0.0])).pasted(image, np.array([300.0, 300.0, 40.0, 40.0]))
    np.testing.assert_array_equal(beyond, image)


def test_half_transparent_is_half_of_both():
    image = np.full((100, 120, 3), 90, np.uint8)
    pasted = Occluder(solid(30, 30, alpha=128), 1.0, np.array([0.5, 0.5])).pasted(image, BOX_PX)
    # 128 / 255 of the one and the rest of the other, rounded
    np.testing.assert_allclose(pasted[50, 55], [145, 95, 70], atol=1)


@pytest.mark.parametrize("n_views", [1, 3, 4])
def test_so_many_views_are_occluded_at_any_time(n_views: int):
    rule = Occlusion(n_views=n_views, min_duration_s=0.2, max_duration_s=0.4)
    periods = draw_periods(np.random.default_rng(0), 10.0, 4, [solid(4, 4)], rule)
    assert 25 <= len(periods) <= 51
    for period in periods:
        assert sum(len(occluders) > 0 for occluders in period.occluders) == n_views
        assert {len(occluders) for occluders in period.occluders} <= {0, rule.n_occluders}
        scales = [occluder.scale for occluders in period.occluders for occluder in occluders]
        assert all(0.5 <= scale <= 1.0 for scale in scales)
    again = draw_periods(np.random.default_rng(0), 10.0, 4, [solid(4, 4)], rule)
    assert [period.end_s for period in again] == [period.end_s for period in periods]


def test_the_cutouts_are_there_and_have_transparent_rims():
    cutouts = load_cutouts()
    assert len(cutouts) == 18
    assert all(cutout.shape[2] == 4 and cutout[..., 3].min() == 0 and cutout[..., 3].max() > 200 for cutout in cutouts)
