"""New people: found where views agree, each once, and not where rays only happen to meet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from rooms import body_m, image, moment_of

from fgpose.association import founding
from fgpose.association.detectability import detection_probability
from fgpose.association.founding import found, found_alone
from fgpose.association.matching import Moment
from fgpose.association.pose_filter import PoseFilters
from fgpose.correspondences import NOBODY
from fgpose.geometry.camera import CameraRig
from fgpose.people_observations import Detections
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import ring_rig


@pytest.fixture(scope="module")
def three() -> CameraRig:
    return ring_rig(3)


def pose_of(positions_m: np.ndarray) -> PoseFilters:
    return PoseFilters.at(0.0, positions_m, np.tile(1e-3 * np.eye(3), (len(positions_m), 1, 1)))


def middle_m(positions_m: np.ndarray) -> np.ndarray:
    return np.median(positions_m, axis=0)


@pytest.mark.parametrize("seed", range(3))
def test_two_people_are_found_once_each(three: CameraRig, skeleton: Skeleton, seed: int) -> None:
    rng = np.random.default_rng(seed)
    people_m = [body_m(skeleton, (0.0, -0.5)), body_m(skeleton, (0.3, 0.6))]
    orders = [rng.permutation(2).tolist() for _ in range(3)]
    founded = found(moment_of(three, [[people_m[k] for k in order] for order in orders], rng), None, skeleton)
    assert len(founded) == 2
    for each in founded:
        (who,) = {order[number] for order, number in zip(orders, each.chosen.tolist(), strict=True)}
        error_m = np.linalg.norm(each.pose.positions_m[0] - people_m[who], axis=-1)
        # 3 px are 12 mm at 4.5 m; the worst of 17 joints from three views.
        assert error_m.max() < 0.06


def beside(rig: CameraRig, aside_m: float, skeleton: Skeleton) -> np.ndarray:
    """Somebody beside the plane in the middle between the first two cameras."""
    across = (rig.cameras[0].position_m - rig.cameras[1].position_m)[:2]
    return body_m(skeleton, (aside_m * across / np.linalg.norm(across)).tolist())


def test_rays_of_different_people_are_nobody(three: CameraRig, rig: CameraRig, skeleton: Skeleton) -> None:
    """Cameras at one height see people at one height: a third person could stand where their rays meet."""
    # To the left and right of the plane between the first two cameras: their rays meet in it.
    one_m, other_m = beside(three, 0.3, skeleton), beside(three, -0.3, skeleton)
    rng = np.random.default_rng(0)
    alone = moment_of(three.subset(three.names[:2]), [[one_m], [other_m]], rng)
    # The crossing is as good as a body: two cameras alone cannot tell.
    assert len(found(alone, None, skeleton)) == 1
    # The third camera sees both, and nobody there.
    founded = found(moment_of(three, [[one_m], [other_m], [one_m, other_m]], rng), None, skeleton)
    assert sorted(each.chosen.tolist() for each in founded) == [[NOBODY, 0, 1], [0, NOBODY, 0]]
    # Two that see nobody at all are enough against it.
    one_m, other_m = beside(rig, 0.3, skeleton), beside(rig, -0.3, skeleton)
    assert len(found(moment_of(rig.subset(rig.names[:2]), [[one_m], [other_m]], rng), None, skeleton)) == 1
    assert found(moment_of(rig, [[one_m], [other_m], [], []], rng), None, skeleton) == []


def test_where_the_third_camera_cannot_look_it_tells_nothing(three: CameraRig, skeleton: Skeleton) -> None:
    """Two views of one person; the third camera looks away, or at them."""
    person_m = body_m(skeleton)
    moment = moment_of(three, [[person_m], [person_m], []], np.random.default_rng(0))
    away = three.cameras[2].world_T_camera.copy()
    away[:3, :3] = away[:3, :3] @ np.diag([-1.0, 1.0, -1.0])
    turned = CameraRig((*three.cameras[:2], replace(three.cameras[2], world_T_camera=away)))
    (seen,) = found(replace(moment, cameras=turned), None, skeleton)
    at_most = found(moment, None, skeleton)
    assert not at_most or at_most[0].score < seen.score - 2.0
    np.testing.assert_array_equal(seen.chosen, [0, 0, NOBODY])


def test_who_is_known_may_hide_somebody(three: CameraRig, skeleton: Skeleton) -> None:
    person_m = body_m(skeleton)
    before_m = body_m(skeleton, (0.3 * three.cameras[2].position_m[:2]).tolist())
    behind_m = body_m(skeleton, (-0.3 * three.cameras[2].position_m[:2]).tolist())
    free, hidden, not_hidden = (
        detection_probability(pose_of(person_m), known, three)[0]
        for known in (None, pose_of(before_m), pose_of(behind_m))
    )
    assert hidden[2] < free[2]
    np.testing.assert_array_equal(hidden[:2], free[:2])
    np.testing.assert_array_equal(not_hidden, free)


def test_nobody_is_detected_outside_an_image_or_behind_a_camera(three: CameraRig, skeleton: Skeleton) -> None:
    camera = three.cameras[0]
    behind_m = body_m(skeleton, (1.5 * camera.position_m[:2]).tolist())
    beside_m = body_m(skeleton) + 3.0 * camera.world_T_camera[:3, 0]
    for positions_m in (behind_m, beside_m):
        assert detection_probability(pose_of(positions_m), None, three)[0, 0] == 0.0


def test_parallel_rays_do_not_tell_where(skeleton: Skeleton) -> None:
    """Two cameras a centimetre apart."""
    (camera,) = ring_rig(1).cameras
    beside = camera.world_T_camera.copy()
    beside[:3, 3] += 0.01 * beside[:3, 0]
    rig = CameraRig((camera, replace(camera, name="beside", world_T_camera=beside)))
    assert found(moment_of(rig, [[body_m(skeleton)]] * 2, np.random.default_rng(0)), None, skeleton) == []


def test_rays_that_meet_behind_the_cameras_are_nobody(three: CameraRig, skeleton: Skeleton) -> None:
    """Cameras with their backs to a body, whose lines of sight, prolonged backwards, meet in it."""
    person_m, images, cameras = body_m(skeleton), [], []
    for camera in three.cameras:
        pose = camera.world_T_camera.copy()
        pose[:3, :3] = pose[:3, :3] @ np.diag([-1.0, 1.0, -1.0])
        cameras.append(replace(camera, world_T_camera=pose))
        behind_m = cameras[-1].to_camera_frame(person_m)
        points_px = behind_m[:, :2] / behind_m[:, 2:] * np.diag(camera.K)[:2] + camera.K[:2, 2]
        images.append(Detections(camera.name, 0.0, points_px[None], np.full((1, 17), 0.9)))
    assert found(Moment.of(images, CameraRig(tuple(cameras))), None, skeleton) == []


@pytest.mark.parametrize("n", [1, 2, 4])
def test_nobody_is_found_in_empty_images(n: int, skeleton: Skeleton) -> None:
    rig = ring_rig(n)
    moment = moment_of(rig, [[]] * n, np.random.default_rng(0))
    assert found(moment, None, skeleton) == []
    nothing = [Detections(name, 0.0, np.full((2, 17, 2), np.nan), np.zeros((2, 17))) for name in rig.names]
    assert found(Moment.of(nothing, rig), None, skeleton) == []


def crowded(rig: CameraRig, n: int, rng: np.random.Generator, person_m: np.ndarray | None) -> Moment:
    """Candidates anywhere in every image; the person, if there is one, is surer than they."""
    images = []
    for c, name in enumerate(rig.names):
        points_px = rng.uniform(0, 1000, (n, 1, 2)) + rng.normal(scale=60.0, size=(n, 17, 2))
        confidence = np.full((n, 17), 0.3)
        if person_m is not None:
            points_px[n // 2], confidence[n // 2] = image(rig, c, 0.0, [person_m], rng).points2d_px[0], 0.9
        images.append(Detections(name, 0.0, points_px, confidence))
    return Moment.of(images, rig)


def test_the_pairs_that_are_tried_are_bounded(
    rig: CameraRig, skeleton: Skeleton, monkeypatch: pytest.MonkeyPatch
) -> None:
    """200 candidates in each of four images are 240,000 pairs."""
    tried: list[int] = []
    meeting, best_supported = founding.meeting, founding._best_supported

    def count_meeting(a_m: np.ndarray, *others: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        tried.append(len(a_m))
        return meeting(a_m, *others)

    supported: list[int] = []

    def count_supported(bodies: founding._Bodies, *others: Any) -> founding.Founded:
        supported.append(len(bodies.score))
        return best_supported(bodies, *others)

    monkeypatch.setattr(founding, "meeting", count_meeting)
    monkeypatch.setattr(founding, "_best_supported", count_supported)
    person_m = body_m(skeleton)
    founded = found(crowded(rig, 200, np.random.default_rng(0), person_m), None, skeleton)
    np.testing.assert_array_equal(founded[0].chosen, 100)
    # 12 of each image: six pairs of cameras with 144 pairs each, and no round without somebody found but the last.
    assert max(tried) <= 6 * 12**2
    assert len(tried) <= len(founded) + 1
    assert max(supported) <= 12


def test_all_candidates_at_one_place_are_one(rig: CameraRig, skeleton: Skeleton) -> None:
    moment = moment_of(rig, [[body_m(skeleton)] * 12] * 4, np.random.default_rng(0))
    assert len(found(moment, None, skeleton)) == 1


@pytest.mark.parametrize(
    "skeleton_of",
    [
        lambda whole: Skeleton("points", whole.joints, (), (0,)),
        lambda whole: Skeleton("without sides", whole.joints, whole.bones, (0,)),
    ],
)
def test_bones_and_sides_are_not_needed(skeleton_of, rig: CameraRig, skeleton: Skeleton) -> None:
    moment = moment_of(rig, [[body_m(skeleton)]] * 4, np.random.default_rng(0))
    assert len(found(moment, None, skeleton_of(skeleton))) == 1


def test_some_joints_are_enough(rig: CameraRig, skeleton: Skeleton) -> None:
    """The same six in every view."""
    person_m, rng = body_m(skeleton), np.random.default_rng(0)
    images: Sequence[Detections] = [image(rig, c, 0.0, [person_m], rng) for c in range(4)]
    confidence = np.where(np.arange(17) < 6, 0.9, 0.0)[None]
    known = [Detections(each.camera, 0.0, each.points2d_px, confidence) for each in images]
    (founded,) = found(Moment.of(known, rig), None, skeleton)
    assert np.isfinite(founded.pose.mean).all()
    sigma_m = np.sqrt(founded.pose.covariance[0, :, 0, 0])
    # Nobody has seen the others: they are somewhere around the body.
    assert sigma_m[:6].max() < 0.1 < 0.3 < sigma_m[6:].min()


def test_one_camera_guesses_the_distance_by_the_size(skeleton: Skeleton) -> None:
    rig = ring_rig(1)
    person_m, rng = body_m(skeleton), np.random.default_rng(0)
    (founded,) = found_alone(moment_of(rig, [[person_m]], rng))
    np.testing.assert_allclose(
        rig.cameras[0].project(founded.pose.positions_m[0]), rig.cameras[0].project(person_m), atol=20.0
    )
    # People are of different size, and the box is that of the joints, not of the head and the feet.
    assert np.linalg.norm(middle_m(founded.pose.positions_m[0]) - middle_m(person_m)) < 1.0


def test_one_camera_leaves_out_who_is_hardly_seen(skeleton: Skeleton) -> None:
    rig = ring_rig(1)
    seen = image(rig, 0, 0.0, [body_m(skeleton)] * 2)
    confidence = np.stack([np.where(np.arange(17) < 3, 0.9, 0.0), np.full(17, 0.9)])
    (founded,) = found_alone(Moment.of([Detections(seen.camera, 0.0, seen.points2d_px, confidence)], rig))
    np.testing.assert_array_equal(founded.chosen, [1])


def test_who_are_followed_in_one_view_each_are_not_found_anew(three: CameraRig, skeleton: Skeleton) -> None:
    moment = moment_of(three, [[body_m(skeleton)]] * 3, np.random.default_rng(0))
    followed = np.array([[True], [True], [False]])
    assert found(moment, None, skeleton, of_one_view=np.ones((3, 1), dtype=bool)) == []
    (founded,) = found(moment, None, skeleton, of_one_view=followed)
    np.testing.assert_array_equal(founded.chosen, [0, 0, 0])
