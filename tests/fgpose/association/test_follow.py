"""The life of those who are followed: confirmed, lost, recognised, and never anybody who is not there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rooms import FPS, Scene, body_m, image, people_of, run

from fgpose.association.follow import Follower
from fgpose.association.identity.likeness import Likeness
from fgpose.association.pose_filter import PoseFilters
from fgpose.association.track import Track, TrackState
from fgpose.geometry.camera import CameraRig
from fgpose.parameters import TrackingConfig
from fgpose.people_observations import Detections
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import ring_rig

HERE_M, THERE_M = (0.0, -0.6), (0.2, 0.7)


@pytest.fixture
def follower(rig: CameraRig, skeleton: Skeleton) -> Follower:
    return Follower(rig, skeleton)


def what_happened(follower: Follower) -> list[str]:
    return [event.what for event in follower.events]


def always(*people_m: np.ndarray) -> Scene:
    return lambda camera, time_s: people_m


def test_who_is_seen_by_two_cameras_is_confirmed_within_a_third_of_a_second(skeleton: Skeleton) -> None:
    rig = ring_rig(2)
    follower = Follower(rig, skeleton)
    run(follower, rig, always(body_m(skeleton)), 0.0, 0.4)
    assert people_of(follower) == [0]
    (event,) = follower.events
    assert (event.what, event.person) == ("confirmed", 0)
    assert event.time_s <= 0.3


def test_nobody_is_confirmed_by_one_camera_of_several(follower: Follower, rig: CameraRig, skeleton: Skeleton) -> None:
    poster_m = body_m(skeleton)
    run(follower, rig, lambda camera, _: [poster_m] if camera == 1 else [], 0.0, 3.0)
    assert follower.tracks == []
    assert follower.events == []


def test_a_camera_that_hangs_keeps_nobody_in_the_room(follower: Follower, rig: CameraRig, skeleton: Skeleton) -> None:
    """Its images come on, those of all others stop."""
    run(follower, rig, always(body_m(skeleton)), 0.0, 1.0)
    assert people_of(follower) == [0]
    hung = image(rig, 1, 1.0, [body_m(skeleton)], np.random.default_rng(0))
    follower.see([hung])
    for n in range(1, 120):
        assert follower.see([hung.at(1.0 + n / FPS)]) == []
    assert people_of(follower) == []
    assert what_happened(follower) == ["confirmed", "lost"]


def test_a_false_detection_beside_a_person_is_nobody(follower: Follower, rig: CameraRig, skeleton: Skeleton) -> None:
    person_m, poster_m = body_m(skeleton, HERE_M), body_m(skeleton, THERE_M)
    run(follower, rig, lambda camera, _: [person_m, poster_m][: 2 if camera == 1 else 1], 0.0, 1.5)
    assert people_of(follower) == [0]
    assert what_happened(follower) == ["confirmed"]


def test_views_that_agree_for_two_frames_are_nobody(follower: Follower, rig: CameraRig, skeleton: Skeleton) -> None:
    person_m = body_m(skeleton)
    run(follower, rig, lambda _, time_s: [person_m] if 0.99 < time_s < 1.05 else [], 0.0, 3.0)
    assert follower.tracks == []
    assert follower.events == []


def test_who_leaves_is_lost_and_told(follower: Follower, rig: CameraRig, skeleton: Skeleton) -> None:
    """Four cameras that see nobody where somebody should be are sure sooner than coast_s."""
    person_m = body_m(skeleton)
    run(follower, rig, lambda _, time_s: [person_m] if time_s < 2.5 else [], 0.0, 4.0)
    assert follower.tracks == []
    assert what_happened(follower) == ["confirmed", "lost"]
    assert 2.5 < follower.events[1].time_s < 3.0


def test_who_is_hidden_for_a_moment_coasts(follower: Follower, rig: CameraRig, skeleton: Skeleton) -> None:
    """All detectors fail for a fifth of a second."""
    person_m, states = body_m(skeleton), []
    for frame in range(60):
        hidden = 30 <= frame < 36
        follower.see([image(rig, c, frame / FPS, [] if hidden else [person_m]) for c in range(rig.n_cameras)])
        states += [track.state for track in follower.tracks]
    assert what_happened(follower) == ["confirmed"]
    assert TrackState.COASTING in states
    assert states[-1] is TrackState.CONFIRMED


def test_detectors_that_all_stop_lose_nobody(follower: Follower, rig: CameraRig, skeleton: Skeleton) -> None:
    """For 0.6 s; two people half a metre apart were lost after 0.2 s, and came back as each other or as others."""
    people_m, shown = [body_m(skeleton, (0.0, -0.25)), body_m(skeleton, (0.0, 0.25))], set()
    for frame in range(100):
        is_stopped = 60 <= frame < 78
        follower.see([image(rig, c, frame / FPS, [] if is_stopped else people_m) for c in range(rig.n_cameras)])
        if frame >= 60:
            shown.add(tuple(sorted(track.number for track in follower.tracks)))
    assert what_happened(follower) == ["confirmed", "confirmed"]
    assert len(shown) == 1


def test_who_has_gone_does_not_live_on_halves_of_somebody_else(
    follower: Follower, rig: CameraRig, skeleton: Skeleton
) -> None:
    """When the second has gone, 0.6 m away, detectors split the first into every other joint and the rest."""
    people_m, half = [body_m(skeleton), body_m(skeleton, (0.0, 0.6))], np.arange(skeleton.n_joints) % 2 == 0
    rng = np.random.default_rng(0)
    for frame in range(120):
        images = [image(rig, c, frame / FPS, people_m[: 1 + (frame < 60)], rng) for c in range(rig.n_cameras)]
        if frame >= 60:
            images = [
                Detections(
                    each.camera,
                    each.time_s,
                    np.repeat(each.points2d_px, 2, axis=0),
                    each.confidence * np.stack([half, ~half]),
                )
                for each in images
            ]
        follower.see(images)
    assert what_happened(follower) == ["confirmed", "confirmed", "lost"]
    assert follower.events[-1].time_s < 2.5
    # Twice what the filter takes for the standard deviation of a detection.
    assert np.linalg.norm(follower.tracks[0].pose.positions_m[0] - people_m[0], axis=-1).max() < 0.08


def test_who_has_gone_does_not_live_on_second_detections_of_somebody_else(
    follower: Follower, rig: CameraRig, skeleton: Skeleton
) -> None:
    """They go 0.1 m beside the first, of whom half of the images then have a second detection there."""
    rng = np.random.default_rng(0)

    def scene(_: int, time_s: float) -> list[np.ndarray]:
        beside_m = float(np.interp(time_s, [1.0, 2.0], [0.8, 0.1]))
        is_there = time_s < 2.0 or rng.random() < 0.5
        return [body_m(skeleton), body_m(skeleton, (0.0, beside_m))][: 1 + is_there]

    run(follower, rig, scene, 0.0, 2.0)
    assert people_of(follower) == [0, 1]
    run(follower, rig, scene, 2.0, 5.0)
    assert what_happened(follower)[:3] == ["confirmed", "confirmed", "lost"]
    assert len(people_of(follower)) == 1


def scene_of_a_return(skeleton: Skeleton, away_m: np.ndarray, back_m: np.ndarray, n_away_s: float = 5.0) -> Scene:
    """Two people; the first leaves after 3 s and somebody comes after n_away_s."""
    stays_m = body_m(skeleton, THERE_M)

    def scene(_: int, time_s: float) -> list[np.ndarray]:
        if time_s < 3.0:
            return [stays_m, away_m]
        return [stays_m] if time_s < 3.0 + n_away_s else [stays_m, back_m]

    return scene


@pytest.mark.parametrize("back_m", [pytest.param(HERE_M, marks=pytest.mark.slow), (-1.0, 0.4)])
def test_who_comes_back_is_known_by_their_bones(
    follower: Follower, rig: CameraRig, skeleton: Skeleton, back_m: tuple[float, float]
) -> None:
    """Two have gone, one of 1.15 times the size of the other; the taller comes back, at the same place or elsewhere."""
    tall_m, small_m = body_m(skeleton, HERE_M, 1.12), body_m(skeleton, (-0.9, -0.3), 0.92)
    stays_m, again_m = body_m(skeleton, THERE_M), body_m(skeleton, back_m, 1.12)

    def scene(_: int, time_s: float) -> list[np.ndarray]:
        if time_s < 3.0:
            return [stays_m, tall_m, small_m]
        return [stays_m] if time_s < 8.0 else [stays_m, again_m]

    run(follower, rig, scene, 0.0, 3.0)
    height = {track.person: np.ptp(track.pose.positions_m[0, :, 2]) for track in follower.tracks}
    tall = max(height, key=height.__getitem__)
    run(follower, rig, scene, 3.0, 11.0, seed=1)
    assert tall in people_of(follower)
    assert len(people_of(follower)) == 2
    assert what_happened(follower).count("recognised") == 1


def test_who_comes_back_soon_is_known_by_the_place(follower: Follower, rig: CameraRig, skeleton: Skeleton) -> None:
    """Away for longer than anybody is predicted."""
    person_m = body_m(skeleton, HERE_M)
    run(follower, rig, scene_of_a_return(skeleton, person_m, person_m, n_away_s=1.5), 0.0, 3.0)
    before = people_of(follower)
    run(follower, rig, scene_of_a_return(skeleton, person_m, person_m, n_away_s=1.5), 3.0, 8.0)
    assert people_of(follower) == before
    (event,) = (event for event in follower.events if event.what == "recognised")
    again = next(track for track in follower.tracks if track.person == event.became)
    assert again.former in (None, event.person)
    assert event.person not in before
    assert not follower.is_provisional(again, 8.0)


def test_who_is_new_is_provisional_while_they_may_be_somebody_who_was_lost(
    follower: Follower, rig: CameraRig, skeleton: Skeleton
) -> None:
    scene = scene_of_a_return(skeleton, body_m(skeleton, HERE_M, 1.12), body_m(skeleton, HERE_M, 0.9))

    def provisional(now_s: float) -> list[int]:
        return [track.person for track in follower.tracks if follower.is_provisional(track, now_s)]

    run(follower, rig, scene, 0.0, 1.0)
    assert provisional(1.0) == []
    run(follower, rig, scene, 1.0, 9.0)
    assert provisional(9.0) == [2]
    run(follower, rig, scene, 9.0, 11.5)
    assert provisional(11.5) == []


@pytest.mark.parametrize(("size", "is_open"), [(1.0, False), (0.97, True)])
def test_who_is_recognised_is_provisional_until_that_is_certain(
    follower: Follower, rig: CameraRig, skeleton: Skeleton, size: float, is_open: bool
) -> None:
    """Bones of 3 % less, a centimetre, hardly tell somebody else where another has just left, within 1.5 s."""
    scene = scene_of_a_return(skeleton, body_m(skeleton, HERE_M), body_m(skeleton, HERE_M, size), n_away_s=2.5)
    run(follower, rig, scene, 0.0, 7.0, seed=2)
    (event,) = (event for event in follower.events if event.what == "recognised")
    back = next(track for track in follower.tracks if track.person == event.became)
    assert follower.is_provisional(back, 7.0) == is_open


def test_later_bones_that_speak_against_it_are_told(follower: Follower, rig: CameraRig, skeleton: Skeleton) -> None:
    """Whoever comes looks as tall as who left while they are at the door, and is not."""
    left_m, door_m, is_m = (body_m(skeleton, HERE_M, size) for size in (1.0, 0.97, 0.85))

    def scene(_: int, time_s: float) -> list[np.ndarray]:
        come_m = [] if time_s < 5.5 else [door_m] if time_s < 5.8 else [is_m]
        return [body_m(skeleton, THERE_M), *([left_m] if time_s < 3.0 else come_m)]

    run(follower, rig, scene, 0.0, 12.0, seed=2)
    (recognised,) = (event for event in follower.events if event.what == "recognised")
    (doubted,) = (event for event in follower.events if event.what == "doubted")
    assert doubted.person == recognised.became
    back = next(track for track in follower.tracks if track.person == doubted.person)
    assert follower.is_provisional(back, 12.0)


def test_whose_looks_are_known_is_recognised_at_once(follower: Follower, rig: CameraRig, skeleton: Skeleton) -> None:
    """They are never called by another number."""
    looks, rng = np.eye(8)[:2], np.random.default_rng(0)
    people_m, numbers = [body_m(skeleton, HERE_M), body_m(skeleton, THERE_M)], set[int]()
    for frame in range(round(12 * FPS)):
        time_s = frame / FPS
        seen = [n for n in range(2) if n or not 6.0 <= time_s < 10.0]
        vectors = looks[seen] + 0.05 * rng.standard_normal((len(seen), 8))
        images = [image(rig, c, time_s, [people_m[n] for n in seen], rng) for c in range(rig.n_cameras)]
        follower.see([replace(each, appearance=vectors) for each in images])
        numbers |= set(people_of(follower))
    assert numbers == {0, 1}
    (event,) = (event for event in follower.events if event.what == "recognised")
    assert (event.person, [track.former for track in follower.tracks]) == (2, [None, None])


def test_somebody_of_another_size_is_somebody_else(follower: Follower, rig: CameraRig, skeleton: Skeleton) -> None:
    scene = scene_of_a_return(skeleton, body_m(skeleton, HERE_M, 1.12), body_m(skeleton, HERE_M, 0.9))
    run(follower, rig, scene, 0.0, 11.0)
    assert max(people_of(follower)) == 2
    assert "recognised" not in what_happened(follower)


def test_who_leaves_beside_a_newcomer_does_not_become_them(
    follower: Follower, rig: CameraRig, skeleton: Skeleton
) -> None:
    """Both were there at the same time, so they are two, however alike and near."""
    first_m, second_m = body_m(skeleton, (0.0, 0.0)), body_m(skeleton, (0.0, 0.5))

    def scene(_: int, time_s: float) -> list[np.ndarray]:
        return [first_m] * (time_s < 3.0) + [second_m] * (time_s > 2.0)

    run(follower, rig, scene, 0.0, 6.0)
    assert people_of(follower) == [1]
    assert "recognised" not in what_happened(follower)


def test_everybody_leaves_and_comes_back(follower: Follower, rig: CameraRig, skeleton: Skeleton) -> None:
    """Three of different size, each where they were before."""
    people_m = [body_m(skeleton, at, size) for at, size in ((HERE_M, 1.14), (THERE_M, 1.0), ((-1.1, 0.1), 0.86))]

    def scene(_: int, time_s: float) -> list[np.ndarray]:
        return [] if 2.0 <= time_s < 7.0 else people_m

    run(follower, rig, scene, 0.0, 2.0)
    before = {track.person: track.middle_m for track in follower.tracks}
    run(follower, rig, scene, 2.0, 3.5)
    assert follower.tracks == []
    run(follower, rig, scene, 6.5, 8.5)
    assert people_of(follower) == sorted(before)
    for track in follower.tracks:
        assert np.linalg.norm(track.middle_m - before[track.person]) < 0.1


@pytest.mark.parametrize("n_cameras", [1, 4])
def test_doubled_detections_in_all_cameras_are_one_person(n_cameras: int, skeleton: Skeleton) -> None:
    rig = ring_rig(4).subset([f"ring_{c}" for c in range(n_cameras)])
    follower, person_m = Follower(rig, skeleton), body_m(skeleton)
    run(follower, rig, always(person_m, person_m), 0.0, 3.0)
    assert people_of(follower) == [0]
    assert set(follower.person_of_track.values()) == {0}


def candidates(rig: CameraRig, camera: int, time_s: float, rng: np.random.Generator, n: int) -> Detections:
    points_px = rng.uniform(0, 1000, (n, 1, 2)) + rng.normal(scale=60.0, size=(n, 17, 2))
    return Detections(rig.names[camera], time_s, points_px, np.full((n, 17), 0.3))


def test_a_person_among_two_hundred_candidates(follower: Follower, rig: CameraRig, skeleton: Skeleton) -> None:
    rng, person_m = np.random.default_rng(0), body_m(skeleton)
    for frame in range(15):
        images = []
        for c in range(rig.n_cameras):
            among = candidates(rig, c, frame / FPS, rng, 200)
            own = image(rig, c, frame / FPS, [person_m], rng)
            points_px = np.concatenate([among.points2d_px, own.points2d_px])
            confidence = np.concatenate([among.confidence, own.confidence])
            images.append(Detections(own.camera, frame / FPS, points_px, confidence))
        follower.see(images)
    (person,) = [track for track in follower.tracks if track.is_confirmed]
    assert np.linalg.norm(person.middle_m - np.median(person_m, axis=0)) < 0.1
    # Those who are tried for a while are as many as an image has room for.
    assert len(follower.tracks) <= 12


def test_all_candidates_at_one_place_are_one(follower: Follower, rig: CameraRig, skeleton: Skeleton) -> None:
    run(follower, rig, always(*[body_m(skeleton)] * 40), 0.0, 0.7)
    assert len(follower.tracks) == 1
    assert people_of(follower) == [0]


def test_nothing_at_all(follower: Follower, rig: CameraRig) -> None:
    assert follower.see([]) == []
    empty = [image(rig, c, 0.0, []) for c in range(rig.n_cameras)]
    assert [list(sighting.joints()) for sighting in follower.see(empty)] == [[]] * rig.n_cameras
    nothing = [Detections(name, 0.1, np.full((3, 17, 2), np.nan), np.zeros((3, 17))) for name in rig.names]
    assert [list(sighting.joints()) for sighting in follower.see(nothing)] == [[]] * rig.n_cameras
    follower.finish()
    assert follower.tracks == []


def test_sightings_say_who_is_where(follower: Follower, rig: CameraRig, skeleton: Skeleton) -> None:
    people_m = [body_m(skeleton, HERE_M), body_m(skeleton, THERE_M)]

    def scene(camera: int, _: float) -> list[np.ndarray]:
        return people_m if camera % 2 else people_m[::-1]

    for sightings in (run(follower, rig, scene, 0.0, 0.01), run(follower, rig, scene, 0.1, 1.0)):
        number_of = {}
        for c, sighting in enumerate(sightings):
            assert sighting.image.camera == rig.names[c]
            for track, detection, joint in sighting.joints():
                (number,) = set(detection.tolist())
                who = number if c % 2 else 1 - number
                assert number_of.setdefault(track, who) == who
                np.testing.assert_array_equal(joint, np.arange(17))
        assert sorted(number_of.values()) == [0, 1]


def walking_at(start_m: np.ndarray, time_s: float) -> np.ndarray:
    return start_m + np.array([0.8 * time_s, 0.0, 0.0])


@pytest.mark.parametrize("late_s", [pytest.param(0.0, marks=pytest.mark.slow), 0.15])
def test_cameras_of_different_rates(late_s: float, rig: CameraRig, skeleton: Skeleton) -> None:
    """At 25 and 30 Hz with phases of their own, each image by itself; the images of the last camera come late."""
    follower, start_m = Follower(rig, skeleton), [body_m(skeleton, (-1.2, -0.6)), body_m(skeleton, (-1.2, 0.6))]
    rng, arrivals = np.random.default_rng(0), []
    for c in range(rig.n_cameras):
        for time_s in np.arange(0.007 * c, 2.0, 1 / (25.0 if c % 2 else 30.0)).tolist():
            arrivals.append((time_s + late_s * (c == 3), c, time_s))
    for _, c, time_s in sorted(arrivals):
        follower.see([image(rig, c, time_s, [walking_at(person_m, time_s) for person_m in start_m], rng)])
    assert people_of(follower) == [0, 1]
    assert what_happened(follower) == ["confirmed"] * 2
    for track in follower.tracks:
        error_m = [np.linalg.norm(track.middle_m - np.median(walking_at(m, 2.0), axis=0)) for m in start_m]
        assert min(error_m) < 0.1


def test_an_image_older_than_the_newest_leaves_everybody_as_they_are(
    follower: Follower, rig: CameraRig, skeleton: Skeleton
) -> None:
    person_m = body_m(skeleton)
    run(follower, rig, always(person_m), 0.0, 2.0)
    (track,) = follower.tracks
    seen_s, likeness_n = track.seen_s, track.likeness.lengths.n
    follower.see([image(rig, 0, 1.9, [person_m])])
    follower.see([image(rig, 1, 1.95, [])])
    assert follower.tracks == [track]
    assert track.seen_s == seen_s
    assert (track.likeness.lengths.n >= likeness_n).all()
    assert track.state is TrackState.CONFIRMED


def test_bones_are_learnt_although_the_newest_image_shows_nobody(skeleton: Skeleton) -> None:
    """The third camera is always the last of its frame, and looks elsewhere."""
    rig, person_m, rng = ring_rig(3), body_m(skeleton), np.random.default_rng(0)
    follower = Follower(rig, skeleton)
    for frame in range(60):
        follower.see([image(rig, c, frame / FPS + 0.005 * c, [person_m] if c < 2 else [], rng) for c in range(3)][::-1])
        if follower.tracks:
            # That it does not see them does not tell against them: something is in the way.
            follower.tracks[0].score, follower.tracks[0].absent = 20.0, 0.0
    (track,) = follower.tracks
    assert (track.likeness.lengths.n > 1).any()


def test_one_by_one_or_all_at_once(rig: CameraRig, skeleton: Skeleton) -> None:
    """Images of one time: who there is does not depend on how they are given."""
    people_m = [body_m(skeleton, HERE_M), body_m(skeleton, THERE_M)]
    rng, at_once, one_by_one = np.random.default_rng(0), Follower(rig, skeleton), Follower(rig, skeleton)
    for frame in range(30):
        images = [image(rig, c, frame / FPS, people_m, rng) for c in range(rig.n_cameras)]
        at_once.see(images)
        for each in images:
            one_by_one.see([each])
    assert people_of(one_by_one) == people_of(at_once) == [0, 1]
    for one, other in zip(one_by_one.tracks, at_once.tracks, strict=True):
        assert np.isfinite(one.likeness.lengths.mean_m).all()
        np.testing.assert_allclose(one.likeness.lengths.mean_m, other.likeness.lengths.mean_m, atol=0.03)


@pytest.mark.parametrize("n_joints", [1, 2, 17])
def test_skeletons_without_bones_and_sides(n_joints: int, rig: CameraRig, skeleton: Skeleton) -> None:
    """A single joint is not somebody: it may be a false detection."""
    points = Skeleton("points", skeleton.joints[:n_joints], (), (0,))
    follower, person_m = Follower(rig, points), body_m(skeleton)[[16, 3, *range(3), *range(4, 16)]][:n_joints]
    rng = np.random.default_rng(0)
    for frame in range(15):
        follower.see([image(rig, c, frame / FPS, [person_m], rng) for c in range(4)])
    assert people_of(follower) == ([0] if n_joints > 1 else [])


def track_at(follower: Follower, skeleton: Skeleton, number: int, place_m: tuple[float, float]) -> Track:
    """Somebody who is followed, and was seen just now."""
    pose = PoseFilters.at(0.0, body_m(skeleton, place_m), np.tile(1e-4 * np.eye(3), (skeleton.n_joints, 1, 1)))
    track = Track(number, pose, 20.0, -5.0, 0.0, {"ring_0": 0.0, "ring_1": 0.0}, Likeness(skeleton))
    track.state, track.person, track.confirmed_s = TrackState.CONFIRMED, number, -5.0
    follower.tracks.append(track)
    return track


def still(follower: Follower, rig: CameraRig, people_m: list[np.ndarray], n: int) -> None:
    for frame in range(n):
        follower.see([image(rig, c, frame / FPS, people_m) for c in range(rig.n_cameras)])


def test_of_three_in_a_row_only_those_near_each_other_are_one(
    follower: Follower, rig: CameraRig, skeleton: Skeleton
) -> None:
    """The second is at the place of the first, the third at that of the second, but not at that of the first."""
    places_m = [(0.0, 0.0), (0.0, 0.15), (0.0, 0.3)]
    for number, place_m in enumerate(places_m):
        track_at(follower, skeleton, number, place_m)
    still(follower, rig, [body_m(skeleton, place_m) for place_m in places_m], 15)
    assert people_of(follower) == [0, 2]


def test_who_is_confirmed_is_not_merged_into_a_guess(follower: Follower, rig: CameraRig, skeleton: Skeleton) -> None:
    guess, person = (track_at(follower, skeleton, number, (0.0, 0.1 * number)) for number in range(2))
    guess.state, guess.score, guess.scored_s = TrackState.TENTATIVE, 0.0, dict.fromkeys(rig.names, 0.0)
    people_m = [body_m(skeleton, (0.0, 0.1 * n)) for n in range(2)]
    for frame in range(15):
        guess.score = min(guess.score, 0.0)
        follower.see([image(rig, c, frame / FPS, people_m) for c in range(4)])
    assert people_of(follower) == [person.person]
    # Nobody was told of the guess.
    assert follower.events == []


def test_who_is_found_again_is_the_nearest(follower: Follower, rig: CameraRig, skeleton: Skeleton) -> None:
    for number, place_m in enumerate([(0.0, -0.5), (0.0, 0.4)]):
        track_at(follower, skeleton, number, place_m).seen_s = -0.9
    # Where nobody was expected, 0.7 m from the second and 1 m from the first: either may have walked there.
    follower.see([image(rig, c, 0.0, [body_m(skeleton, (0.7, 0.2))]) for c in range(rig.n_cameras)])
    again = [event.person for event in follower.events if event.what == "found again"]
    assert again == [1]


def test_who_is_found_again_is_not_lost_at_the_next_miss(
    follower: Follower, rig: CameraRig, skeleton: Skeleton
) -> None:
    track = track_at(follower, skeleton, 0, (0.0, 0.0))
    track.seen_s, track.absent = -0.45, -6.0
    person_m = body_m(skeleton, (0.5, 0.0))
    follower.see([image(rig, c, 0.0, [person_m]) for c in range(rig.n_cameras)])
    follower.see([image(rig, 0, 0.2, [])])
    assert [event.what for event in follower.events] == ["found again"]
    assert follower.tracks == [track]


@pytest.fixture
def drifted(follower: Follower, rig: CameraRig, skeleton: Skeleton) -> Track:
    """Somebody at (0, 0) whom the first camera alone has shown for 0.4 s, taken to be farther from it by a sixth: there
    they look the same to it."""
    track = track_at(follower, skeleton, 0, (0.0, 0.0))
    eye_m = rig.cameras[0].position_m
    track.pose = replace(
        track.pose, mean=track.pose.mean + np.pad((track.pose.positions_m - eye_m) / 6, [(0, 0), (0, 0), (0, 3)])
    )
    track.shown_s, track.agreed_s = dict.fromkeys(rig.names, -0.4) | {"ring_0": 0.0}, -0.4
    return track


def test_who_has_drifted_in_one_view_is_found_again_where_others_see_them(
    follower: Follower, rig: CameraRig, skeleton: Skeleton, drifted: Track
) -> None:
    person_m = body_m(skeleton)
    assert np.linalg.norm(drifted.middle_m - np.median(person_m, axis=0)) > 0.7
    still(follower, rig, [person_m], 10)
    assert follower.tracks == [drifted]
    assert what_happened(follower) == ["found again"]
    # A tenth of the 0.75 m that they had drifted.
    np.testing.assert_allclose(drifted.middle_m, np.median(person_m, axis=0), atol=0.07)


def test_who_was_elsewhere_when_two_cameras_agreed_is_somebody_else(
    follower: Follower, rig: CameraRig, skeleton: Skeleton, drifted: Track
) -> None:
    """3 m away 0.4 s before."""
    drifted.agreed_m = drifted.middle_m + np.array([0.0, 3.0, 0.0])
    still(follower, rig, [body_m(skeleton)], 1)
    assert len(follower.tracks) == 2
    assert what_happened(follower) == []


def test_who_was_seen_by_nobody_in_between_is_somebody_else(
    follower: Follower, rig: CameraRig, skeleton: Skeleton, drifted: Track
) -> None:
    """The first camera shows them again after 0.4 s: it may show another one."""
    drifted.shown_s["ring_0"] = drifted.seen_s = -0.4
    still(follower, rig, [body_m(skeleton)], 1)
    assert drifted.shown_s["ring_0"] == 0.0
    assert len(follower.tracks) == 2
    assert what_happened(follower) == []


def test_who_has_ended_since_their_image_is_not_found_again(
    follower: Follower, rig: CameraRig, skeleton: Skeleton, drifted: Track
) -> None:
    person_m = body_m(skeleton)
    follower.see([image(rig, 0, 0.0, [person_m])])
    assert drifted.shown_s["ring_0"] == 0.0
    drifted.state = TrackState.ENDED
    follower.tracks.clear()
    follower.see([image(rig, c, 0.02, [person_m]) for c in range(1, 4)])
    assert [track.number for track in follower.tracks] == [follower._n_tracks - 1]
    assert drifted not in follower.tracks


def test_the_end_confirms_nobody_against_whom_images_tell(
    follower: Follower, rig: CameraRig, skeleton: Skeleton
) -> None:
    person_m = body_m(skeleton)
    follower.see([image(rig, c, 0.0, [person_m]) for c in range(rig.n_cameras)])
    follower.see([image(rig, c, 0.01, []) for c in range(rig.n_cameras)])
    assert len(follower.tracks) == 1
    assert follower.tracks[0].score < 0
    follower.finish()
    assert people_of(follower) == []


def test_nothing_is_kept_of_tracks_that_have_ended(skeleton: Skeleton) -> None:
    """Four people, one after another, at four places."""
    rig = ring_rig(2)
    follower, known = Follower(rig, skeleton), dict[int, int]()
    for visit in range(4):
        people_m = always(body_m(skeleton, (0.5 * visit - 0.75, 0.0), 0.85 + 0.1 * visit))
        run(follower, rig, people_m, 3.0 * visit, 3.0 * visit + 0.6, visit)
        assert follower.person_of_track.keys() == {track.number for track in follower.tracks}
        known |= follower.person_of_track
        run(follower, rig, always(), 3.0 * visit + 0.6, 3.0 * visit + 2.0)
        assert follower.person_of_track == {}
    assert sorted(known.values()) == [0, 1, 2, 3]


@pytest.mark.slow
def test_the_state_does_not_grow(skeleton: Skeleton) -> None:
    """Each of 1,000 moments stands for a tenth of a second: people come and go, and are forgotten after 20 s."""
    rig = ring_rig(2)
    follower, rng = Follower(rig, skeleton, TrackingConfig(forget_s=20.0)), np.random.default_rng(0)
    places_m = rng.uniform(-0.8, 0.8, (200, 2))
    sizes: list[tuple[int, ...]] = []
    for n in range(1000):
        time_s = 0.1 * n
        # Everybody stays for 2 s of 2.5 s.
        visit, since = divmod(n, 25)
        people_m = [body_m(skeleton, places_m[visit].tolist(), 0.9 + 0.001 * visit)] if since < 20 else []
        follower.see([image(rig, c, time_s, people_m, rng) for c in range(2)])
        if n % 20 == 19:
            sizes.append(
                (len(follower.tracks), len(follower._lost), len(follower._free), len(follower.person_of_track))
            )
        follower.events.clear()
    tracks, lost, free, confirmed = np.array(sizes).T
    assert confirmed.max() <= 2
    assert tracks.max() <= 2
    assert free.max() <= 2
    # One in 2.5 s, 8 in 20 s, and who has just gone.
    assert lost.max() <= 10


@pytest.mark.parametrize("are_both_detected", [True, False])
def test_who_come_near_each_other_stay_two(
    are_both_detected: bool, follower: Follower, rig: CameraRig, skeleton: Skeleton
) -> None:
    """0.15 m from each other for 0.8 s; if the detectors take them for one there, one is lost, and was there before."""

    def scene(camera: int, time_s: float) -> list[np.ndarray]:
        half_m = float(np.interp(time_s, [0.5, 1.2, 2.0, 2.7], [0.6, 0.075, 0.075, 0.6]))
        people_m = [body_m(skeleton, (side * half_m, 0.0)) for side in (-1, 1)]
        return people_m if are_both_detected or not 1.2 <= time_s <= 2.0 else people_m[:1]

    run(follower, rig, scene, 0.0, 1.0)
    assert people_of(follower) == [0, 1]
    first = dict(follower.person_of_track)
    run(follower, rig, scene, 1.0, 2.7, seed=1)
    assert all(first.get(number, person) == person for number, person in follower.person_of_track.items())
    assert "merged" not in what_happened(follower)
    if are_both_detected:
        assert people_of(follower) == [0, 1]
