"""Images of several cameras enter the estimate together, and none waits for a camera that is silent."""

from __future__ import annotations

import numpy as np
import pytest

from fgpose.live.tracking.moments import Moments
from fgpose.people_observations import Detections

PERIOD_S = 0.04
CAMERAS = ("left", "right", "door")


def image(camera: str, time_s: float) -> Detections:
    return Detections(camera, time_s, np.zeros((0, 3, 2)), np.zeros((0, 3)))


def names(moment: list[Detections]) -> list[str]:
    return [detections.camera for detections in moment]


@pytest.fixture
def moments() -> Moments:
    """That has seen all cameras for a second."""
    known = Moments()
    for n in range(25):
        for camera in CAMERAS:
            assert known.add(image(camera, n * PERIOD_S), n * PERIOD_S) == []
        assert names(known.ready(n * PERIOD_S, CAMERAS)) == list(CAMERAS)
    return known


def test_all_that_are_expected_are_given_at_once(moments: Moments):
    assert moments.period_s == pytest.approx(PERIOD_S)
    moments.add(image("door", 1.002), 1.01)
    moments.add(image("left", 1.0), 1.01)
    assert moments.ready(1.01, CAMERAS) == []
    moments.add(image("right", 1.001), 1.012)
    assert names(moments.ready(1.012, CAMERAS)) == ["left", "right", "door"]
    assert moments.ready(1.012, CAMERAS) == []


def test_nobody_waits_for_who_is_not_expected(moments: Moments):
    moments.add(image("left", 1.0), 1.0)
    moments.add(image("door", 1.0), 1.0)
    assert names(moments.ready(1.0, ("left", "door"))) == ["left", "door"]


def test_nobody_waits_longer_than_two_periods(moments: Moments):
    moments.add(image("left", 1.0), 1.0)
    assert moments.deadline_s == pytest.approx(1.0 + 2 * PERIOD_S)
    assert moments.ready(moments.deadline_s - 1e-3, CAMERAS) == []
    assert names(moments.ready(moments.deadline_s, CAMERAS)) == ["left"]
    assert moments.deadline_s == np.inf


@pytest.mark.parametrize(("late_s", "waits"), [(0.9 * PERIOD_S, True), (1.1 * PERIOD_S, False)])
def test_nobody_waits_for_who_usually_comes_too_late(late_s: float, waits: bool):
    moments = Moments()
    events = [
        (n * PERIOD_S + (late_s if camera == "door" else 0.0), camera, n) for n in range(25) for camera in CAMERAS
    ]
    for now_s, camera, n in sorted(events):
        moments.add(image(camera, n * PERIOD_S), now_s)
        moments.ready(now_s, CAMERAS)
    moments.ready(2.0, ())
    moments.add(image("left", 2.0), 2.0)
    moments.add(image("right", 2.0), 2.0)
    assert names(moments.ready(2.0, CAMERAS)) == ([] if waits else ["left", "right"])


def test_the_next_image_of_a_camera_is_of_the_next_moment(moments: Moments):
    moments.add(image("left", 1.0), 1.0)
    (before,) = moments.add(image("left", 1.0 + PERIOD_S), 1.01)
    assert [detections.time_s for detections in before] == [1.0]


def test_what_was_taken_long_before_is_a_moment_of_its_own(moments: Moments):
    moments.add(image("left", 1.0), 1.0)
    (before,) = moments.add(image("right", 1.0 - 2 * PERIOD_S), 1.0)
    assert names(before) == ["left"]
    assert names(moments.ready(1.1, CAMERAS)) == ["right"]


def test_cameras_of_different_phases_are_one_moment_when_nobody_asks_meanwhile(moments: Moments):
    for n, camera in enumerate(CAMERAS):
        assert moments.add(image(camera, 1.0 + n * PERIOD_S / 3), 1.0 + n * PERIOD_S / 3) == []
    assert names(moments.ready(1.1, CAMERAS)) == list(CAMERAS)
