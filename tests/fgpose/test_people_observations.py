from __future__ import annotations

import numpy as np
import pytest

from fgpose.correspondences import NO_IMAGE, NOBODY, MatchedFrames, Seen
from fgpose.observations import Observations
from fgpose.people_observations import Detections, PeopleObservations
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
        (np.full((1, 3, 2), 1e200), np.ones((1, 3)), "person 0, joint number 0: a pixel that is infinite"),
        (np.zeros((1, 3, 2)), np.array([[0.5, 1.2, 0.5]]), r"person 0, joint number 1: a confidence outside \[0, 1\]"),
    ],
)
def test_a_bad_image_is_named(points2d_px: np.ndarray, confidence: np.ndarray, message: str):
    with pytest.raises(ValueError, match=message):
        Detections("a", 1.0, points2d_px, confidence)


def test_infinite_and_implausible_3d_is_named():
    points2d_px, confidence, points3d_m = np.zeros((1, 3, 2)), np.ones((1, 3)), np.ones((1, 3, 3))
    points3d_m[0, 2, 1] = np.inf
    with pytest.raises(ValueError, match="person 0, joint number 2: a 3D coordinate that is infinite"):
        Detections("a", 1.0, points2d_px, confidence, points3d_m)
    in_mm = Detections("a", 1.0, points2d_px, confidence, np.full((1, 3, 3), 1500.0))
    with pytest.raises(ValueError, match="1500 m: these look like millimetres"):
        PeopleObservations(BODY, ("a", "b"), (in_mm,))


def test_a_wrong_covariance_is_named():
    points3d_m, covariance_m2 = np.ones((2, 3, 3)), np.tile(np.eye(3), (2, 3, 1, 1))
    covariance_m2[1, 2, 0, 0] = -1.0
    in_2d = np.zeros((2, 3, 2)), np.ones((2, 3))
    with pytest.raises(ValueError, match="person 1, joint number 2: a covariance that is not positive definite"):
        Detections("a", 0.0, *in_2d, points3d_m, covariance_m2)
    points3d_m[1, 2] = np.nan
    Detections("a", 0.0, *in_2d, points3d_m, covariance_m2)


def test_an_image_has_a_time():
    with pytest.raises(ValueError, match="camera a: the time of an image is not finite"):
        image(time_s=np.nan)


def test_an_image_keeps_when_it_arrived_at_another_time():
    image = Detections("a", 1.0, np.zeros((1, 2, 2)), np.ones((1, 2)))
    assert image.arrived_s is image.at(2.0).arrived_s is None
    moved = image.arriving(1.5).at(2.0)
    assert (moved.time_s, moved.arrived_s) == (2.0, 1.5)
    assert moved.points2d_px is image.points2d_px
    with pytest.raises(ValueError, match="time of an image is not finite"):
        image.at(np.inf)


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


def seen_of(detection: list[list[list[int]]], first_frame: int = 0) -> Seen:
    """(T, C, J) numbers of detections, each joint as it is labelled."""
    numbers = np.array(detection)
    return Seen(first_frame, numbers, np.tile(np.arange(numbers.shape[2]), (*numbers.shape[:2], 1)))


def test_the_main_detection_has_most_joints():
    seen = seen_of([[[4, 2, 2], [NOBODY, NOBODY, 3]], [[NOBODY] * 3, [0, 0, 0]]])
    np.testing.assert_array_equal(seen.main_detection, [[2, 3], [NOBODY, 0]])


def test_frames_of_the_recording_before_and_after_are_empty():
    seen = seen_of([[[1, 1, NOBODY]], [[2, 2, 2]]], first_frame=3)
    whole = seen.in_frames(6)
    assert whole.first_frame == 0
    assert (whole.detection[[0, 1, 2, 5]] == NOBODY).all()
    np.testing.assert_array_equal(whole.detection[seen.frames], seen.detection)
    np.testing.assert_array_equal(whole.joint[seen.frames], seen.joint)


def two_frames(n_people: list[list[int]]) -> PeopleObservations:
    """So many people in the images of each frame, of cameras a and b; -1: no image."""
    rng, images, number = np.random.default_rng(0), [], np.full((len(n_people), 2), NO_IMAGE)
    for t, of_frame in enumerate(n_people):
        for c, n in enumerate(of_frame):
            if n >= 0:
                number[t, c] = sum(image.camera == "ab"[c] for image in images)
                images.append(Detections("ab"[c], 0.1 * t, rng.uniform(0, 100, (n, 3, 2)), np.full((n, 3), 0.5)))
    frames = MatchedFrames(0.1 * np.arange(len(n_people)), number)
    return PeopleObservations(BODY, ("a", "b"), tuple(images), frames)


def test_the_only_person_is_in_every_image_that_shows_one():
    people = two_frames([[1, 0], [-1, 1], [1, 1]])
    np.testing.assert_array_equal(people.only().main_detection, [[0, NOBODY], [NOBODY, 0], [0, 0]])
    observations = people.of_person(people.only())
    np.testing.assert_array_equal(observations.points2d_px[0, 0], people.images[0].points2d_px[0])
    np.testing.assert_array_equal(
        (observations.confidence > 0).all(axis=-1), [[True, False], [False, True], [True] * 2]
    )


def test_joints_of_a_person_come_from_the_detections_that_are_theirs():
    """Of camera a two joints of the second detection, exchanged, and one of the first; of camera b none."""
    people = two_frames([[2, 1]])
    seen = Seen(0, np.array([[[1, 1, 0], [NOBODY] * 3]]), np.array([[[1, 0, 2], [0, 1, 2]]]))
    observations = people.of_person(seen)
    points2d_px = people.by_camera["a"][0].points2d_px
    np.testing.assert_array_equal(
        observations.points2d_px[0, 0], [points2d_px[1, 1], points2d_px[1, 0], points2d_px[0, 2]]
    )
    assert np.isnan(observations.points2d_px[0, 1]).all()
    np.testing.assert_array_equal(observations.confidence, [[[0.5] * 3, [0.0] * 3]])
    assert observations.points3d_m is None


def test_one_person_there_and_back():
    rng = np.random.default_rng(0)
    points2d_px, confidence = rng.uniform(0, 100, (4, 2, 3, 2)), rng.uniform(0.1, 1, (4, 2, 3))
    points2d_px[1, 0], confidence[1, 0] = np.nan, 0.0
    points2d_px[2, 1, 2], confidence[2, 1, 2] = np.nan, 0.0
    points3d_m = np.where(confidence[..., None] > 0, rng.normal(size=(4, 2, 3, 3)), np.nan)
    covariance3d_m2 = np.where(confidence[..., None, None] > 0, 0.01 * np.eye(3), np.nan)
    one = Observations(BODY, 0.1 * np.arange(4), points2d_px, confidence, points3d_m, ("a", "b"), covariance3d_m2)
    people = PeopleObservations.of_one(one)
    assert len(people.images) == 8
    back = people.of_person(people.only())
    for name in ("time_s", "points2d_px", "confidence", "points3d_m", "covariance3d_m2"):
        np.testing.assert_allclose(getattr(back, name), getattr(one, name))


def test_a_subset_has_the_images_of_its_cameras():
    people = two_frames([[1, 2], [1, 1]])
    subset = people.subset(["b"])
    assert subset.camera_names == ("b",)
    assert [each.n_people for each in subset.images] == [2, 1]
    assert people.subset(["b", "a"]).camera_names == ("b", "a")
    with pytest.raises(ValueError, match="no camera c; it has a, b"):
        people.subset(["a", "c"])


def test_frames_that_a_source_gives_are_kept():
    people = two_frames([[1, 0], [-1, 1], [1, 1]])
    np.testing.assert_array_equal(people.frames.image, [[0, 0], [NO_IMAGE, 1], [1, 2]])
    alone = people.subset(["a"])
    # Camera a has no image in the second frame, which stays a frame.
    np.testing.assert_array_equal(alone.frames.image, [[0], [NO_IMAGE], [1]])
    np.testing.assert_allclose(alone.frames.frame_time_s, [0.0, 0.1, 0.2])


def test_a_frame_without_images_of_a_subset_keeps_its_time():
    own_times_s = np.array([[0.0, 0.01], [np.nan, 0.11]])
    subset = MatchedFrames(own_times_s, np.array([[0, 0], [NO_IMAGE, 1]])).subset([0])
    np.testing.assert_allclose(subset.time_s, [[0.0], [0.11]])


def test_the_first_frames_have_their_images():
    people = two_frames([[1, 0], [-1, 1], [1, 2]])
    first = people.first_frames(2)
    assert [(image.camera, image.n_people) for image in first.images] == [("a", 1), ("b", 0), ("b", 1)]
    np.testing.assert_array_equal(first.frames.image, people.frames.image[:2])
    assert first.n_most == 1
    assert people.n_most == 2


def test_some_of_the_frames_have_their_images():
    people = two_frames([[1, 0], [-1, 1], [1, 2]])
    for part in (people[1:], people.crop(float(people.frame_time_s[1]), 10.0)):
        assert [(image.camera, image.n_people) for image in part.images] == [("b", 1), ("a", 1), ("b", 2)]
        np.testing.assert_array_equal(part.frames.image, [[NO_IMAGE, 0], [0, 1]])
        np.testing.assert_array_equal(part.frame_time_s, people.frame_time_s[1:])
        assert [[image.n_people for image in images] for images in part] == [[1], [1, 2]]
    assert people[::2].n_frames == 2
    for wrong, error, message in (
        (slice(3, 3), ValueError, "at least one image"),
        (slice(None, None, -1), ValueError, "taken forward in time"),
        (0, TypeError, r"taken as a slice, as people\[0:1\]; got 0"),
    ):
        with pytest.raises(error, match=message):
            people[wrong]  # type: ignore[index]
    with pytest.raises(ValueError, match="no frame is from 20 s"):
        people.crop(20.0, 30.0)


def test_what_images_show_of_somebody_becomes_what_was_seen():
    joints = np.arange(3)
    seen = Seen.of_images([(4, 1, np.array([0, NOBODY, 0]), joints), (6, 0, np.full(3, 2), joints[::-1])], 2)
    assert seen.first_frame == 4
    np.testing.assert_array_equal(seen.main_detection, [[NOBODY, 0], [NOBODY, NOBODY], [2, NOBODY]])
    np.testing.assert_array_equal(seen.joint[2, 0], [2, 1, 0])
