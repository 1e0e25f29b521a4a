"""What images tell of who is there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgpose.association.detectability import repeats
from fgpose.people_observations import Detections


def test_an_image_that_comes_again() -> None:
    """To the last digit; but on a grid of quarter pixels somebody who stands still is found at the same place."""
    points_px = np.random.default_rng(0).uniform(0, 1000, (2, 17, 2))
    points_px[1, 3] = np.nan
    image = Detections("a", 0.0, points_px, np.ones((2, 17)))  # the order of the people is that of the detector
    assert repeats(image.at(1.0), image)
    assert repeats(replace(image, points2d_px=points_px[::-1], confidence=image.confidence[::-1]), image)
    moved_px = points_px.copy()
    moved_px[1, 5] += 1e-6
    assert not repeats(replace(image, points2d_px=moved_px), image)
    assert not repeats(replace(image, points2d_px=points_px[:1], confidence=np.ones((1, 17))), image)
    in_grid = replace(image, points2d_px=np.round(4 * points_px) / 4)
    assert not repeats(in_grid.at(1.0), in_grid)
    nobody = Detections("a", 0.0, np.zeros((0, 17, 2)), np.zeros((0, 17)))
    assert not repeats(nobody.at(1.0), nobody)
