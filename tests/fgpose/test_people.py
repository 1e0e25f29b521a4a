from __future__ import annotations

import numpy as np
import pytest

from fgpose.people import Detections, PeopleObservations
from fgpose.skeleton import Skeleton

BODY = Skeleton("body", ("hip", "knee", "foot"), ((0, 1), (1, 2)), (0,))


def image(camera: str = "a", time_s: float = 0.0, n_people: int = 2, n_joints: int = 3) -> Detections:
    points2d_px = np.arange(n_people * n_joints * 2, dtype=float).reshape(n_people, n_joints, 2)
    return Detections(camera, time_s, points2d_px, np.ones((n_people, n_joints)))


def test_missing_is_both_nan_and_without_confidence():
    points2d_px, confidence = np.zeros((1, 3, 2)), np.array([[0.0, 0.5, 0.5]])
    points2d_px[0, 1, 0] = np.nan
    seen = Detections("a", 0.0, points2d_px, confidence)
    np.testing.assert_array_equal(np.isnan(seen.points2d_px).all(axis=-1), [[True, True, False]])
    np.testing.assert_array_equal(seen.confidence, [[0.0, 0.0, 0.5]])


def test_nobody_is_an_image():
    assert image(n_people=0).n_people == 0


@pytest.mark.parametrize(
    ("points2d_px", "confidence", "message"),
    [
        (np.zeros((1, 3)), np.ones((1, 3)), "camera a, image at 1 s: points2d_px must be"),
        (np.zeros((1, 3, 2)), np.ones((2, 3)), "confidence must be"),
        (np.full((1, 3, 2), np.inf), np.ones((1, 3)), "person 0, joint number 0: a pixel that is infinite"),
        (np.zeros((1, 3, 2)), np.array([[0.5, 1.2, 0.5]]), r"person 0, joint number 1: a confidence outside \[0, 1\]"),
    ],
)
def test_a_bad_image_is_named(points2d_px: np.ndarray, confidence: np.ndarray, message: str):
    with pytest.raises(ValueError, match=message):
        Detections("a", 1.0, points2d_px, confidence)


def test_an_image_has_a_time():
    with pytest.raises(ValueError, match="camera a: the time of an image is not finite"):
        image(time_s=np.nan)


def test_images_are_in_the_order_of_time():
    images = (image("b", 0.1), image("a", 0.1), image("b", 0.0))
    observations = PeopleObservations(BODY, ("a", "b"), images)
    assert [(each.camera, each.time_s) for each in observations.images] == [("b", 0.0), ("a", 0.1), ("b", 0.1)]
    np.testing.assert_array_equal(observations.times_s("b"), [0.0, 0.1])


@pytest.mark.parametrize(
    ("images", "message"),
    [
        ((), "at least one image"),
        ((image("c"),), "no such camera, only a, b"),
        ((image("a", n_joints=2),), "2 joints, skeleton body has 3"),
        ((image("a", 1.0), image("a", 1.0)), "camera a, image at 1 s: the camera has two images at this time"),
    ],
)
def test_a_bad_recording_is_named(images: tuple[Detections, ...], message: str):
    with pytest.raises(ValueError, match=message):
        PeopleObservations(BODY, ("a", "b"), images)


def test_of_frames_leaves_out_who_is_not_there():
    rng = np.random.default_rng(0)
    points2d_px, confidence = rng.uniform(0, 100, (2, 2, 3, 3, 2)), rng.uniform(0.1, 1, (2, 2, 3, 3))
    points2d_px[0, 1, 1] = np.nan
    time_s = np.array([[0.0, 0.01], [0.1, np.nan]])
    observations = PeopleObservations.of_frames(BODY, ("a", "b"), time_s, points2d_px, confidence)
    assert [(each.camera, each.n_people) for each in observations.images] == [("a", 3), ("b", 2), ("a", 3)]
    np.testing.assert_array_equal(observations.images[1].points2d_px, points2d_px[0, 1, [0, 2]])
