from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.optimize import least_squares

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.triangulation import (
    _MAX_PAIRS,
    USUAL_FROM_M,
    Triangulation,
    _pairs,
    triangulate,
    triangulate_robust,
    triangulate_without_each,
)
from fgpose_benchmarks.synthetic import ring_rig

NAN = np.nan


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@pytest.fixture
def truth_m(rng: np.random.Generator) -> np.ndarray:
    """Fifty points in the volume of a person, one of them at the origin."""
    points_m = rng.uniform((-0.6, -0.6, 0.0), (0.6, 0.6, 1.8), (50, 3))
    points_m[0] = 0.0
    return points_m


def seen(truth_m: np.ndarray, rig: CameraRig) -> np.ndarray:
    """(point, camera, 2) pixels."""
    return np.moveaxis(rig.project(truth_m), 0, 1)


def robust(points_px: np.ndarray, rig: CameraRig, confidence: np.ndarray | None = None) -> Triangulation:
    """triangulate_robust for (point, camera, 2) pixels."""
    undistorted_px = np.moveaxis(points_px, 1, 0)
    known = np.isfinite(undistorted_px).all(axis=-1).astype(float)
    return triangulate_robust(undistorted_px, known if confidence is None else confidence.T, rig)


def dlt_by_svd(points_px: np.ndarray, projection_matrices: np.ndarray) -> np.ndarray:
    """One point, textbook: null vector of the homogeneous system (Hartley and Zisserman 12.2)."""
    rows = []
    for (u, v), P in zip(points_px, projection_matrices, strict=True):
        rows += [u * P[2] - P[0], v * P[2] - P[1]]
    X = np.linalg.svd(np.array(rows))[2][-1]
    return X[:3] / X[3]


def test_exact_without_noise(rig, truth_m):
    points_px = seen(truth_m, rig)
    plain_m = triangulate(points_px, np.ones(points_px.shape[:2]), rig.projection_matrices)
    # normal equations square the condition of the system: half of the 16 digits
    np.testing.assert_allclose(plain_m, truth_m, atol=1e-8)
    found = robust(points_px, rig)
    np.testing.assert_allclose(found.positions_m, truth_m, atol=1e-8)
    assert found.inliers.all()


def test_agrees_with_a_textbook_dlt_and_opencv_on_two_views(rig, truth_m):
    pair = rig.projection_matrices[:2]
    points_px = seen(truth_m, rig)[:, :2]
    ours_m = triangulate(points_px, np.ones((50, 2)), pair)
    homogeneous = cv2.triangulatePoints(pair[0], pair[1], points_px[:, 0].T.copy(), points_px[:, 1].T.copy())
    np.testing.assert_allclose(ours_m, (homogeneous[:3] / homogeneous[3]).T, atol=1e-8)
    np.testing.assert_allclose(ours_m, [dlt_by_svd(point_px, pair) for point_px in points_px], atol=1e-8)


def test_agrees_with_a_textbook_dlt_on_noisy_views(rig, truth_m, rng):
    points_px = seen(truth_m, rig) + 2 * rng.normal(size=(50, 4, 2))
    ours_m = triangulate(points_px, np.ones((50, 4)), rig.projection_matrices)
    depths_m = np.stack([camera.to_camera_frame(ours_m)[:, 2] for camera in rig.cameras], axis=1)
    # divided by its depth, each view's equations are pixels
    matrices = rig.projection_matrices / depths_m[..., None, None]
    svd_m = np.array([dlt_by_svd(points_px[i], matrices[i]) for i in range(50)])
    # left are the depths of the first pass and the norm of (X, 1): 0.15 mm where the error is 6 mm
    assert np.linalg.norm(ours_m - svd_m, axis=1).max() < 3e-4
    assert 0.003 < np.sqrt(np.mean((ours_m - truth_m) ** 2)) < 0.007


def test_is_the_least_reprojection_error_to_second_order(rig, truth_m, rng):
    points_px = seen(truth_m, rig) + 2 * rng.normal(size=(50, 4, 2))
    weights = rng.uniform(0.2, 1.0, (50, 4))
    ours_m = triangulate(points_px, weights, rig.projection_matrices)
    for point_px, weight, point_m in zip(points_px, weights, ours_m, strict=True):

        def residuals(X: np.ndarray, point_px: np.ndarray = point_px, weight: np.ndarray = weight) -> np.ndarray:
            return ((rig.project(X[None])[:, 0] - point_px) * np.sqrt(weight)[:, None]).ravel()

        best_m = least_squares(residuals, np.array([0.0, 0.0, 0.9]), xtol=1e-12).x
        # depths are those of the first pass, off by 1 cm in 4.5 m: 0.2 % of an error of 6 mm
        np.testing.assert_allclose(point_m, best_m, atol=1e-4)


def test_weights_draw_the_point_to_their_views(rig, truth_m):
    points_px = seen(truth_m, rig)
    points_px[:, 0] += (12.0, 0.0)
    errors_m = []
    for weight in (0.0, 0.1, 1.0, 10.0):
        weights = np.tile([weight, 1.0, 1.0, 1.0], (50, 1))
        position_m = triangulate(points_px, weights, rig.projection_matrices)
        errors_m.append(np.linalg.norm(position_m - truth_m, axis=1))
        np.testing.assert_allclose(triangulate(points_px, 7 * weights, rig.projection_matrices), position_m, atol=1e-9)
    np.testing.assert_allclose(errors_m[0], 0.0, atol=1e-8)
    assert (np.diff(errors_m, axis=0) > 0).all()


def test_weight_zero_and_nan_are_the_same_as_a_camera_less(rig, truth_m, rng):
    points_px = seen(truth_m, rig) + rng.normal(size=(50, 4, 2))
    three = triangulate(points_px[:, :3], np.ones((50, 3)), rig.projection_matrices[:3])
    off = triangulate(points_px, np.tile([1.0, 1.0, 1.0, 0.0], (50, 1)), rig.projection_matrices)
    points_px[:, 3] = NAN
    missing = triangulate(points_px, np.ones((50, 4)), rig.projection_matrices)
    np.testing.assert_allclose(off, three, atol=1e-9)
    np.testing.assert_array_equal(missing, off)


def test_does_not_depend_on_the_frame_of_the_world(rig, truth_m, rng):
    points_px = seen(truth_m, rig) + 2 * rng.normal(size=(50, 4, 2))
    far_T_world = np.eye(4)
    far_T_world[:3, :3] = cv2.Rodrigues(np.array([0.3, -1.2, 0.7]))[0]
    far_T_world[:3, 3] = (20.0, -35.0, 4.0)
    moved = CameraRig(
        tuple(Camera(c.name, c.size_px, c.K, far_T_world @ c.world_T_camera, c.distortion) for c in rig.cameras)
    )
    here_m = robust(points_px, rig).positions_m
    there_m = robust(points_px, moved).positions_m
    # 40 m from the origin the normal equations lose two more digits
    np.testing.assert_allclose(there_m, here_m @ far_T_world[:3, :3].T + far_T_world[:3, 3], atol=1e-6)


def test_holds_when_one_of_four_views_is_grossly_wrong(rig, truth_m, rng):
    clean_px = seen(truth_m, rig) + rng.normal(size=(50, 4, 2))
    bad = rng.integers(4, size=50)
    points_px = clean_px.copy()
    points_px[np.arange(50), bad] += 150 * rng.choice([-1, 1], size=(50, 2))
    found = robust(points_px, rig)
    assert not found.inliers[np.arange(50), bad].any()
    assert (found.inliers.sum(axis=1) == 3).all()
    clean_px[np.arange(50), bad] = NAN
    # the wrong view is left out altogether
    np.testing.assert_allclose(found.positions_m, robust(clean_px, rig).positions_m, atol=1e-9)


def test_confidence_decides_between_two_pairs_of_views_that_contradict_each_other(rig):
    here_m, there_m = np.array([[0.0, 0.0, 1.0]]), np.array([[0.3, 0.2, 1.3]])
    points_px = np.concatenate([seen(here_m, rig)[:, :2], seen(there_m, rig)[:, 2:]], axis=1)
    for confidence, expected_m in (([0.9, 0.9, 0.5, 0.5], here_m), ([0.5, 0.5, 0.9, 0.9], there_m)):
        found = robust(points_px, rig, np.array([confidence]))
        np.testing.assert_allclose(found.positions_m, expected_m, atol=1e-8)


def test_fewer_than_two_views_give_nan(rig, truth_m):
    points_px = seen(truth_m, rig)
    points_px[0, 1:] = NAN
    points_px[1] = NAN
    points_px[2, :, 0] = NAN
    for position_m in (
        triangulate(points_px, np.ones((50, 4)), rig.projection_matrices),
        robust(points_px, rig).positions_m,
    ):
        assert np.isnan(position_m[:3]).all()
        np.testing.assert_allclose(position_m[3:], truth_m[3:], atol=1e-8)
    assert not robust(points_px, rig).inliers[:3].any()


def test_two_views_that_contradict_each_other_give_nan(rig, truth_m):
    points_px = seen(truth_m, rig)
    points_px[:, 2:] = NAN
    points_px[:, 0] += (0.0, 100.0)
    assert np.isnan(robust(points_px, rig).positions_m).all()


def test_a_rig_of_one_camera_gives_nan(rig, truth_m):
    alone = rig.subset(rig.names[:1])
    found = robust(seen(truth_m, alone), alone)
    assert np.isnan(found.positions_m).all()
    assert found.inliers.shape == (50, 1)
    assert not found.inliers.any()


def side_by_side(distance_m: float) -> CameraRig:
    K = np.array([[1000.0, 0, 500], [0, 1000, 500], [0, 0, 1]])
    cameras = []
    for name, x_m in (("left", 0.0), ("right", distance_m)):
        pose = np.eye(4)
        pose[0, 3] = x_m
        cameras.append(Camera(name, (1000, 1000), K, pose, np.zeros(0)))
    return CameraRig(tuple(cameras))


def test_parallel_rays_give_nan():
    stereo = side_by_side(1.0)
    points_px = np.array([[[400.0, 600.0], [400.0, 600.0]]])
    assert np.isnan(triangulate(points_px, np.ones((1, 2)), stereo.projection_matrices)).all()
    assert np.isnan(robust(points_px, stereo).positions_m).all()


@pytest.mark.parametrize(("distance_m", "determined"), [(0.03, False), (0.1, True)])
def test_rays_less_than_a_degree_apart_are_not_trusted(distance_m, determined):
    stereo = side_by_side(distance_m)
    # at 4 m: 0.43 and 1.43 degrees
    points_px = seen(np.array([[0.02, 0.1, 4.0]]), stereo)
    assert np.isfinite(robust(points_px, stereo).positions_m).all() == determined


def test_a_point_behind_the_cameras_gives_nan():
    stereo = side_by_side(1.0)
    homogeneous = np.array([0.4, 0.2, -4.0, 1.0]) @ np.swapaxes(stereo.projection_matrices, 1, 2)
    points_px = (homogeneous[:, :2] / homogeneous[:, 2:])[None]
    assert np.isnan(robust(points_px, stereo).positions_m).all()


def test_a_large_rig_tries_a_part_of_its_pairs(truth_m, rng):
    ring = ring_rig(n_cameras=16)
    points_px = seen(truth_m, ring) + rng.normal(size=(50, 16, 2))
    points_px[:, ::3] += 200.0
    found = robust(points_px, ring)
    assert not found.inliers[:, ::3].any()
    # ten good views of 1 px: 4.5 m / 1145 px / sqrt(5) = 1.8 mm rms, 4 sigma
    assert np.abs(found.positions_m - truth_m).max() < 0.008


@pytest.mark.parametrize("n_cameras", [1, 2, 4, 12, 13, 16, 24, 40])
def test_the_number_of_pairs_is_bounded_and_no_camera_is_left_out(n_cameras):
    pairs = _pairs(n_cameras)
    assert len(pairs) <= _MAX_PAIRS
    assert len(np.unique(np.sort(pairs, axis=1), axis=0)) == len(pairs)
    if n_cameras > 1:
        assert set(pairs.ravel().tolist()) == set(range(n_cameras))
    if n_cameras * (n_cameras - 1) // 2 <= _MAX_PAIRS:
        assert len(pairs) == n_cameras * (n_cameras - 1) // 2


def test_frames_joints_and_cameras_keep_their_places(rig, rng):
    truth_m = rng.uniform(-0.5, 0.5, (3, 5, 3))
    undistorted_px = rig.project(truth_m)
    undistorted_px[1, 2, 4] = NAN
    confidence = np.isfinite(undistorted_px).all(axis=-1).astype(float)
    found = triangulate_robust(undistorted_px, confidence, rig)
    np.testing.assert_allclose(found.positions_m, truth_m, atol=1e-8)
    np.testing.assert_array_equal(found.inliers, np.moveaxis(confidence > 0, 1, 2))


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("far_px", [1e40, 1e200, 1e308])
def test_what_no_image_holds_is_missing(far_px: float, rig: CameraRig) -> None:
    """Its squares overflow."""
    point_m = np.array([[0.1, 0.2, 1.0]])
    points2d_px = np.stack([camera.project(point_m) for camera in rig.cameras], axis=1)
    weights = np.ones((1, rig.n_cameras))
    weights[:, 0] = 0.0
    without_m = triangulate(points2d_px, weights, rig.projection_matrices)
    points2d_px[:, 0], weights[:, 0] = far_px, 1.0
    np.testing.assert_array_equal(triangulate(points2d_px, weights, rig.projection_matrices), without_m)


def contradicting(radius_m: float, off_m: float) -> tuple[np.ndarray, CameraRig, np.ndarray]:
    """A point in the middle of a ring; one of the first two cameras sees it off_m higher, the other ones not at all."""
    ring = ring_rig(radius_m=radius_m, height_m=1.0)
    point_m = np.array([[0.0, 0.0, 1.0]])
    points_px = seen(point_m, ring)
    points_px[:, 1] = seen(point_m + np.array([0.0, 0.0, off_m]), ring)[:, 1]
    points_px[:, 2:] = NAN
    undistorted_px = np.moveaxis(points_px, 1, 0)
    return undistorted_px, ring, np.isfinite(undistorted_px).all(axis=-1).astype(float)


@pytest.mark.parametrize(
    ("radius_m", "off_m", "alone", "near"),
    [
        (1.0, 0.03, True, True),  # 15 of 17 mm
        (1.0, 0.12, False, True),
        (1.0, 0.16, False, False),
        (2.0, 0.12, False, True),
        (3.2, 0.13, False, False),  # 65 of 56 mm, and not near
        (USUAL_FROM_M, 0.12, True, True),
        (USUAL_FROM_M, 0.16, False, False),
        (8.0, 0.26, True, True),  # the angle is wider than the length
        (8.0, 0.32, False, False),
    ],
)
def test_near_cameras_may_err_by_the_lengths_by_which_far_ones_may(
    radius_m: float, off_m: float, alone: bool, near: bool
) -> None:
    """The point that two rays give is in the middle between them, half of off_m away from each; 70 mm may be."""
    undistorted_px, ring, confidence = contradicting(radius_m, off_m)
    found = triangulate_robust(undistorted_px, confidence, ring)
    with_length = triangulate_robust(undistorted_px, confidence, ring, usual_from_m=USUAL_FROM_M)
    assert bool(np.isfinite(found.positions_m).all()) == alone
    assert bool(np.isfinite(with_length.positions_m).all()) == near
    if alone:
        np.testing.assert_array_equal(with_length.positions_m, found.positions_m)
    if near:
        # The rays meet at a height that is the mean of both, to the second order of off_m / radius_m.
        np.testing.assert_allclose(with_length.positions_m[0], [0, 0, 1 + off_m / 2], atol=off_m**2 / radius_m)


def test_views_that_agree_near_to_the_cameras_are_not_joined_by_one_that_does_not(
    truth_m: np.ndarray, rng: np.random.Generator
) -> None:
    near = ring_rig(radius_m=1.5)
    points_px = seen(truth_m, near) + rng.normal(size=(50, 4, 2))
    points_px[:, 0] = seen(truth_m + np.array([0.0, 0.0, 0.06]), near)[:, 0]
    undistorted_px = np.moveaxis(points_px, 1, 0)
    confidence = np.isfinite(undistorted_px).all(axis=-1).astype(float)
    found = triangulate_robust(undistorted_px, confidence, near)
    with_length = triangulate_robust(undistorted_px, confidence, near, usual_from_m=USUAL_FROM_M)
    np.testing.assert_array_equal(with_length.inliers, found.inliers)
    np.testing.assert_array_equal(with_length.positions_m, found.positions_m)


def test_without_each_view_is_as_of_the_others_alone(rng, truth_m):
    rig = ring_rig(5)
    points_px = seen(truth_m, rig) + rng.normal(0, 5.0, (50, 5, 2))
    points_px[rng.random((50, 5)) < 0.15] += 300.0
    points_px[rng.random((50, 5)) < 0.15] = NAN
    undistorted_px, confidence = np.moveaxis(points_px, 1, 0)[None], rng.uniform(0.2, 1.0, (1, 5, 50))
    inlier_px = rig.in_own_px(14.0)

    found_m = triangulate_without_each(undistorted_px, confidence, rig, inlier_px)
    for c in range(5):
        rest = [other for other in range(5) if other != c]
        of_rest = rig.subset([rig.names[other] for other in rest])
        alone = triangulate_robust(undistorted_px[:, rest], confidence[:, rest], of_rest, inlier_px[rest])
        np.testing.assert_allclose(found_m[c], alone.positions_m, rtol=0, atol=1e-9)  # the same to rounding
    assert np.isfinite(found_m).all(axis=-1).mean() > 0.5


def test_without_one_of_two_views_there_is_nothing(truth_m):
    rig = ring_rig(2)
    undistorted_px = np.moveaxis(seen(truth_m, rig), 1, 0)[None]
    assert np.isnan(triangulate_without_each(undistorted_px, np.ones((1, 2, 50)), rig, rig.in_own_px(14.0))).all()
