"""Who is who in a whole recording: what the result says of people, images and detections."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rooms import FPS, body_m, image

from fgpose.association.chosen_person import associate_or_each_camera, main_person
from fgpose.association.recording import associate
from fgpose.correspondences import NOBODY, MatchedFrames
from fgpose.geometry.camera import CameraRig
from fgpose.people_observations import Detections, PeopleObservations
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import ring_rig

HERE_M, THERE_M = (0.0, -0.6), (0.2, 0.7)


def recording(
    rig: CameraRig, skeleton: Skeleton, begin_s: float = 0.5, n_frames: int = 30, fps: tuple[float, ...] = (FPS,)
) -> PeopleObservations:
    """Somebody is there all the time; from a time on, somebody else, who is listed first then."""
    rng = np.random.default_rng(0)
    first_m, second_m = body_m(skeleton, HERE_M), body_m(skeleton, THERE_M)
    images = []
    for c in range(rig.n_cameras):
        for time_s in np.arange(0.0, n_frames / FPS - 1e-9, 1 / fps[c % len(fps)]).tolist():
            images.append(image(rig, c, time_s, [second_m] * (time_s >= begin_s) + [first_m], rng))
    return PeopleObservations(skeleton, rig.names, tuple(images))


def test_each_person_has_their_detections(rig: CameraRig, skeleton: Skeleton) -> None:
    told: list[tuple[int, int]] = []
    association = associate(recording(rig, skeleton), rig, progress=lambda done, of: told.append((done, of)))
    assert told == [(n + 1, 30) for n in range(30)]
    assert list(association.people) == [0, 1]
    first, second = (association.people[person] for person in (0, 1))
    assert (first.first_frame, second.first_frame) == (0, 15)
    np.testing.assert_array_equal(first.main_detection, np.repeat([[0] * 4, [1] * 4], 15, axis=0))
    np.testing.assert_array_equal(second.main_detection, np.zeros((15, 4)))
    assert association.n_unused == 0
    assert [event.what for event in association.events] == ["confirmed"] * 2


def test_observations_of_a_person(rig: CameraRig, skeleton: Skeleton) -> None:
    people = recording(rig, skeleton)
    association = associate(people, rig)
    own = association.of(1)
    assert own.n_frames == 15
    np.testing.assert_allclose(own.time_s, np.arange(15, 30) / FPS)
    true_px = rig.project(body_m(skeleton, THERE_M))
    # Five standard deviations of the noise of 3 px.
    np.testing.assert_allclose(own.points2d_px, np.broadcast_to(true_px, own.points2d_px.shape), atol=15.0)
    with pytest.raises(KeyError):
        association.of(7)


def test_cameras_of_different_rates(rig: CameraRig, skeleton: Skeleton) -> None:
    association = associate(recording(rig, skeleton, fps=(30.0, 25.0)), rig)
    assert list(association.people) == [0, 1]
    assert association.n_unused == 0


def test_what_nobody_has_is_counted(rig: CameraRig, skeleton: Skeleton) -> None:
    people = recording(rig, skeleton)
    poster_px = rig.cameras[0].project(body_m(skeleton, (-0.7, 0.9)))[None]
    images = [
        Detections(
            each.camera,
            each.time_s,
            np.concatenate([each.points2d_px, poster_px]),
            np.concatenate([each.confidence, np.full((1, 17), 0.9)]),
        )
        if each.camera == rig.names[0]
        else each
        for each in people.images
    ]
    association = associate(PeopleObservations(skeleton, rig.names, tuple(images)), rig)
    assert list(association.people) == [0, 1]
    assert association.n_unused == 30


def test_some_cameras_of_a_rig(rig: CameraRig, skeleton: Skeleton) -> None:
    people = recording(rig.subset(["ring_2", "ring_0"]), skeleton)
    association = associate(people, rig)
    assert association.rig.names == ("ring_2", "ring_0")
    assert len(association.people) == 2
    with pytest.raises(ValueError, match="no camera ring_3"):
        associate(recording(rig, skeleton, n_frames=2), rig.subset(rig.names[:3]))


def test_nobody_at_all(rig: CameraRig, skeleton: Skeleton) -> None:
    nobody = [image(rig, c, frame / FPS, []) for c in range(4) for frame in range(5)]
    people = PeopleObservations(skeleton, rig.names, tuple(nobody))
    association = associate(people, rig)
    assert association.people == {}
    assert association.n_unused == 0
    seen = people.of_person(main_person(people, rig).seen)
    assert seen.n_frames == 5
    assert (seen.confidence == 0).all()


def test_the_main_person_is_seen_most(rig: CameraRig, skeleton: Skeleton) -> None:
    people = recording(rig, skeleton)
    seen = people.of_person(main_person(people, rig).seen)
    true_px = rig.project(body_m(skeleton, HERE_M))
    np.testing.assert_allclose(seen.points2d_px, np.broadcast_to(true_px, seen.points2d_px.shape), atol=15.0)


def test_frames_in_which_no_camera_has_an_image(rig: CameraRig, skeleton: Skeleton) -> None:
    """As a caller's own frames may have."""
    people = recording(rig, skeleton, begin_s=np.inf, n_frames=20)
    usual = associate(people, rig).frames
    number, time_s = usual.image.copy(), usual.time_s
    number[10] = NOBODY
    association = associate(replace(people, given_frames=MatchedFrames(time_s, number)), rig)
    detection = association.people[0].main_detection
    assert (detection[10] == NOBODY).all()
    assert (np.delete(detection, 10, axis=0) == 0).all()


def test_every_camera_for_itself_with_rates_of_its_own(skeleton: Skeleton) -> None:
    """The cameras do not agree on anybody: one of them shows somebody else, at half the rate."""
    rig, rng = ring_rig(2), np.random.default_rng(0)
    places_m = body_m(skeleton, (0.0, 0.0)), body_m(skeleton, (0.0, 0.0)) + np.array([0.0, 0.0, 0.6])
    images = [
        image(rig, c, frame / FPS, [places_m[c]], rng) for frame in range(60) for c in range(2) if c == 0 or frame % 2
    ]
    association = associate_or_each_camera(PeopleObservations(skeleton, rig.names, tuple(images)), rig)
    seen = association.people[0].main_detection
    assert (seen[:, 0] == 0).all()
    assert (seen[1::2, 1] == 0).all()
    assert (seen[::2, 1] == NOBODY).all()


def test_who_comes_back_is_one_person_from_the_beginning_to_the_end(rig: CameraRig, skeleton: Skeleton) -> None:
    """Two of different size go; the taller comes back 4 s later where the other one left, for half a second only."""
    rng = np.random.default_rng(0)
    tall_m, small_m = body_m(skeleton, HERE_M, 1.1), body_m(skeleton, THERE_M, 0.92)
    again_m = body_m(skeleton, THERE_M, 1.1)
    images = []
    for frame in range(195):
        there = [tall_m, small_m] if frame < 60 else [again_m] if frame >= 180 else []
        images += [image(rig, c, frame / FPS, there, rng) for c in range(rig.n_cameras)]
    association = associate(PeopleObservations(skeleton, rig.names, tuple(images)), rig)
    assert len(association.people) == 2
    tall = next(person for person, seen in association.people.items() if len(seen.detection) == 195)
    detection = association.people[tall].main_detection
    assert (detection[:60] == 0).all()
    assert (detection[60:180] == NOBODY).all()
    assert (detection[180:] == 0).all()
    # The taller are told apart at the end: online, half a second would be all that is known.
    recognised = [event for event in association.events if event.what == "recognised"]
    assert [event.person for event in recognised] == [tall]
    assert "away for 4." in recognised[0].reason
    assert {event.person for event in association.events} == set(association.people)


@pytest.mark.parametrize(("n_cameras", "showing"), [(4, (0, 1)), (8, (0, 2)), (6, (0, 1, 2)), (12, (0, 2, 3, 5))])
def test_cameras_that_never_show_anybody_do_not_hide_somebody_from_the_others(
    n_cameras: int, showing: tuple[int, ...], skeleton: Skeleton
) -> None:
    """Their detector does not work, or a wall is before them: they have images, and nobody in any."""
    rig, rng, person_m = ring_rig(n_cameras), np.random.default_rng(0), body_m(skeleton, HERE_M)
    images = tuple(
        image(rig, c, t / FPS, [person_m] if c in showing else [], rng) for t in range(40) for c in range(n_cameras)
    )
    association = associate(PeopleObservations(skeleton, rig.names, images), rig)
    (seen,) = association.people.values()
    # Also in the second in which it was not known yet that the others are blind.
    assert (seen.main_detection[:, showing] == 0).all()
    assert len(seen.main_detection) == 40


def test_a_camera_that_shows_somebody_else_tells_against_who_is_not_there(skeleton: Skeleton) -> None:
    """Where rays of two people meet, two more cameras see both of them and nobody there, for as long as it lasts."""
    rig, rng = ring_rig(4), np.random.default_rng(0)
    across = (rig.cameras[0].position_m - rig.cameras[1].position_m)[:2]
    across /= np.linalg.norm(across)
    one_m, other_m = (body_m(skeleton, (aside_m * across).tolist()) for aside_m in (0.4, -0.4))
    shown = [[one_m], [other_m], [one_m, other_m], [one_m, other_m]]
    images = tuple(image(rig, c, t / FPS, shown[c], rng) for t in range(60) for c in range(4))
    association = associate(PeopleObservations(skeleton, rig.names, images), rig)
    assert len(association.people) == 2
