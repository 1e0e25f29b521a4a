from __future__ import annotations

import jaxtyping
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from fgpose.assessment import metrics
from fgpose.io.skeletons import load_skeleton

NAN = np.nan


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def test_mpjpe_of_hand_computed_errors():
    reference_m = np.zeros((2, 3, 3))
    estimate_m = np.zeros((2, 3, 3))
    estimate_m[0] = [[3, 4, 0], [0, 0, 1], [0, 2, 0]]
    estimate_m[1, 0] = [0, 0, 4]
    errors_m = metrics.joint_errors_m(estimate_m, reference_m)
    np.testing.assert_array_equal(errors_m, [[5, 1, 2], [4, 0, 0]])
    assert metrics.mpjpe_m(estimate_m, reference_m) == 2.0
    # relative to joint 1, whose error is (0, 0, 1): 26 = 3^2 + 4^2 + 1, 5 = 2^2 + 1
    relative_m = metrics.joint_errors_m(estimate_m, reference_m, root=(1,))
    np.testing.assert_allclose(relative_m, [[26**0.5, 0, 5**0.5], [4, 0, 0]], rtol=1e-15)
    # the mean of joints 0 and 1 is off by (0, 0, 2) in frame 1
    np.testing.assert_array_equal(metrics.joint_errors_m(estimate_m, reference_m, root=(0, 1))[1], [2, 2, 2])


def test_a_translation_is_no_relative_error(rng):
    reference_m = rng.normal(size=(4, 5, 3))
    estimate_m = reference_m + np.array([1.0, -2.0, 0.5])
    # rounding of coordinates of a few metres
    assert metrics.mpjpe_m(estimate_m, reference_m, root=(0, 3)) < 1e-14
    assert metrics.mpjpe_m(estimate_m, reference_m) == pytest.approx(5.25**0.5)


def test_what_is_missing_on_either_side_is_left_out_and_told(rng):
    reference_m, estimate_m = np.zeros((2, 4, 3)), np.ones((2, 4, 3))
    reference_m[0, 1], estimate_m[1, 2, 0], estimate_m[1, 3] = NAN, NAN, NAN
    errors_m = metrics.joint_errors_m(estimate_m, reference_m)
    assert metrics.share_missing(errors_m) == 3 / 8
    assert metrics.mpjpe_m(estimate_m, reference_m) == pytest.approx(3**0.5)
    np.testing.assert_array_equal(np.isnan(metrics.joint_errors_m(estimate_m, reference_m, root=(1,))[0]), [True] * 4)


def test_means_over_one_axis():
    errors_m = np.array([[1.0, NAN, NAN], [3.0, 4.0, NAN]])
    np.testing.assert_array_equal(metrics.mean_known(errors_m, axis=0), [2, 4, NAN])
    np.testing.assert_array_equal(metrics.mean_known(errors_m, axis=1), [1, 3.5])
    assert np.isnan(metrics.mean_known(np.full((2, 2), NAN)))


def test_shapes_that_differ_are_refused(monkeypatch):
    # as in production, where NumPy would broadcast without a word
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    for metric in (metrics.mpjpe_m, metrics.pa_mpjpe_m):
        with pytest.raises(ValueError, match=r"one shape, got \(2, 3, 3\) and \(1, 3, 3\)"):
            metric(np.zeros((2, 3, 3)), np.zeros((1, 3, 3)))


def test_a_similarity_transform_is_no_procrustes_error(rng):
    reference_m = rng.normal(size=(6, 9, 3))
    rotation = Rotation.random(6, rng=rng).as_matrix()
    scale, shift_m = rng.uniform(0.2, 3, size=(6, 1, 1)), rng.normal(size=(6, 1, 3)) * 5
    estimate_m = scale * reference_m @ rotation + shift_m
    estimate_m[1, 2], reference_m[4, :3] = NAN, NAN
    # rounding of coordinates of about ten metres
    assert metrics.pa_mpjpe_m(estimate_m, reference_m) < 1e-13
    assert metrics.share_missing(metrics.procrustes_aligned_m(estimate_m, reference_m)) == 3 / (6 * 9 * 3)


def test_a_mirror_image_is_a_procrustes_error(rng):
    reference_m = rng.normal(size=(3, 9, 3))
    assert metrics.pa_mpjpe_m(reference_m * [-1.0, 1.0, 1.0], reference_m) > 0.1


def test_procrustes_agrees_with_scipy(rng):
    from scipy.spatial import procrustes

    reference_m = rng.normal(size=(1, 12, 3))
    estimate_m = 2 * reference_m @ Rotation.random(rng=rng).as_matrix() + 0.1 * rng.normal(size=(1, 12, 3))
    aligned_m = metrics.procrustes_aligned_m(estimate_m, reference_m)
    # scipy centres the reference and divides it by its norm, and gives the sum of squares of what is left
    norm2_m2 = ((reference_m - reference_m.mean(axis=1, keepdims=True)) ** 2).sum()
    residual = ((aligned_m - reference_m) ** 2).sum() / norm2_m2
    assert residual == pytest.approx(procrustes(reference_m[0], estimate_m[0])[2], rel=1e-9)


def test_procrustes_of_too_little_is_nan(rng):
    reference_m = rng.normal(size=(3, 5, 3))
    estimate_m = reference_m.copy()
    estimate_m[0, 2:] = NAN
    estimate_m[1] = 1.0
    aligned_m = metrics.procrustes_aligned_m(estimate_m, reference_m)
    assert np.isnan(aligned_m[:2]).all()
    np.testing.assert_allclose(aligned_m[2], reference_m[2], atol=1e-14)


def test_pck_counts_errors_up_to_the_threshold():
    errors_m = np.array([[0.0, 0.15, 0.1501, NAN]])
    assert metrics.pck(errors_m) == 2 / 3
    assert metrics.pck(errors_m, threshold_m=0.2) == 1.0
    assert np.isnan(metrics.pck(np.array([NAN])))


def test_jitter_of_a_cubic_is_its_third_derivative_at_any_spacing(rng):
    time_s = np.cumsum(rng.uniform(0.01, 0.05, size=30))
    positions_m = np.zeros((30, 2, 3))
    positions_m[:, 0, 0], positions_m[:, 0, 1] = 3 * time_s**3, 4 * time_s**3
    positions_m[:, 1] = time_s[:, None] ** 2
    # joint 0: 6 * 5 m/s^3, joint 1: none; differences of 1 m over 0.01^3 s^3 leave about 1e-9 of rounding
    assert metrics.jitter_mps3(positions_m, time_s) == pytest.approx(15.0, rel=1e-7)


def test_jitter_at_even_spacing_is_that_of_the_literature(rng):
    positions_m = rng.normal(size=(20, 4, 3))
    third = positions_m[3:] - 3 * positions_m[2:-1] + 3 * positions_m[1:-2] - positions_m[:-3]
    expected = np.linalg.norm(third, axis=-1).mean() * 60**3
    assert metrics.jitter_mps3(positions_m, np.arange(20) / 60) == pytest.approx(expected)


def test_acceleration_error_of_a_known_difference():
    time_s = np.arange(10) / 50
    reference_m = np.zeros((10, 1, 3))
    estimate_m = reference_m.copy()
    estimate_m[:, 0, 2] = 0.5 * 2.0 * time_s**2 + 3 * time_s + 1
    assert metrics.acceleration_error_mps2(estimate_m, reference_m, time_s) == pytest.approx(2.0)
    # per frame^2: 2 m/s^2 over (1/50 s)^2
    per_frame2 = metrics.acceleration_error_mps2(estimate_m, reference_m, np.arange(10.0))
    assert per_frame2 == pytest.approx(2.0 / 50**2)


def test_derivatives_need_known_consecutive_frames():
    time_s = np.arange(5.0)
    positions_m = np.zeros((5, 1, 3))
    assert np.isnan(metrics.jitter_mps3(positions_m[:3], time_s[:3]))
    assert np.isnan(metrics.acceleration_error_mps2(positions_m[:1], positions_m[:1], time_s[:1]))
    positions_m[2] = NAN
    assert np.isnan(metrics.jitter_mps3(positions_m, time_s))


def test_bone_length_spread():
    skeleton = load_skeleton("coco_17")
    positions_m = np.zeros((4, 17, 3))
    bone = skeleton.bones[2]
    positions_m[:, bone[1], 0] = [0.3, 0.5, 0.3, 0.5]
    spread_m = metrics.bone_length_spread_m(skeleton, positions_m)
    assert spread_m[2] == pytest.approx(0.1)
    positions_m[1:, bone[0]] = NAN
    assert np.isnan(metrics.bone_length_spread_m(skeleton, positions_m)[2])


def samples(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Errors drawn from covariances that all differ."""
    factors_m = rng.normal(size=(n, 3, 3)) * [0.01, 0.05, 0.2]
    covariance_m2 = factors_m @ factors_m.swapaxes(1, 2)
    return (factors_m @ rng.normal(size=(n, 3, 1)))[..., 0], covariance_m2


def test_nees_of_samples_lies_in_its_chi2_band(rng):
    n = 2000
    errors_m, covariance_m2 = samples(rng, n)
    total = metrics.nees(errors_m, covariance_m2).sum()
    # the sum of n independent chi2(3) is chi2(3n); the seed is fixed, a right implementation fails for 1 seed in 1000
    assert chi2.ppf(0.0005, 3 * n) < total < chi2.ppf(0.9995, 3 * n)
    assert metrics.nees(errors_m, covariance_m2 / 4).sum() == pytest.approx(4 * total)


@pytest.mark.parametrize("probability", [0.5, 0.95])
def test_coverage_of_samples_is_the_probability(rng, probability):
    n = 4000
    errors_m, covariance_m2 = samples(rng, n)
    # 3.3 standard deviations of a binomial share: 1 seed in 1000
    tolerance = 3.3 * (probability * (1 - probability) / n) ** 0.5
    assert metrics.coverage(errors_m, covariance_m2, probability) == pytest.approx(probability, abs=tolerance)
    assert metrics.coverage(errors_m, covariance_m2 / 4, probability) < probability - tolerance


def test_nees_leaves_out_what_has_no_covariance(rng):
    errors_m, covariance_m2 = samples(rng, 4)
    errors_m[0], covariance_m2[1], covariance_m2[2] = NAN, NAN, 0.0
    np.testing.assert_array_equal(np.isnan(metrics.nees(errors_m, covariance_m2)), [True, True, True, False])
    assert metrics.nees(np.array([[1.0, 2.0, 3.0]]), np.diag([1.0, 4.0, 9.0])[None]) == 3.0
