"""Whom a detection fits: the right person most, also with left and right exchanged, or with joints missing."""

from __future__ import annotations

import numpy as np
import pytest
from rooms import body_m, moment_of

from fgpose.association.likelihood import Likelihood
from fgpose.association.pose_filter import Expected, PoseFilters
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton

PLACES_M = ((0.0, -0.5), (0.3, 0.4), (-0.8, 0.2))


@pytest.fixture(scope="module")
def people_m(skeleton: Skeleton) -> list[np.ndarray]:
    return [body_m(skeleton, place_m) for place_m in PLACES_M]


@pytest.fixture(scope="module")
def expected(people_m: list[np.ndarray], rig: CameraRig) -> Expected:
    """Known to 3 cm, at rest."""
    known_m2 = np.tile(0.03**2 * np.eye(3), (len(people_m[0]), 1, 1))
    people = PoseFilters.stacked([PoseFilters.at(0.0, person_m, known_m2) for person_m in people_m])
    return people.seen_by(rig, np.zeros(rig.n_cameras))


@pytest.fixture
def points_px(people_m: list[np.ndarray], rig: CameraRig) -> np.ndarray:
    """(C, P, J, 2) in the order of the people."""
    return moment_of(rig, [people_m] * rig.n_cameras, np.random.default_rng(0)).points_px


def test_the_right_person_is_the_most_probable(expected: Expected, points_px: np.ndarray, rig: CameraRig) -> None:
    likelihood = Likelihood.of(expected, points_px, rig)
    for of_camera, fits in zip(likelihood.score, likelihood.fits, strict=True):
        np.testing.assert_array_equal(of_camera.argmax(axis=0), range(len(PLACES_M)))
        np.testing.assert_array_equal(of_camera.argmax(axis=1), range(len(PLACES_M)))
        assert (np.diag(of_camera) > 0).all()
        np.testing.assert_array_equal(np.diag(fits), True)


def test_the_log_ratio_is_that_of_the_densities(expected: Expected, points_px: np.ndarray, rig: CameraRig) -> None:
    likelihood = Likelihood.of(expected, points_px, rig)
    for c, k, p, j in ((0, 0, 0, 3), (1, 2, 1, 0), (3, 1, 1, 16)):
        away_px, covariance_px2 = points_px[c, p, j] - expected.pixels[c, k, j], expected.covariance_px2[c, k, j]
        log_normal = -0.5 * away_px @ np.linalg.inv(covariance_px2) @ away_px
        log_normal -= 0.5 * np.log(np.linalg.det(2 * np.pi * covariance_px2))
        of_image = -np.log(1000.0 * 1000.0)
        assert likelihood.log_ratio[c, k, p, j] == pytest.approx(log_normal - of_image)
        # Bayes with a tenth of wrong joints, which are somewhere in a square metre.
        near_px2 = (expected.sigma_px[c, k, j] / 0.04) ** 2
        odds = 9.0 * np.exp(log_normal) * near_px2
        assert likelihood.probability[c, k, p, j] == pytest.approx(odds / (1 + odds))


def test_who_is_a_metre_away_does_not_fit(expected: Expected, points_px: np.ndarray, rig: CameraRig) -> None:
    """At 4.5 m a metre is 250 px, 20 times as far as the detections err."""
    likelihood = Likelihood.of(expected, points_px + np.array([250.0, 0.0]), rig)
    own = np.arange(len(PLACES_M))
    assert (likelihood.score[:, own, own] < 0).all()
    assert not likelihood.fits[:, own, own].any()
    assert (likelihood.probability[:, own, own] < 1e-3).all()


def test_some_wrong_joints_are_forgiven(expected: Expected, points_px: np.ndarray, rig: CameraRig) -> None:
    points_px[..., :3, :] += 200.0
    likelihood = Likelihood.of(expected, points_px, rig)
    own = np.arange(len(PLACES_M))
    assert (likelihood.score[:, own, own] > 0).all()
    assert (likelihood.probability[:, own, own, :3] < 0.01).all()
    assert (likelihood.probability[:, own, own, 3:] > 0.5).all()


def test_a_mirrored_detection_is_recognised(
    expected: Expected, points_px: np.ndarray, rig: CameraRig, skeleton: Skeleton
) -> None:
    """That of the second person in the first two views; the others are left as they are."""
    straight = points_px.copy()
    points_px[:2, 1] = points_px[:2, 1][:, skeleton.mirror]
    as_detected = Likelihood.of(expected, points_px, rig)
    likelihood, sides = as_detected.mirrored_where_better(expected, points_px, rig, skeleton.mirror)
    own = np.arange(len(PLACES_M))
    assert (sides[:2, 1, 1] == 1).all()
    assert (sides[:, own, own] == 1).sum() == 2
    # Of the others, none is more probable with left and right exchanged.
    assert (sides[:, own, own] == -1).any()
    truth = Likelihood.of(expected, straight, rig)
    np.testing.assert_allclose(likelihood.score[:, own, own], truth.score[:, own, own])
    np.testing.assert_allclose(likelihood.log_ratio[:, own, own], truth.log_ratio[:, own, own])


def test_without_sides_nothing_is_mirrored(expected: Expected, points_px: np.ndarray, rig: CameraRig) -> None:
    as_detected = Likelihood.of(expected, points_px, rig)
    _, sides = as_detected.mirrored_where_better(expected, points_px, rig, np.arange(points_px.shape[2]))
    assert not sides.any()


def test_missing_joints_tell_nothing(expected: Expected, points_px: np.ndarray, rig: CameraRig) -> None:
    whole = Likelihood.of(expected, points_px, rig)
    points_px[:, :, 8:] = np.nan
    likelihood = Likelihood.of(expected, points_px, rig)
    assert (likelihood.probability[..., 8:] == 0).all()
    own = np.arange(len(PLACES_M))
    np.testing.assert_array_equal(likelihood.score.argmax(axis=1), np.tile(own, (rig.n_cameras, 1)))
    assert likelihood.fits[:, own, own].all()
    np.testing.assert_array_equal(likelihood.log_ratio[..., :8], whole.log_ratio[..., :8])


def test_a_single_joint_and_no_joint_are_nobody_s(expected: Expected, points_px: np.ndarray, rig: CameraRig) -> None:
    points_px[:, 0, 1:] = np.nan
    points_px[:, 1] = np.nan
    likelihood = Likelihood.of(expected, points_px, rig)
    assert (likelihood.score[:, :, :2] == -np.inf).all()
    assert not likelihood.fits[:, :, :2].any()
    assert np.isfinite(likelihood.score[:, 2, 2]).all()


def test_more_joints_tell_no_more_than_so_many_independent_ones(
    expected: Expected, points_px: np.ndarray, rig: CameraRig
) -> None:
    """The joints of an image share their errors: twice as many are not twice as sure."""
    few = points_px.copy()
    few[:, :, 6:] = np.nan
    own = np.arange(len(PLACES_M))
    whole = Likelihood.of(expected, points_px, rig).score[:, own, own]
    np.testing.assert_allclose(Likelihood.of(expected, few, rig).score[:, own, own], whole, rtol=0.3)


def test_nobody_is_expected_behind_a_camera(skeleton: Skeleton, points_px: np.ndarray, rig: CameraRig) -> None:
    """And one who stands in the plane of a camera's centre is not expected anywhere in particular."""
    camera = rig.cameras[0]
    forward, right = camera.world_T_camera[:3, 2], camera.world_T_camera[:3, 0]
    known_m2 = np.tile(0.03**2 * np.eye(3), (skeleton.n_joints, 1, 1))
    for depth_m in (-2.0, 0.0, 1e-5, 1e-3):
        at_m = camera.position_m + depth_m * forward + np.linspace(0.1, 0.5, skeleton.n_joints)[:, None] * right
        expected = PoseFilters.at(0.0, at_m, known_m2).seen_by(rig, np.zeros(rig.n_cameras))
        likelihood = Likelihood.of(expected, points_px, rig)
        assert not (likelihood.score[0] > 0).any()
        assert np.isfinite(likelihood.probability).all()


def test_images_without_detections(expected: Expected, rig: CameraRig) -> None:
    likelihood = Likelihood.of(expected, np.zeros((rig.n_cameras, 0, expected.pixels.shape[2], 2)), rig)
    assert likelihood.score.shape == (rig.n_cameras, len(PLACES_M), 0)
    assert likelihood.fits.shape == (rig.n_cameras, len(PLACES_M), 0)
