from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgpose.config import Config, FusionConfig
from fgpose.estimation.evidence.fusion import fuse
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate_robust
from fgpose.observations import Observations
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import Scene, ring_rig

NAN = np.nan


def literally(observations: Observations, rig: CameraRig, exponent: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Eq. 1 and 2 of the paper, symbol by symbol; a sum over C views becomes one over the views that have the joint."""
    candidates, detections = observations.points3d_m, rig.undistort(observations.points2d_px)
    assert candidates is not None
    T, C, J, _ = candidates.shape
    e, w, fused = np.full((T, C, J), NAN), np.zeros((T, C, J)), np.full((T, J, 3), NAN)
    for t in range(T):
        for j in range(J):
            for i in range(C):
                P_hat, terms = candidates[t, i, j], []
                for k in range(C):
                    p, camera = detections[t, k, j], rig.cameras[k]
                    if np.isnan(P_hat).any() or np.isnan(p).any():
                        continue
                    R, t_m = camera.camera_T_world[:3, :3], camera.camera_T_world[:3, 3]
                    u = camera.K @ (R @ P_hat + t_m)
                    norm = np.linalg.norm(u[:2] / u[2] - p)
                    terms.append(norm**2 if exponent == "squared" else norm)
                if terms:
                    e[t, i, j] = sum(terms) / len(terms)
                    w[t, i, j] = 1 / e[t, i, j]
            if w[t, :, j].sum() > 0:
                fused[t, j] = sum(w[t, i, j] * np.nan_to_num(candidates[t, i, j]) for i in range(C)) / w[t, :, j].sum()
    return fused, w, e


@pytest.fixture(scope="module")
def observations(walking_scene: Scene) -> Observations:
    return walking_scene.observations.frames(slice(0, 6))


@pytest.mark.parametrize("exponent", ["squared", "unsquared"])
def test_is_equations_1_and_2_word_by_word(observations, rig, exponent):
    fusion = fuse(observations, rig, Config(fusion=FusionConfig(exponent=exponent)))
    fused_m, weights, errors = literally(observations, rig, exponent)
    np.testing.assert_allclose(fusion.positions_m, fused_m, atol=1e-12)
    np.testing.assert_allclose(fusion.weights, weights, rtol=1e-9)
    np.testing.assert_allclose(fusion.reprojection_px2, errors, rtol=1e-9)


@pytest.mark.parametrize("exponent", ["squared", "unsquared"])
def test_is_equations_1_and_2_where_views_and_joints_are_missing(mocap_scene, rig, exponent):
    observations = mocap_scene.observations.frames(slice(0, 150, 30))
    assert not observations.seen.all()
    fusion = fuse(observations, rig, Config(fusion=FusionConfig(exponent=exponent)))
    fused_m, weights, errors = literally(observations, rig, exponent)
    np.testing.assert_allclose(fusion.positions_m, fused_m, atol=1e-12)
    np.testing.assert_allclose(fusion.weights, weights, rtol=1e-9)
    np.testing.assert_allclose(fusion.reprojection_px2, errors, rtol=1e-9)


def test_the_full_error_tells_which_view_contradicts_which(observations, rig):
    fusion = fuse(observations, rig)
    candidates_m = observations.points3d_m
    for candidate, view in np.ndindex(4, 4):
        projected_px = rig.cameras[view].project(candidates_m[:, candidate])
        expected = np.sum((projected_px - observations.points2d_px[:, view]) ** 2, axis=-1)
        np.testing.assert_allclose(fusion.reprojection_by_view_px2[:, candidate, view], expected, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(fusion.reprojection_by_view_px2.mean(axis=2), fusion.reprojection_px2, rtol=1e-12)


def test_without_errors_the_fused_pose_is_the_truth(walking_scene, rig):
    truth_m = walking_scene.truth_m[:3]
    observations = Observations(
        walking_scene.observations.skeleton,
        np.arange(3.0),
        rig.project(truth_m),
        points3d_m=np.repeat(truth_m[:, None], 4, axis=1),
        camera_names=rig.names,
    )
    fusion = fuse(observations, rig)
    np.testing.assert_allclose(fusion.positions_m, truth_m, atol=1e-12)
    assert np.isfinite(fusion.weights).all()


def test_a_bad_view_gets_the_lowest_weight_joint_by_joint(observations, rig):
    points3d_m = observations.points3d_m.copy()
    clean = fuse(observations, rig)
    wrist, ankle = 13, 6
    points3d_m[:, 2, wrist] += (0.4, 0.3, 0.0)
    points3d_m[:, 0, ankle] += (-0.4, 0.3, 0.2)
    fusion = fuse(replace(observations, points3d_m=points3d_m), rig)
    assert (fusion.weights[:, :, wrist].argmin(axis=1) == 2).all()
    assert (fusion.weights[:, :, ankle].argmin(axis=1) == 0).all()
    untouched = [joint for joint in range(17) if joint not in (wrist, ankle)]
    np.testing.assert_array_equal(fusion.weights[:, :, untouched], clean.weights[:, :, untouched])


def test_the_squared_error_trusts_the_best_view_more(observations, rig):
    def share_of_best(exponent: str) -> float:
        config = Config(fusion=FusionConfig(exponent=exponent))  # pyrefly: ignore[bad-argument-type]
        weights = fuse(observations, rig, config).weights
        return float((weights.max(axis=1) / weights.sum(axis=1)).mean())

    assert share_of_best("squared") > share_of_best("unsquared") > 0.25


def test_a_joint_without_3d_is_triangulated(observations, rig):
    points3d_m = observations.points3d_m.copy()
    points3d_m[:, :, 10] = NAN
    fusion = fuse(replace(observations, points3d_m=points3d_m), rig)
    triangulated_m = triangulate_robust(observations.points2d_px, observations.confidence, rig).positions_m
    np.testing.assert_allclose(fusion.positions_m[:, 10], triangulated_m[:, 10], atol=1e-12)
    others = [joint for joint in range(17) if joint != 10]
    np.testing.assert_array_equal(fusion.positions_m[:, others], fuse(observations, rig).positions_m[:, others])


def test_a_recording_without_3d_is_triangulated_and_weighed_by_its_own_error(walking_scene, rig):
    observations = replace(walking_scene.observations.frames(slice(0, 6)), points3d_m=None)
    fusion = fuse(observations, rig)
    triangulated_m = triangulate_robust(observations.points2d_px, observations.confidence, rig).positions_m
    np.testing.assert_allclose(fusion.positions_m, triangulated_m, atol=1e-12)
    squared_px2 = np.sum((rig.project(triangulated_m) - observations.points2d_px) ** 2, axis=-1)
    np.testing.assert_allclose(fusion.reprojection_px2, squared_px2, rtol=1e-9)
    np.testing.assert_allclose(fusion.weights, 1 / np.maximum(squared_px2, 1e-4), rtol=1e-9)
    for candidate in range(4):
        np.testing.assert_array_equal(fusion.reprojection_by_view_px2[:, candidate], squared_px2)


def test_a_candidate_that_no_view_can_check_counts_when_it_is_all_there_is(observations, rig):
    points2d_px, points3d_m = observations.points2d_px.copy(), observations.points3d_m.copy()
    points2d_px[0, :, 4] = NAN
    points3d_m[0, 1:, 4] = NAN
    # an unchecked candidate beside checked ones has no weight
    points2d_px[1, :, 5] = NAN
    fusion = fuse(replace(observations, points2d_px=points2d_px, points3d_m=points3d_m), rig)
    np.testing.assert_allclose(fusion.positions_m[0, 4], points3d_m[0, 0, 4], atol=1e-12)
    assert np.isnan(fusion.reprojection_px2[0, :, 4]).all()
    # it weighs as one that is off by inlier_px would, in the unit of the weights
    np.testing.assert_allclose(fusion.weights[0, :, 4], [1 / 20.0**2, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(fusion.positions_m[1, 5], points3d_m[1, :, 5].mean(axis=0), atol=1e-12)


def test_what_nobody_has_is_nan(observations, rig):
    points2d_px, points3d_m = observations.points2d_px.copy(), observations.points3d_m.copy()
    points2d_px[2, :, 7] = NAN
    points3d_m[2, :, 7] = NAN
    fusion = fuse(replace(observations, points2d_px=points2d_px, points3d_m=points3d_m), rig)
    assert np.isnan(fusion.positions_m[2, 7]).all()
    assert np.isnan(fusion.reprojection_px2[2, :, 7]).all()
    np.testing.assert_array_equal(fusion.weights[2, :, 7], 0.0)
    assert np.isfinite(fusion.positions_m[2, :7]).all()


def test_cameras_that_differ_are_refused(observations: Observations, skeleton: Skeleton):
    renamed = replace(observations, camera_names=("a", "b", "c", "d"))
    with pytest.raises(ValueError, match="lacks camera a, b, c, d"):
        fuse(renamed, ring_rig())


BY_COVARIANCE = Config(fusion=FusionConfig(mean="covariance"))


def test_the_mean_by_covariance_is_wrong_in_depth_by_less_than_each_view(walking_scene, rig):
    observations = walking_scene.observations
    truth_m = walking_scene.truth_m
    by_covariance = np.linalg.norm(fuse(observations, rig, BY_COVARIANCE).positions_m - truth_m, axis=-1).mean()
    by_reprojection = np.linalg.norm(fuse(observations, rig).positions_m - truth_m, axis=-1).mean()
    # depth is off by 15 cm or more in each view, sideways by 2 cm; four views at right angles leave about 2 cm
    assert by_covariance < 0.03
    assert by_covariance < 0.6 * by_reprojection


def test_the_mean_of_two_views_by_covariance_has_each_coordinate_from_the_view_that_knows_it(skeleton):
    rig = ring_rig(2)
    points3d_m = np.zeros((1, 2, 17, 3))
    points3d_m[:, 0], points3d_m[:, 1] = [1.0, 0.0, 1.0], [0.0, 1.0, 1.0]
    covariance_m2 = np.zeros((1, 2, 17, 3, 3))
    covariance_m2[:, 0], covariance_m2[:, 1] = np.diag([100.0, 0.01, 0.01]), np.diag([0.01, 100.0, 0.01])
    points2d_px = np.zeros((1, 2, 17, 2))
    seen = Observations(skeleton, np.zeros(1), points2d_px, points3d_m=points3d_m, covariance3d_m2=covariance_m2)
    fused_m = fuse(replace(seen, camera_names=rig.names), rig, BY_COVARIANCE).positions_m
    # the other view's variance is 10,000 times as large
    np.testing.assert_allclose(fused_m, np.broadcast_to([0.0, 0.0, 1.0], (1, 17, 3)), atol=2e-4)


def test_the_mean_by_covariance_leaves_out_a_view_that_is_far_off(walking_scene, rig):
    observations = walking_scene.observations
    assert observations.points3d_m is not None
    points3d_m = observations.points3d_m.copy()
    points3d_m[:, 1] += 3.0
    wrong = fuse(replace(observations, points3d_m=points3d_m), rig, BY_COVARIANCE).positions_m
    without = fuse(
        observations.subset([rig.names[i] for i in (0, 2, 3)]),
        rig.subset([rig.names[i] for i in (0, 2, 3)]),
        BY_COVARIANCE,
    ).positions_m
    # Cauchy: a view at 100 sigma has a ten-thousandth of the weight
    assert np.linalg.norm(wrong - without, axis=-1).mean() < 0.02


def test_without_covariance_the_mean_is_that_of_equations_1_and_2(walking_scene, rig):
    bare = replace(walking_scene.observations, covariance3d_m2=None)
    np.testing.assert_array_equal(fuse(bare, rig, BY_COVARIANCE).positions_m, fuse(bare, rig).positions_m)


def test_a_joint_of_one_view_is_where_that_view_puts_it(walking_scene, rig):
    observations = walking_scene.observations
    assert observations.points3d_m is not None
    points3d_m = observations.points3d_m.copy()
    points3d_m[0, :3, 0] = NAN
    fused_m = fuse(replace(observations, points3d_m=points3d_m), rig, BY_COVARIANCE).positions_m
    # one view is left, which is the mean itself
    np.testing.assert_allclose(fused_m[0, 0], points3d_m[0, 3, 0], atol=1e-9)
