"""Detections that wait for the tracker."""

from __future__ import annotations

import numpy as np

from fgpose.io.live.recordings import RecordedImage
from fgpose.live.processes.pending_detections import PendingDetections
from fgpose.people_observations import Detections


def image(number: int, camera: str = "left") -> RecordedImage:
    return RecordedImage(Detections(camera, float(number), np.zeros((0, 17, 2)), np.zeros((0, 17))), float(number))


def taken(arrivals: PendingDetections) -> list[float]:
    return [image.detections.time_s for image in arrivals.take(0.0)]


def test_after_a_delay_all_are_used() -> None:
    """A tracker that once takes as long as four images take to come."""
    arrivals = PendingDetections(["left"])
    for number in range(4):
        arrivals.put(image(number))
    assert taken(arrivals) == [0, 1, 2, 3]
    arrivals.put(image(4))
    assert taken(arrivals) == [4]
    assert arrivals.n_left_out("left") == 0


def test_a_tracker_that_hangs_costs_the_oldest() -> None:
    arrivals = PendingDetections(["left", "right"])
    for number in range(100):
        arrivals.put(image(number))
    arrivals.put(image(98, "right"))
    assert taken(arrivals) == [96, 97, 98, 98, 99]
    assert arrivals.n_left_out("left") == 96
    assert arrivals.n_left_out("right") == 0


def test_a_tracker_that_is_always_too_slow_leaves_out_evenly() -> None:
    """Three images come for each that it takes: it gets the two newest, and never those that wait for longer."""
    arrivals, used = PendingDetections(["left"]), []
    for turn in range(50):
        for number in range(3):
            arrivals.put(image(3 * turn + number))
        times_s = taken(arrivals)
        used += times_s
        if turn:
            assert times_s == [3 * turn + 1, 3 * turn + 2]
    assert np.diff(used).max() == 2
    assert len(used) + arrivals.n_left_out("left") == 150
