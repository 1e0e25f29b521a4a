"""Who is seen by cameras of different rates: the newest image of each counts, not the newest frame alone."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from fgpose.association.track import Tracked, TrackState
from fgpose.live.frame import LivePerson
from fgpose.live.tracking.newest_views import NewestViews
from fgpose.people_observations import Detections
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Estimate, Status

CAMERAS = ("fast", "slow", "slower")


def image(camera: str, time_s: float) -> Detections:
    return Detections(camera, time_s, np.zeros((0, 17, 2)), np.zeros((0, 17)))


def tracked(
    skeleton: Skeleton, time_s: float, sees: Mapping[str, float], person: int = 1, late: tuple[str, ...] = ()
) -> Tracked:
    """As the tracker says it of the newest frame: the visibility of all joints by camera; late images show them too,
    and are of another frame."""
    visibility = np.full((3, 17), np.nan)
    for camera, probability in sees.items():
        visibility[CAMERAS.index(camera)] = probability
    status = np.full(17, Status.OBSERVED if len(sees) > 1 else Status.PREDICTED, dtype=np.int8)
    covariance_m2 = np.tile(1e-4 * np.eye(3), (17, 1, 1))
    estimate = Estimate(skeleton, 0, time_s, np.zeros((17, 3)), status, covariance_m2, visibility=visibility)
    seen = dict.fromkeys((*sees, *late), (np.zeros(17, dtype=int), np.arange(17)))
    return Tracked(person, TrackState.CONFIRMED, estimate, seen)


class Live:
    """Cameras with images at 60, 30 and 12 Hz, all of which see somebody until they do not."""

    def __init__(self, skeleton: Skeleton) -> None:
        self._views, self._skeleton, self.person = NewestViews(CAMERAS), skeleton, 1

    def run(self, until_s: float, sees: tuple[str, ...] = CAMERAS, begin_s: float = 0.0) -> LivePerson:
        """The person at the end."""
        people: list[LivePerson] = []
        for tick in range(round(begin_s * 60), round(until_s * 60) + 1):
            time_s = tick / 60
            steps = dict(zip(CAMERAS, (1, 2, 5), strict=True))
            images = [image(camera, time_s) for camera in CAMERAS if tick % steps[camera] == 0]
            given = {each.camera: 0.9 for each in images if each.camera in sees}
            one = tracked(self._skeleton, time_s, given, self.person)
            people = [LivePerson.of(one, *self._views.add(images, [one]))]
        return people[0]


def test_the_newest_image_of_each_camera_counts(skeleton: Skeleton) -> None:
    """At 0.55 s only the fastest camera has one."""
    person = Live(skeleton).run(33 / 60)
    assert set(person.status) == {Status.OBSERVED}
    # Of three cameras: at 60 Hz now, at 30 Hz a sixtieth ago, the slowest three sixtieths ago.
    np.testing.assert_allclose(person.probability, 1 - 0.1**3)


def test_an_image_that_does_not_show_somebody_counts_at_once(skeleton: Skeleton) -> None:
    live = Live(skeleton)
    live.run(0.5)
    person = live.run(35 / 60, ("fast",), begin_s=31 / 60)
    np.testing.assert_allclose(person.probability, 0.9)
    assert set(person.status) == {Status.PREDICTED}


def test_what_was_seen_long_ago_does_not_count(skeleton: Skeleton) -> None:
    """The others have stopped: after two of their steps, or 0.1 s, they tell nothing of the moment."""
    views = NewestViews(CAMERAS)
    found: list[LivePerson] = []
    for tick in range(60):
        time_s = tick / 60
        names = CAMERAS if tick < 30 else ("fast",)
        one = tracked(skeleton, time_s, dict.fromkeys(names, 0.9))
        found.append(LivePerson.of(one, *views.add([image(name, time_s) for name in names], [one])))
    # The usual step of all is a sixtieth, so two of them later it is over; rounding decides on the second.
    assert found[30].probability[0] == pytest.approx(1 - 0.1**3)
    assert found[33].probability[0] == pytest.approx(0.9)
    assert found[33].status[0] == Status.PREDICTED


def test_a_late_image_takes_nothing_away(skeleton: Skeleton) -> None:
    """It shows them, and joined a frame before: of the newest frame it tells nothing."""
    views = NewestViews(CAMERAS)
    for tick in range(3):
        one = tracked(skeleton, tick / 60, dict.fromkeys(CAMERAS, 0.9))
        views.add([image(name, tick / 60) for name in CAMERAS], [one])
    one = tracked(skeleton, 3 / 60, {"fast": 0.9}, late=("slow",))
    (visibility,) = views.add([image("fast", 3 / 60), image("slow", 2.9 / 60)], [one])
    np.testing.assert_allclose(visibility[:2], 0.9)


def test_views_stay_with_somebody_who_gets_another_number(skeleton: Skeleton) -> None:
    views = NewestViews(CAMERAS)
    for tick in range(3):
        one = tracked(skeleton, tick / 60, dict.fromkeys(CAMERAS, 0.9))
        views.add([image(name, tick / 60) for name in CAMERAS], [one])
    fast = tracked(skeleton, 3 / 60, {"fast": 0.9}, person=0)
    renamed = Tracked(0, fast.state, fast.estimate, fast.seen, former=1)
    (visibility,) = views.add([image("fast", 3 / 60)], [renamed])
    np.testing.assert_allclose(visibility, 0.9)
