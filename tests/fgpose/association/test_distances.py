"""Per-view 3D tells how far people are: who is who on one ray, and where somebody is whom one camera alone sees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from rooms import FPS, body_m, image, moment_of, people_of

from fgpose.association.follow import Follower
from fgpose.association.founding import found, found_alone
from fgpose.association.likelihood import Distances, log_ratio_of
from fgpose.association.matching import Moment, match
from fgpose.association.pose_filter import SIGMA_M, PoseFilters, RayResidual
from fgpose.correspondences import NOBODY
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.people_observations import Detections
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import ring_rig

SIGMA = 0.03
"""Of the distances, over the distance; all joints of a person in an image have the same error."""


def with_3d(seen: Detections, camera: Camera, people_m: Sequence[np.ndarray], scale: float = 1.0) -> Detections:
    """The same detections with the distances of these people, times a factor, and no covariance."""
    rays = camera.ray(camera.undistort(seen.points2d_px))
    distance_m = np.linalg.norm(np.array(people_m).reshape(*rays.shape) - camera.position_m, axis=-1)
    return replace(seen, points3d_m=camera.position_m + scale * distance_m[..., None] * rays)


def images_in_3d(
    rig: CameraRig, time_s: float, seen_m: Sequence[Sequence[np.ndarray]], rng: np.random.Generator
) -> list[Detections]:
    """Of the people whom each camera detects, with errors of the distances."""
    return [
        with_3d(image(rig, c, time_s, people_m, rng), rig.cameras[c], people_m, 1 + SIGMA * rng.standard_normal())
        for c, people_m in enumerate(seen_m)
    ]


def behind(camera: Camera, person_m: np.ndarray, scale: float) -> np.ndarray:
    """Somebody larger whom the camera sees at the same pixels."""
    return camera.position_m + scale * (person_m - camera.position_m)


def known_to(sigma_m: float, *people_m: np.ndarray) -> PoseFilters:
    covariance_m2 = np.tile(sigma_m**2 * np.eye(3), (len(people_m[0]), 1, 1))
    return PoseFilters.stacked([PoseFilters.at(0.0, person_m, covariance_m2) for person_m in people_m])


def test_the_joints_of_a_view_are_one_measurement() -> None:
    """The error is that of all; anybody else is somewhere from the camera to twice as far."""
    for n_joints in (1, 4, 17):
        log_ratio = log_ratio_of(np.full(n_joints, 0.3), np.full(n_joints, 0.2**2), np.full(n_joints, 4.0))
        log_normal = -0.5 * (0.3 / 0.2) ** 2 - np.log(0.2 * np.sqrt(2 * np.pi))
        np.testing.assert_allclose(log_ratio, log_normal - np.log(1 / 8.0))
    unknown = np.array([0.3, np.nan, np.nan])
    np.testing.assert_allclose(log_ratio_of(unknown, np.full(3, 0.04), np.full(3, 4.0)), log_ratio)
    assert np.isnan(log_ratio_of(np.full(3, np.nan), np.full(3, 0.04), np.full(3, 4.0)))


def test_distances_without_covariance_err_by_a_share(rig: CameraRig, skeleton: Skeleton) -> None:
    person_m, rng = body_m(skeleton), np.random.default_rng(0)
    one, other, without = images_in_3d(rig, 0.0, [[person_m]] * 3, rng)
    stated = replace(other, covariance3d_m2=np.tile(0.2**2 * np.eye(3), (1, skeleton.n_joints, 1, 1)))
    distances = Distances.of([one, stated, replace(without, points3d_m=None)], rig.subset(rig.names[:3]))
    assert distances is not None
    distance_m = distances.distance_m[0]
    np.testing.assert_allclose(distances.variance_m2[0], (0.043 * distance_m) ** 2 + SIGMA_M**2)
    np.testing.assert_allclose(distances.variance_m2[1], 0.2**2 + SIGMA_M**2)
    assert np.isnan(distances.distance_m[2]).all()


def test_an_update_with_distances_is_that_of_kalman(rig: CameraRig, skeleton: Skeleton) -> None:
    """As a third row of the measurement; the images are old, so that they tell of the velocity."""
    people, rng = known_to(0.1, body_m(skeleton)), np.random.default_rng(0)
    expected = people.seen_by(rig, np.array([0.0, -0.01, -0.05, -0.2]))
    residual_px = rng.normal(scale=10.0, size=expected.pixels.shape)
    residual_m = rng.normal(scale=0.1, size=expected.sigma_px.shape)
    residual_m[2, 0, 3] = np.nan
    information = rng.uniform(10.0, 100.0, residual_m.shape)
    weight = rng.uniform(0.1, 1.0, residual_m.shape)
    updated = people.updated(residual_px, expected, weight, RayResidual(residual_m, information))
    for j in range(skeleton.n_joints):
        mean, P = people.mean[0, j].copy(), people.covariance[0, j].copy()
        for c, ago_s in enumerate(expected.ago_s[:, 0, 0]):
            rows, residual = list(expected.jacobian[c, 0, j]), list(residual_px[c, 0, j])
            variance = [expected.sigma_px[c, 0, j] ** 2 / weight[c, 0, j]] * 2
            if np.isfinite(residual_m[c, 0, j]):
                to_joint_m = people.positions_m[0, j] - rig.cameras[c].position_m
                rows, residual = [*rows, to_joint_m / np.linalg.norm(to_joint_m)], [*residual, residual_m[c, 0, j]]
                variance.append(1 / (weight[c, 0, j] * information[c, 0, j]))
            H = np.hstack([rows, ago_s * np.array(rows)])
            gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.diag(variance))
            mean = mean + gain @ (residual - H @ (mean - people.mean[0, j]))
            P = (np.eye(6) - gain @ H) @ P
        # Two ways to invert matrices whose condition is about 1e4.
        np.testing.assert_allclose(updated.mean[0, j], mean, atol=1e-9)
        np.testing.assert_allclose(updated.covariance[0, j], P, atol=1e-10)


def test_people_at_the_same_pixels_are_told_apart(rig: CameraRig, skeleton: Skeleton) -> None:
    """In one camera; each detection is given to the person at its distance, in whatever order."""
    camera, near_m = rig.cameras[0], body_m(skeleton)
    far_m = behind(camera, near_m, 1.2)
    expected = known_to(0.05, near_m, far_m).seen_by(rig.subset(rig.names[:1]), np.zeros(1))
    no_mirror = np.zeros((1, 2, 2), dtype=int)
    for order in ([near_m, far_m], [far_m, near_m]):
        moment = Moment.of(images_in_3d(rig.subset(rig.names[:1]), 0.0, [order], np.random.default_rng(0)), rig)
        chosen = match(moment.likelihood(expected), no_mirror, np.ones(2), skeleton.mirror).chosen
        np.testing.assert_array_equal(chosen, [[0, 1] if order[0] is near_m else [1, 0]])


def test_who_stands_behind_somebody_is_somebody_else(skeleton: Skeleton) -> None:
    """Two people at the same pixels of the only camera: both are found, and each stays where they are."""
    rig = ring_rig(1)
    follower, rng = Follower(rig, skeleton), np.random.default_rng(0)
    near_m = body_m(skeleton)
    people_m = [near_m, behind(rig.cameras[0], near_m, 1.25)]
    for time_s in np.arange(0.0, 1.0, 1 / FPS).tolist():
        follower.see(images_in_3d(rig, time_s, [[people_m[k] for k in rng.permutation(2)]], rng))
    assert people_of(follower) == [0, 1]
    distance_m = sorted(float(np.linalg.norm(track.middle_m - rig.cameras[0].position_m)) for track in follower.tracks)
    true_m = [np.linalg.norm(np.median(person_m, axis=0) - rig.cameras[0].position_m) for person_m in people_m]
    # An image errs by 3 % (both in the same direction here), of which the filter takes the mean of some.
    np.testing.assert_allclose(distance_m, true_m, rtol=0.06)


def test_a_wrong_distance_loses_nobody(rig: CameraRig, skeleton: Skeleton) -> None:
    """As that of a child, if a network takes everybody for an adult."""
    person_m, rng = body_m(skeleton), np.random.default_rng(0)
    for n_cameras in (2, 4):
        seen_by = rig.subset(rig.names[:n_cameras])
        follower = Follower(seen_by, skeleton)
        for time_s in np.arange(0.0, 0.5, 1 / FPS).tolist():
            images = [image(seen_by, c, time_s, [person_m], rng) for c in range(n_cameras)]
            pairs = zip(images, seen_by.cameras, strict=True)
            follower.see([with_3d(each, camera, [person_m], 1.4) for each, camera in pairs])
        assert people_of(follower) == [0]
        assert set(follower.tracks[0].shown_s) == set(seen_by.names)
        # 3 px are 12 mm, and the joints have the wrong distances with the little weight that is left to these.
        assert np.linalg.norm(follower.tracks[0].pose.positions_m[0] - person_m, axis=-1).max() < 0.1


@pytest.mark.parametrize("in_3d", [True, False])
def test_one_camera_alone_confirms_whom_it_sees_in_3d(in_3d: bool, rig: CameraRig, skeleton: Skeleton) -> None:
    """Within 0.3 s where the other cameras look elsewhere; never without the distance."""
    person_m, rng = body_m(skeleton), np.random.default_rng(0)
    away = [replace(camera, world_T_camera=camera.world_T_camera @ np.diag([-1.0, 1, -1, 1])) for camera in rig.cameras]
    rig = CameraRig((rig.cameras[0], *away[1:]))
    follower = Follower(rig, skeleton)
    for time_s in np.arange(0.0, 1.0, 1 / FPS).tolist():
        images = images_in_3d(rig, time_s, [[person_m], [], [], []], rng)
        follower.see([each if in_3d else replace(each, points3d_m=None) for each in images])
    if not in_3d:
        assert follower.tracks == []
        return
    assert people_of(follower) == [0]
    (event,) = follower.events
    assert event.time_s <= 0.3
    error_m = np.linalg.norm(follower.tracks[0].middle_m - np.median(person_m, axis=0))
    # 3 % of 4.5 m are 0.14 m.
    assert error_m < 0.25


def test_the_only_camera_confirms_whom_it_sees_in_3d(skeleton: Skeleton) -> None:
    """Where they are; by their size it would be a guess."""
    rig, rng, small_m = ring_rig(1), np.random.default_rng(0), body_m(skeleton, (0.0, 0.0), 0.7)
    (founded,) = found_alone(Moment.of(images_in_3d(rig, 0.0, [[small_m]], rng), rig))
    assert np.linalg.norm(np.median(founded.pose.positions_m[0] - small_m, axis=0)) < 0.3
    follower = Follower(rig, skeleton)
    for time_s in np.arange(0.0, 0.4, 1 / FPS).tolist():
        follower.see(images_in_3d(rig, time_s, [[small_m]], rng))
    (event,) = follower.events
    assert event.time_s <= 0.3


def test_whom_the_other_cameras_should_see_is_nobody(rig: CameraRig, skeleton: Skeleton) -> None:
    """A poster, or a chair, in one camera, with 3D."""
    follower, rng, poster_m = Follower(rig, skeleton), np.random.default_rng(0), body_m(skeleton)
    for time_s in np.arange(0.0, 1.5, 1 / FPS).tolist():
        follower.see(images_in_3d(rig, time_s, [[], [poster_m], [], []], rng))
    assert follower.events == []
    # Also image by image.
    for n in range(100):
        only = rig.subset([rig.names[n % 4]])
        follower.see(images_in_3d(only, 2.0 + n / (4 * FPS), [[poster_m] if n % 4 == 1 else []], rng))
    assert follower.events == []


def test_views_whose_rays_are_parallel_found_somebody_by_their_distances(skeleton: Skeleton) -> None:
    """Two cameras a centimetre apart."""
    (camera,) = ring_rig(1).cameras
    beside = camera.world_T_camera.copy()
    beside[:3, 3] += 0.01 * beside[:3, 0]
    rig = CameraRig((camera, replace(camera, name="beside", world_T_camera=beside)))
    person_m, rng = body_m(skeleton), np.random.default_rng(0)
    assert found(moment_of(rig, [[person_m]] * 2, rng), None, skeleton) == []
    (founded,) = found(Moment.of(images_in_3d(rig, 0.0, [[person_m]] * 2, rng), rig), None, skeleton)
    np.testing.assert_array_equal(founded.chosen, [0, 0])
    # 3 % of 4.5 m are 0.14 m.
    assert np.linalg.norm(np.median(founded.pose.positions_m[0] - person_m, axis=0)) < 0.3


@pytest.mark.parametrize("seed", range(4))
def test_distances_tell_which_rays_meet_in_somebody(rig: CameraRig, skeleton: Skeleton, seed: int) -> None:
    """Two cameras at one height, and two people at the left and the right of the plane between them: the rays to
    different people meet in bodies too, before and behind them."""
    rig = rig.subset(rig.names[:2])
    across = (rig.cameras[0].position_m - rig.cameras[1].position_m)[:2]
    across /= np.linalg.norm(across)
    people_m = [body_m(skeleton, (aside_m * across).tolist()) for aside_m in (0.35, -0.35)]
    rng = np.random.default_rng(seed)
    founded = found(Moment.of(images_in_3d(rig, 0.0, [people_m, people_m], rng), rig), None, skeleton)
    assert sorted(each.chosen.tolist() for each in founded) == [[0, 0], [1, 1]]


def test_detections_without_enough_distances_found_nobody(rig: CameraRig, skeleton: Skeleton) -> None:
    """Three joints are no body."""
    person_m, rng = body_m(skeleton), np.random.default_rng(0)
    (seen,) = images_in_3d(rig.subset(rig.names[:1]), 0.0, [[person_m]], rng)
    assert seen.points3d_m is not None
    points3d_m = np.where((np.arange(skeleton.n_joints) < 3)[:, None], seen.points3d_m, np.nan)
    moment = Moment.of([replace(seen, points3d_m=points3d_m)], rig)
    assert moment.tells_distance.sum() == 3
    assert found(moment, None, skeleton) == []


def test_what_an_image_shows_of_a_person_has_their_3d(rig: CameraRig, skeleton: Skeleton) -> None:
    people_m, rng = [body_m(skeleton, (0.0, -0.6)), body_m(skeleton, (0.2, 0.7))], np.random.default_rng(0)
    follower = Follower(rig, skeleton)
    follower.see(images_in_3d(rig, 0.0, [people_m] * 4, rng))
    (sighting, *_) = follower.see(images_in_3d(rig, 1 / FPS, [people_m[::-1]] * 4, rng))
    shown = {track: sighting.image.of_person(detection, joint) for track, detection, joint in sighting.joints()}
    assert len(shown) == 2
    image_m = sighting.image.points3d_m
    assert image_m is not None
    for k, own in enumerate(sighting.matches.chosen[0]):
        assert own != NOBODY
        of_track = shown[int(sighting.tracks[k])]
        np.testing.assert_array_equal(of_track["points3d_m"], image_m[own])
        assert "covariance3d_m2" not in of_track
