"""What is said of results that are not of the time of the images."""

from __future__ import annotations

import numpy as np
import pytest

from fgpose.io.skeletons import load_skeleton
from fgpose.monocular.common_times import CommonTimes
from fgpose.sampling import TimeRange
from fgpose.trajectory import Status, Trajectory

HZ = 25.0
SKELETON = load_skeleton("coco_17")


def seen(first: float, n_frames: int, hz: float = HZ) -> Trajectory:
    """Somebody from a frame on."""
    status = np.full((n_frames, 17), Status.OBSERVED)
    return Trajectory(SKELETON, (first + np.arange(n_frames)) / hz, np.ones((n_frames, 17, 3)), status)


def filmed(n_images: int, begin_s: float = 0.0) -> np.ndarray:
    return begin_s + np.arange(n_images) / HZ


def times(result: list[Trajectory], *cameras: np.ndarray) -> CommonTimes:
    return CommonTimes.of(dict(enumerate(result)), cameras, HZ)


@pytest.mark.parametrize(
    ("first", "n_later"),
    [(1000, "about 1000 higher"), (-500, "about 500 lower"), (1e11, "count from different moments")],
)
def test_a_result_of_no_time_of_the_images_is_told(first: float, n_later: str) -> None:
    found = times([seen(first, 60)], filmed(100), filmed(90))
    assert n_later in found.nothing()
    assert "the images are from 0 s to 3.96 s" in found.nothing()


@pytest.mark.parametrize(("first", "words"), [(1, "1 image after"), (30, "30 images after"), (-1, "1 image before")])
def test_a_result_that_is_as_long_as_the_images_and_later_is_told(first: int, words: str) -> None:
    found = times([seen(first, 100)], filmed(100), filmed(100, begin_s=0.004))
    assert found.nothing() == ""
    assert f"begins and ends {words} those of a camera" in found.doubt()
    assert f"{abs(first)} {'higher' if first > 0 else 'lower'}" in found.doubt()


@pytest.mark.parametrize(
    ("result", "cameras"),
    [
        ([seen(0, 100)], [filmed(100), filmed(100)]),
        # Cropped: at both ends, and to a single frame.
        ([seen(40, 20)], [filmed(100)]),
        ([seen(99, 1)], [filmed(100)]),
        # People who come and go.
        ([seen(10, 30), seen(60, 39)], [filmed(100)]),
        # A camera that began later, or both, as the calibration says.
        ([seen(0, 110)], [filmed(100), filmed(100, begin_s=0.4)]),
        ([seen(0, 110)], [filmed(100, begin_s=0.4)]),
        ([seen(0, 100)], [filmed(100, begin_s=0.0167), filmed(100, begin_s=-0.0167)]),
        # Half of the rate, and the last moments not filmed.
        ([seen(0, 50, HZ / 2)], [filmed(100)]),
        ([seen(0, 108)], [filmed(100)]),
    ],
)
def test_nothing_is_said_of_a_result_of_these_images(result: list[Trajectory], cameras: list[np.ndarray]) -> None:
    found = times(result, *cameras)
    assert (found.nothing(), found.doubt()) == ("", "")


def test_much_after_the_last_image_is_told_unless_it_is_not_wanted() -> None:
    found = times([seen(50, 150)], filmed(100))
    # Of 150 frames 100 to 199 are later than image 99, less one step at the end.
    assert "67 % of the result is after the last image, at 3.96 s" in found.doubt()
    assert found.doubt(TimeRange(2.0, 3.96)) == ""
    assert found.doubt(TimeRange(7.0, 7.5)) != ""
