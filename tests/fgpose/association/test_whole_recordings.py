from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from everybody import track_people

from fgpose.correspondences import NOBODY
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import ring_rig, walking

FPS = 30.0
N_FRAMES = 60
TIME_S = np.arange(N_FRAMES) / FPS


@pytest.fixture(scope="module")
def rig() -> CameraRig:
    return ring_rig()


def people_m(skeleton: Skeleton, *begin_m: tuple[float, float]) -> np.ndarray:
    """(T, person, J, 3) of people who walk side by side from these places on."""
    walk_m = walking(N_FRAMES, FPS, skeleton)
    begin_of_walk_m = np.array([*walk_m[0, 0, :2], 0.0])
    return np.stack([walk_m + (np.array([*begin, 0.0]) - begin_of_walk_m) for begin in begin_m], axis=1)


def candidates(
    positions_m: np.ndarray, rig: CameraRig, seed: int = 0, sigma_px: float = 4.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Noisy detections with the people of each image in random order; points, confidence, and who each one is."""
    rng = np.random.default_rng(seed)
    n_frames, n_people = positions_m.shape[:2]
    points2d_px = np.stack([camera.project(positions_m) for camera in rig.cameras], axis=1)
    points2d_px += sigma_px * rng.standard_normal(points2d_px.shape)
    who = np.argsort(rng.uniform(size=(n_frames, rig.n_cameras, n_people)), axis=-1)
    points2d_px = np.take_along_axis(points2d_px, who[..., None, None], axis=2)
    return points2d_px, np.full(points2d_px.shape[:-1], 0.9), who


def hide(points2d_px: np.ndarray, confidence: np.ndarray, hidden: np.ndarray) -> None:
    points2d_px[hidden], confidence[hidden] = np.nan, 0.0


def identities(chosen: np.ndarray, who: np.ndarray) -> np.ndarray:
    """(T, C) who was chosen, NOBODY where nobody was."""
    picked = np.take_along_axis(who, np.maximum(chosen, 0)[..., None], axis=-1)[..., 0]
    return np.where(chosen == NOBODY, NOBODY, picked)


def test_neighbours_are_followed_through_all_views(rig: CameraRig, skeleton: Skeleton) -> None:
    positions_m = people_m(skeleton, (0.0, -0.6), (0.0, 0.1), (-0.8, 0.6))
    points2d_px, confidence, who = candidates(positions_m, rig)
    people = track_people(points2d_px, confidence, TIME_S, rig, skeleton)
    assert len(people) == 3
    for chosen in people:
        (identity,) = set(identities(chosen, who).ravel().tolist())
        assert identity != NOBODY


def test_a_neighbour_who_is_seen_better_does_not_take_over(rig: CameraRig, skeleton: Skeleton) -> None:
    """For half of the time two of four cameras do not see the first person: the second has more views."""
    points2d_px, confidence, who = candidates(people_m(skeleton, (0.0, -0.5), (0.0, 0.3)), rig)
    hidden = who == 0
    hidden[: N_FRAMES // 2] = False
    hidden[:, 2:] = False
    hide(points2d_px, confidence, hidden)
    second, first = track_people(points2d_px, confidence, TIME_S, rig, skeleton)
    assert set(identities(second, who).ravel().tolist()) == {1}
    found = identities(first, who)
    assert set(found[: N_FRAMES // 2].ravel().tolist()) == {0}
    assert set(found[N_FRAMES // 2 :, 2:].ravel().tolist()) == {0}
    assert (found[N_FRAMES // 2 :, :2] == NOBODY).all()


def test_one_view_is_enough_to_go_on(rig: CameraRig, skeleton: Skeleton) -> None:
    """And all together may lose a person for a third of a second."""
    points2d_px, confidence, who = candidates(people_m(skeleton, (0.0, -0.6), (0.0, 0.4)), rig)
    hidden = who == 0
    hidden[:20] = hidden[50:] = False
    hidden[20:30, 3] = hidden[40:50, 3] = False
    hide(points2d_px, confidence, hidden)
    people = track_people(points2d_px, confidence, TIME_S, rig, skeleton)
    assert len(people) == 2
    found = identities(people[1], who)
    assert set(found[found != NOBODY].tolist()) == {0}
    assert (found[20:30, 3] == 0).all()
    assert (found[50:] == 0).all()


def test_a_view_with_left_and_right_exchanged_still_shows_the_person(rig: CameraRig, skeleton: Skeleton) -> None:
    points2d_px, confidence, who = candidates(people_m(skeleton, (0.0, -0.6), (0.0, 0.4)), rig)
    left, right = np.array(skeleton.left_right).T
    mirrored = np.arange(skeleton.n_joints)
    mirrored[left], mirrored[right] = right, left
    points2d_px[10:30, 1] = points2d_px[10:30, 1][..., mirrored, :]
    for chosen in track_people(points2d_px, confidence, TIME_S, rig, skeleton):
        assert (chosen != NOBODY).all()
        assert len(set(identities(chosen, who).ravel().tolist())) == 1


def test_what_one_camera_alone_sees_is_nobody(rig: CameraRig, skeleton: Skeleton) -> None:
    points2d_px, confidence, who = candidates(people_m(skeleton, (0.0, 0.0), (0.6, 0.8)), rig)
    poster = who == 1
    poster[:, 0] = False
    hide(points2d_px, confidence, poster)
    (chosen,) = track_people(points2d_px, confidence, TIME_S, rig, skeleton)
    assert set(identities(chosen, who).ravel().tolist()) == {0}


def test_a_person_found_twice_is_one(rig: CameraRig, skeleton: Skeleton) -> None:
    points2d_px, confidence, _ = candidates(people_m(skeleton, (0.0, 0.0), (0.0, 0.0)), rig)
    (chosen,) = track_people(points2d_px, confidence, TIME_S, rig, skeleton)
    assert (chosen != NOBODY).all()


def test_an_empty_room_has_nobody(rig: CameraRig, skeleton: Skeleton) -> None:
    points2d_px, confidence, who = candidates(people_m(skeleton, (0.0, 0.0)), rig)
    hide(points2d_px, confidence, who == 0)
    assert track_people(points2d_px, confidence, TIME_S, rig, skeleton) == []


def test_a_camera_that_is_off_by_a_degree_is_not_lost(rig: CameraRig, skeleton: Skeleton) -> None:
    points2d_px, confidence, who = candidates(people_m(skeleton, (0.0, -0.5), (0.0, 0.4)), rig)
    # One degree is 20 px at a focal length of 1145 px.
    points2d_px[:, 2] += (20.0, 0.0)
    for chosen in track_people(points2d_px, confidence, TIME_S, rig, skeleton):
        assert (chosen[:, 2] != NOBODY).mean() > 0.95
        assert len(set(identities(chosen, who)[chosen != NOBODY].tolist())) == 1


def crossing_m(skeleton: Skeleton) -> np.ndarray:
    """(T, person, J, 3) of two people who pass each other 0.7 m apart."""
    walk_m = walking(N_FRAMES, FPS, skeleton)
    along_m = np.linspace(-1.0, 1.0, N_FRAMES)[:, None, None] * [1.0, 0.0, 0.0]
    local_m = walk_m - walk_m.mean(axis=1, keepdims=True) * [1.0, 1.0, 0.0]
    aside_m = np.array([0.0, 0.35, 0.0])
    return np.stack([local_m + along_m - aside_m, local_m * [-1.0, -1.0, 1.0] - along_m + aside_m], axis=1)


def assert_everybody_is_followed(people: list[np.ndarray], who: np.ndarray, there: np.ndarray) -> None:
    """Two people, each the same in all images, and found in all images in which they are."""
    assert len(people) == 2
    for chosen in people:
        found = identities(chosen, who)
        (identity,) = set(found[found != NOBODY].tolist())
        np.testing.assert_array_equal(found == identity, (there & (who == identity)).any(axis=-1))


@pytest.mark.parametrize("n_cameras", [1, 2, 4])
def test_missed_detections_do_not_exchange_people(n_cameras: int, rig: CameraRig, skeleton: Skeleton) -> None:
    """Where one of two is missed, the other is the only candidate: continuity in space says that it is not the one."""
    rig = rig.subset(rig.names[:n_cameras])
    points2d_px, confidence, who = candidates(crossing_m(skeleton), rig)
    missed = np.random.default_rng(1).uniform(size=who.shape) < 0.15
    hide(points2d_px, confidence, missed)
    assert_everybody_is_followed(track_people(points2d_px, confidence, TIME_S, rig, skeleton), who, ~missed)


def test_views_that_are_late_are_not_lost(rig: CameraRig, skeleton: Skeleton) -> None:
    """By 0.2 s, in which each of them walks 0.25 m."""
    late, positions_m = 6, people_m(skeleton, (0.0, -0.6), (0.0, 0.4))
    points2d_px, confidence, who = candidates(positions_m, rig)
    delayed_m = np.concatenate([positions_m[:1].repeat(late, axis=0), positions_m[:-late]])
    delayed_px, _, _ = candidates(delayed_m, rig)
    points2d_px[:, 1] = delayed_px[:, 1]
    assert_everybody_is_followed(
        track_people(points2d_px, confidence, TIME_S, rig, skeleton), who, np.ones(who.shape, dtype=bool)
    )


def test_a_detector_that_leaves_out_the_far_side_is_enough(rig: CameraRig, skeleton: Skeleton) -> None:
    """And the joints without a side as well, as COCO has hardly any: no midpoint is exact."""
    positions_m = crossing_m(skeleton)
    points2d_px, confidence, who = candidates(positions_m, rig)
    sides = np.array(skeleton.left_right).T
    middle = [joint for joint in range(skeleton.n_joints) if joint not in sides]
    points2d_px[..., middle, :], confidence[..., middle] = np.nan, 0.0
    for c, camera in enumerate(rig.cameras):
        distance_m = np.linalg.norm(positions_m - camera.position_m, axis=-1)
        left_is_far = distance_m[..., sides[0]].mean(axis=-1) > distance_m[..., sides[1]].mean(axis=-1)
        left_is_far = np.take_along_axis(left_is_far, who[:, c], axis=1)
        for side, is_far in zip(sides, (left_is_far, ~left_is_far), strict=True):
            hidden = np.zeros(confidence[:, c].shape, dtype=bool)
            hidden[..., side] = is_far[..., None]
            hide(points2d_px[:, c], confidence[:, c], hidden)
    assert_everybody_is_followed(
        track_people(points2d_px, confidence, TIME_S, rig, skeleton), who, np.ones(who.shape, dtype=bool)
    )


def test_who_is_seen_by_one_view_first_is_followed_back(rig: CameraRig, skeleton: Skeleton) -> None:
    points2d_px, confidence, who = candidates(crossing_m(skeleton), rig)
    hidden = who == 0
    hidden[20:] = hidden[:, 0] = False
    hide(points2d_px, confidence, hidden)
    assert_everybody_is_followed(track_people(points2d_px, confidence, TIME_S, rig, skeleton), who, ~hidden)


def test_with_a_wrong_calibration_every_camera_follows_for_itself(rig: CameraRig, skeleton: Skeleton) -> None:
    """So that what is wrong can be seen: with one view left, nothing could be compared."""
    points2d_px, confidence, who = candidates(crossing_m(skeleton), rig)
    confidence[who == 1] = 0.8
    wrong = CameraRig(
        tuple(replace(camera, world_T_camera=np.linalg.inv(camera.world_T_camera)) for camera in rig.cameras)
    )
    first, second = track_people(points2d_px, confidence, TIME_S, wrong, skeleton)
    assert set(identities(first, who).ravel().tolist()) == {0}
    assert set(identities(second, who).ravel().tolist()) == {1}
