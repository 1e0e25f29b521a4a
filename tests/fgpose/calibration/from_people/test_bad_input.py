"""What no calibration can come of: each is an error before any work, or a verdict with the reason and what helps."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from fgpose.calibration.from_people.calibrate import calibrate_from_people
from fgpose.calibration.from_people.calibrated import CalibratedFromPeople, Grade
from fgpose.calibration.from_people.starts.starts import find_starts
from fgpose.calibration.from_people.starts.walker import main_tracks
from fgpose.calibration.from_people.tracks import find_tracks
from fgpose.geometry.camera import CameraRig
from fgpose.people_observations import Detections, PeopleObservations
from fgpose_benchmarks.synthetic import WalkScene, film, ring_rig, stature_m, walkers

NAMES = ("ring_0", "ring_1", "ring_2")
RIG = ring_rig(3, 4.5, 1.9)


@cache
def scene(duration_s: float = 6.0) -> WalkScene:
    """Of three cameras around a walker, with biased detections."""
    return film(walkers((4.0, 4.0), duration_s, 3), RIG, 3)


def changed(of: WalkScene, change: Callable[[Detections], Detections]) -> PeopleObservations:
    """With other images."""
    images = sorted(map(change, of.observations.images), key=lambda image: image.time_s)
    return replace(of.observations, images=tuple(images))


def nobody(image: Detections) -> Detections:
    return Detections(image.camera, image.time_s, image.points2d_px[:0], image.confidence[:0])


def nobody_in(*cameras: str) -> Callable[[Detections], Detections]:
    return lambda image: nobody(image) if image.camera in cameras else image


def in_turn(image: Detections) -> Detections:
    """Two cameras in the first half of the walk, the third in the second."""
    return image if (image.time_s < 3.0) == (image.camera != NAMES[2]) else nobody(image)


def at_rate(share: float) -> Callable[[Detections], Detections]:
    """Of one camera the file states a rate that is so many times too low."""
    return lambda image: replace(image, time_s=image.time_s * share) if image.camera == NAMES[1] else image


def of_resolution(share: float) -> CameraRig:
    """K of images so many times as large."""
    scale = np.diag([share, share, 1.0])
    return CameraRig(tuple(replace(camera, K=scale @ camera.K) for camera in scene().intrinsics.cameras))


def calibrated(people: PeopleObservations, intrinsics: CameraRig | None = None, **options: Any) -> CalibratedFromPeople:
    given: dict[str, Any] = {"synchronised": True, **options}
    return calibrate_from_people(people, intrinsics or scene().intrinsics.subset(people.camera_names), **given)


TOGETHER = "the videos of fewer than two cameras can be brought together in time"


@pytest.mark.parametrize(
    ("people", "options", "message"),
    [
        (lambda: scene().observations.subset(["ring_1"]), {}, r"one camera \(ring_1\) cannot be calibrated"),
        (lambda: changed(scene(), nobody), {}, "no camera sees anybody"),
        (lambda: changed(scene(), nobody_in("ring_0", "ring_2")), {}, "only ring_1 sees anybody"),
        (lambda: changed(scene(), in_turn), {}, "ring_0, ring_1 on one side and ring_2 on the other never see"),
        (lambda: changed(scene(), in_turn), {"synchronised": False}, TOGETHER),
        (
            lambda: scene(1.0).observations,
            {"synchronised": False},
            f"{TOGETHER}: ring_0, ring_1, ring_2: the person is seen for 1.0 s only: too short .*--synchronised",
        ),
    ],
    ids=["one camera", "nobody", "one sees", "no shared view", "no shared time", "1 s"],
)
def test_what_shows_too_little_is_an_error(
    people: Callable[[], PeopleObservations], options: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        calibrated(people(), **options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"stature_m": 0.3}, "a stature is from 0.7 to 2.5 metres, got 0.3"),
        ({"stature_m": 17.8}, "a stature is from 0.7 to 2.5 metres, got 17.8"),
        ({"stature_m": 178.0}, "a stature is in metres: 1.78, not 178"),
        ({"distances": [("ring_0", "ring_7", 2.0)]}, "a distance is given for ring_7; the cameras are ring_0, ring_1"),
        ({"distances": [("ring_0", "ring_1", 0.0)]}, "must be a positive number of metres, got 0.0"),
        ({"distances": [("ring_1", "ring_1", 2.0)]}, "a distance needs two cameras, got ring_1 twice"),
    ],
)
def test_what_cannot_be_is_an_error_before_any_work(options: dict[str, Any], message: str) -> None:
    def worked(done: int, of_all: int) -> None:
        raise AssertionError("work was done")

    with pytest.raises(ValueError, match=message):
        calibrated(scene().observations, **options, progress=worked)


@pytest.mark.slow
@pytest.mark.parametrize("share", [1.2, 2.0], ids=["30 Hz stated as 25", "50 Hz stated as 25"])
def test_a_rate_that_the_file_states_wrongly(share: float) -> None:
    walk = scene(12.0)
    people = changed(walk, at_rate(share))
    starts = find_starts(main_tracks(find_tracks(people), people.skeleton), people.skeleton, walk.intrinsics)
    assert not starts.trusted[1]
    (finding,) = [finding for finding in starts.findings if finding.camera == "ring_1"]
    assert finding.grade is Grade.FAILED
    assert "frame rate" in finding.remedy


def test_a_camera_that_sees_nobody_is_named_and_the_others_are_calibrated() -> None:
    people, distance = changed(scene(), nobody_in("ring_0")), ("ring_0", "ring_1", 2.0)
    found = calibrated(people, distances=[distance], stature_m=1.7)
    assert found.grade is Grade.FAILED
    assert found.rig.names == ("ring_1", "ring_2")
    (finding,) = [finding for finding in found.findings if finding.camera == "ring_0"]
    assert (finding.grade, finding.reason) == (Grade.FAILED, "nobody is seen")
    assert "leave this camera out" in finding.remedy
    # A distance to a camera that is not in the rig does not count.
    assert found.scale_from == "stature 1.70 m"


@cache
def of_a_second() -> CalibratedFromPeople:
    """With K of another resolution, and a stature that is wrong by 40 %: a network does not know it to better than
    9 %, so that it takes 27 % to be sure."""
    true_m = stature_m(scene(1.0).motion.truth_m[0], scene(1.0).motion.skeleton)
    return calibrated(scene(1.0).observations, of_resolution(2 / 3), stature_m=0.6 * true_m)


@pytest.mark.parametrize(
    "reason",
    ["two cameras saw the person for 1.0 s only", "as of images of another size", "larger than stature|smaller than s"],
    ids=["1 s", "resolution", "stature"],
)
def test_what_is_wrong_is_in_the_verdict(reason: str) -> None:
    found = of_a_second()
    assert found.grade is not Grade.GOOD
    about = [finding for finding in found.findings if re.search(reason, finding.reason)]
    assert {finding.camera for finding in about} in ({""}, set(NAMES))
    assert all(finding.remedy for finding in about)
    # Once for all that is short.
    assert len([finding for finding in found.findings if "for 1.0 s only" in finding.reason]) == 1
