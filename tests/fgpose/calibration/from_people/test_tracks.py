from __future__ import annotations

import numpy as np
import pytest
from filmed_walk import bodies_px, track_of, walk_scene

from fgpose.calibration.from_people.left_right import exchanged_images, with_steady_sides
from fgpose.calibration.from_people.starts.walker import main_tracks
from fgpose.calibration.from_people.tracks import find_tracks
from fgpose.people_observations import Detections, PeopleObservations
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import ring_rig
from fgpose_benchmarks.synthetic.crowd.walkers import walkers
from fgpose_benchmarks.synthetic.uncalibrated import SimulatedClocks, SimulatedNetwork, WalkScene, film

FPS = 25.0


def observed(skeleton: Skeleton, people_px: list[np.ndarray], seed: int = 0) -> PeopleObservations:
    """One camera; the people of each image in random order, NaN: not detected."""
    rng, images = np.random.default_rng(seed), []
    for t in range(len(people_px[0])):
        there = [px[t] for px in people_px if np.isfinite(px[t]).any()]
        order = rng.permutation(len(there))
        points_px = np.array([there[n] for n in order]).reshape(-1, skeleton.n_joints, 2)
        images.append(Detections("a", t / FPS, points_px, np.where(np.isfinite(points_px[..., 0]), 0.8, 0.0)))
    return PeopleObservations(skeleton, ("a",), tuple(images))


def test_two_who_pass_each_other_are_kept_apart(skeleton: Skeleton) -> None:
    there = bodies_px(skeleton, 100)
    back = bodies_px(skeleton, 100, seed=1)
    back[..., 0] = 1000 - back[..., 0] + 20 * np.sin(np.arange(100) / 10)[:, None]
    tracks = find_tracks(observed(skeleton, [there, back]))["a"]
    assert len(tracks) == 2
    for true_px in (there, back):
        # Nothing is added to the detections: the right track is them exactly.
        assert any(np.array_equal(track.points2d_px, true_px) for track in tracks)


def test_who_is_away_for_more_than_a_second_begins_a_new_track_and_ghosts_are_none(skeleton: Skeleton) -> None:
    there, ghost = bodies_px(skeleton, 150), np.full((150, skeleton.n_joints, 2), np.nan)
    there[60:100] = np.nan
    there[20:30] = np.nan
    ghost[110:115] = bodies_px(skeleton, 5, seed=2) + np.array([0.0, 700.0])
    tracks = find_tracks(observed(skeleton, [there, ghost]))["a"]
    assert [(round(track.time_s[0] * FPS), round(track.time_s[-1] * FPS)) for track in tracks] == [(0, 59), (100, 149)]
    assert np.isnan(tracks[0].points2d_px[20:30]).all()
    assert (tracks[0].confidence[20:30] == 0).all()


def test_exchanged_sides_are_put_right(skeleton: Skeleton) -> None:
    true_px = bodies_px(skeleton, 100) + np.random.default_rng(0).normal(0, 3, (100, skeleton.n_joints, 2))
    flipped = np.zeros(100, dtype=bool)
    flipped[30:36], flipped[60], flipped[97:] = True, True, True
    seen_px = np.where(flipped[:, None, None], true_px[:, skeleton.mirror], true_px)
    seen_px[45:50] = np.nan
    true_px[45:50] = np.nan
    track = track_of(seen_px)
    assert np.array_equal(exchanged_images(track, skeleton), flipped)
    np.testing.assert_array_equal(with_steady_sides(track, skeleton).points2d_px, true_px)


def test_sides_that_coincide_for_a_moment_do_not_turn_a_body_for_good(skeleton: Skeleton) -> None:
    # Seen from the side once, in the middle: there left and right say nothing.
    points_px = bodies_px(skeleton, 100) + np.random.default_rng(0).normal(0, 2, (100, skeleton.n_joints, 2))
    middle_px = (points_px + points_px[:, skeleton.mirror]) / 2
    share = np.abs(np.arange(100) - 50)[:, None, None] / 50
    assert not exchanged_images(track_of(middle_px + share * (points_px - middle_px)), skeleton).any()


@pytest.mark.slow
def test_main_tracks_of_several_people_are_of_one_person() -> None:
    motion = walkers((4.0, 4.0), 20.0, 5, n_people=2)
    scene = film(motion, ring_rig(3, 4.8, 2.2), 5, SimulatedNetwork(), SimulatedClocks((25.0,), 3.0))
    skeleton = scene.observations.skeleton
    chosen = main_tracks(find_tracks(scene.observations), skeleton)
    assert [track.camera for track in chosen] == list(scene.observations.camera_names)
    who = [_who(scene, track.camera, track.time_s, track.points2d_px) for track in chosen]
    assert len(set(who)) == 1


def _who(scene: WalkScene, camera: str, time_s: np.ndarray, points2d_px: np.ndarray) -> int:
    """Whose detections a track has, in most images."""
    at = {time: t for t, time in enumerate(time_s.tolist())}
    votes = []
    for image, people in zip(scene.observations.images, scene.who, strict=True):
        if image.camera == camera and image.time_s in at:
            own_px = points2d_px[at[image.time_s]]
            apart = [
                np.nanmean(np.abs(np.sort(px, axis=0) - np.sort(own_px, axis=0)))
                for px in image.points2d_px
                if np.isfinite(own_px).any()
            ]
            votes += [int(people[int(np.argmin(apart))])] if apart else []
    return int(np.bincount(votes).argmax())


def test_a_camera_that_sees_nobody_has_an_empty_track() -> None:
    observations = walk_scene().observations
    names = observations.camera_names
    emptied = tuple(
        Detections(image.camera, image.time_s, image.points2d_px[:0], image.confidence[:0])
        if image.camera == names[1]
        else image
        for image in observations.images
    )
    people = PeopleObservations(observations.skeleton, names, emptied)
    tracks = main_tracks(find_tracks(people), people.skeleton)
    assert [len(track.time_s) > 0 for track in tracks] == [True, False, True]
