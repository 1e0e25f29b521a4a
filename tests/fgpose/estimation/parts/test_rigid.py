"""A rigid set of points against sets whose shape and motion are known."""

from __future__ import annotations

import numpy as np
import pytest

from fgpose.estimation.parts.rigid import RigidSet

N_FRAMES, CARRIERS = 200, [0, 1, 2, 3]


@pytest.fixture
def shape_m() -> np.ndarray:
    """Four carriers, and points on both sides of them."""
    return np.random.default_rng(0).normal(scale=0.06, size=(10, 3))


def moved(shape_m: np.ndarray, seed: int = 1) -> np.ndarray:
    """The set at random places, turned in any direction."""
    rng = np.random.default_rng(seed)
    rotations = np.linalg.qr(rng.normal(size=(N_FRAMES, 3, 3)))[0]
    rotations *= np.linalg.det(rotations)[:, None, None]
    return np.einsum("tab,pb->tpa", rotations, shape_m) + rng.normal(size=(N_FRAMES, 1, 3))


def test_exact_carriers_put_all_points_where_they_are(shape_m: np.ndarray):
    truth_m = moved(shape_m)
    rigid = RigidSet.of(truth_m[:, CARRIERS], truth_m, CARRIERS)
    assert rigid is not None
    later_m = moved(shape_m, seed=2)
    placed_m, covariance_m2 = rigid.placed(later_m[:, CARRIERS], np.zeros((N_FRAMES, 4, 3, 3)))
    # Sums of numbers of a metre.
    np.testing.assert_allclose(placed_m, later_m, rtol=0, atol=1e-12)
    np.testing.assert_allclose(covariance_m2, 0.0, atol=1e-24)


def test_a_mirror_image_is_no_rotation(shape_m: np.ndarray):
    flat_m = shape_m.copy()
    flat_m[CARRIERS, 2] = 0.0
    truth_m = moved(flat_m)
    rigid = RigidSet.of(truth_m[:, CARRIERS], truth_m, CARRIERS)
    assert rigid is not None
    np.testing.assert_allclose(
        rigid.placed(truth_m[:, CARRIERS], np.zeros((N_FRAMES, 4, 3, 3)))[0], truth_m, atol=1e-12
    )


def test_the_covariance_holds_the_errors(shape_m: np.ndarray):
    """Errors of carriers that are rigid motions themselves, as of carriers whose distances are known."""
    truth_m, rng = moved(shape_m), np.random.default_rng(4)
    rigid = RigidSet.of(truth_m[:, CARRIERS], truth_m, CARRIERS)
    assert rigid is not None
    centred_m = truth_m[:, CARRIERS] - truth_m[:, CARRIERS].mean(axis=1, keepdims=True)
    radius_m = np.sqrt(np.mean(np.sum(centred_m**2, axis=-1)))
    sigma_m = 0.003
    shift_m = rng.normal(scale=sigma_m, size=(N_FRAMES, 1, 3))
    turn = rng.normal(scale=sigma_m * np.sqrt(3 / 2) / radius_m, size=(N_FRAMES, 1, 3))
    carriers_m = truth_m[:, CARRIERS] + shift_m + np.cross(turn, centred_m)
    covariance_m2 = np.broadcast_to(2 * sigma_m**2 * np.eye(3), (N_FRAMES, 4, 3, 3))
    placed_m, stated_m2 = rigid.placed(carriers_m, covariance_m2)
    error_m = placed_m - truth_m
    squared = np.einsum("tpa,tpa->tp", error_m, np.linalg.solve(stated_m2, error_m[..., None])[..., 0])
    # 200 frames of 6 random numbers: 1 within 3 standard deviations of the mean of 1200 squares, and the shape of the
    # ellipsoids, which are of spheres here.
    assert np.mean(squared) / 3 == pytest.approx(1.0, abs=0.2)


def test_points_that_move_have_their_motion_in_the_covariance(shape_m: np.ndarray):
    truth_m, rng = moved(shape_m), np.random.default_rng(5)
    rigid = RigidSet.of(truth_m[:, CARRIERS], truth_m, CARRIERS)
    assert rigid is not None
    seen_m = truth_m + rng.normal(scale=0.002, size=truth_m.shape)
    seen_m[:, 9] += rng.normal(scale=0.008, size=(N_FRAMES, 3))
    rigid = RigidSet.of(truth_m[:, CARRIERS], seen_m, CARRIERS)
    assert rigid is not None
    # Standard deviations of 200 numbers by their median are good to 10 %; what the detections do is taken off.
    np.testing.assert_allclose(rigid.sigma_m[9], 0.008, rtol=0.3)
    assert (rigid.sigma_m[4:9] < 0.0015).all()


def test_what_was_never_triangulated_is_not_placed(shape_m: np.ndarray):
    truth_m = moved(shape_m)
    seen_m = truth_m.copy()
    seen_m[2:, 8] = np.nan
    carriers_m = truth_m[:, CARRIERS].copy()
    carriers_m[7, 2] = np.nan
    rigid = RigidSet.of(carriers_m, seen_m, CARRIERS)
    assert rigid is not None
    placed_m, _ = rigid.placed(carriers_m, np.zeros((N_FRAMES, 4, 3, 3)))
    assert np.isnan(placed_m[:, 8]).all()
    assert np.isnan(placed_m[7]).all()
    assert np.isfinite(np.delete(np.delete(placed_m, 8, axis=1), 7, axis=0)).all()
    assert RigidSet.of(np.full_like(carriers_m, np.nan), seen_m, CARRIERS) is None
