from __future__ import annotations

import gtsam
import numpy as np
import pytest
from adjusted_rigs import moved

from fgpose.assessment.rig_alignment import Similarity
from fgpose.calibration.from_people.verdict.alignment import about_centroid, aligned, point_about_centroid
from fgpose_benchmarks.synthetic import ring_rig

RIG = ring_rig(4)
FAR = Similarity(0.4, np.array(gtsam.Rot3.Expmap(np.array([1.0, -2.0, 0.5])).matrix()), np.array([3.0, -7.0, 1.0]))


@pytest.mark.parametrize("n_cameras", [2, 3, 4, 8])
def test_a_rig_in_another_gauge_is_laid_on_itself(n_cameras: int) -> None:
    rig = ring_rig(n_cameras)
    similarity, errors = aligned(FAR.rig(rig), rig)
    assert np.abs(errors).max() < 1e-9  # rounding
    assert similarity.scale == pytest.approx(1 / 0.4)


def test_the_images_of_moved_points_stay() -> None:
    points_m = np.random.default_rng(0).uniform(-1, 1, (20, 3))
    assert FAR.rig(RIG).project(FAR.of(points_m)) == pytest.approx(RIG.project(points_m), abs=1e-9)


@pytest.mark.slow
def test_what_is_left_of_errors_is_what_the_covariance_says() -> None:
    rng = np.random.default_rng(1)
    root = 1e-3 * rng.standard_normal((24, 24)) / 5
    covariance = (root @ root.T).reshape(4, 6, 4, 6)
    left = []
    for _ in range(200):
        errors = (root @ rng.standard_normal(24)).reshape(4, 6)
        left.append(aligned(FAR.rig(moved(RIG, errors)), RIG)[1])
    stated = np.einsum("cici->ci", about_centroid(covariance, RIG))
    # 200 draws give a variance to 10 %; four of them, for 24 numbers. Their own spread is far larger.
    assert np.var(left, axis=0) == pytest.approx(stated, rel=0.4)


def test_a_similarity_leaves_no_error() -> None:
    rng = np.random.default_rng(2)
    tilt = Similarity(1.001, np.array(gtsam.Rot3.Expmap(1e-4 * rng.standard_normal(3)).matrix()), 1e-3 * np.ones(3))
    assert np.abs(aligned(tilt.rig(RIG), RIG)[1]).max() < 1e-9
    # And what such similarities do has no covariance: that of a common shift along x.
    shift = np.concatenate([np.concatenate([np.zeros(3), camera.world_T_camera[0, :3]]) for camera in RIG.cameras])
    assert np.abs(about_centroid(np.outer(shift, shift).reshape(4, 6, 4, 6), RIG)).max() < 1e-12


def test_the_camera_that_is_held_does_not_look_perfect() -> None:
    covariance = np.einsum("cd,ij->cidj", np.diag([0.0, 1.0, 1.0, 1.0]), np.eye(6)) * 1e-6
    stated = np.einsum("cici->c", about_centroid(covariance, RIG))
    assert stated[0] > 0.2 * stated[1:].mean()


@pytest.mark.slow
def test_a_point_is_off_as_its_covariance_says_after_the_cameras_are_laid_on_each_other() -> None:
    rng, point_m = np.random.default_rng(2), np.array([0.5, -1.0, 0.9])
    root = 1e-3 * rng.standard_normal((27, 27)) / 5
    left_m = []
    for _ in range(200):
        errors = root @ rng.standard_normal(27)
        similarity = aligned(moved(RIG, errors[:24].reshape(4, 6)), RIG)[0]
        left_m.append(similarity.of(point_m + errors[24:]) - point_m)
    stated = np.diag(point_about_centroid(root @ root.T, RIG, point_m))
    # 200 draws give a variance to 10 %; three of them, for three numbers.
    assert np.var(left_m, axis=0) == pytest.approx(stated, rel=0.3)
