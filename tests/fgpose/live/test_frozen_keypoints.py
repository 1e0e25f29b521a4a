"""Keypoints that freeze are named within two seconds; nothing else is."""

from __future__ import annotations

import numpy as np

from fgpose.live.cameras.frozen_keypoints import FrozenKeypoints
from fgpose.people_observations import Detections

RATE_HZ = 15.0


def seen(time_s: float, points_px: np.ndarray) -> Detections:
    return Detections("a", time_s, points_px, np.where(np.isfinite(points_px[..., 0]), 0.9, 0.0))


def first_alarm_s(every_px: list[np.ndarray]) -> float:
    """When the images that come 15 times a second are called frozen; NaN: never."""
    check = FrozenKeypoints()
    for number, points_px in enumerate(every_px):
        if check.add(seen(number / RATE_HZ, points_px), number / RATE_HZ):
            return number / RATE_HZ
    return np.nan


def test_who_freezes_is_noticed_within_two_seconds() -> None:
    rng = np.random.default_rng(0)
    moving = [rng.uniform(0, 1000, (1, 17, 2)) for _ in range(30)]
    frozen_s = len(moving) / RATE_HZ
    assert frozen_s < first_alarm_s(moving + 60 * [moving[-1]]) < frozen_s + 2.0


def test_neither_somebody_who_stands_still_nor_nobody_is_frozen() -> None:
    rng = np.random.default_rng(1)
    place_px = rng.uniform(0, 1000, (1, 17, 2))
    assert np.isnan(first_alarm_s([place_px + rng.normal(0, 0.1, place_px.shape) for _ in range(90)]))
    assert np.isnan(first_alarm_s(90 * [np.zeros((0, 17, 2))]))
    assert np.isnan(first_alarm_s(90 * [np.full((2, 17, 2), np.nan)]))  # of a detector that always sends two
    # Every result twice, as of a network that looks at every second image.
    assert np.isnan(first_alarm_s([place_px + number // 2 for number in range(90)]))
