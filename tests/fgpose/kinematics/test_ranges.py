"""Ranges of angles, without what noise adds to them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose.kinematics.angles import JointAngles, joint_angles
from fgpose.kinematics.ranges import NOISE_S
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, motion_from_npz, simulate
from tests.conftest import MOCAP

FPS, SHARES = 50.0, (0.0, 0.5, 1.0)


def smooth_noise(n_frames: int, rng: np.random.Generator) -> np.ndarray:
    """Of variance 1, with another spectrum than is taken for it: that of white noise through a Gaussian filter."""
    after_s = np.arange(-50, 51) / FPS
    kernel = np.exp(-0.5 * (after_s / (0.8 * NOISE_S)) ** 2)
    return np.convolve(rng.standard_normal(n_frames + 100), kernel / np.linalg.norm(kernel), mode="valid")


def angles_of(angle_deg: np.ndarray, sigma_deg: float) -> JointAngles:
    curve_deg = angle_deg[:, None]
    return JointAngles(("knee",), np.arange(len(angle_deg)) / FPS, curve_deg, np.full_like(curve_deg, sigma_deg))


def test_extremes_of_noisy_curves_are_those_of_the_truth() -> None:
    """Of ten seconds of steps, with noise of 4 degrees half of whose variance is constant."""
    rng, sigma_deg = np.random.default_rng(0), 4.0
    true_deg = 35 - 30 * np.cos(2 * np.pi * np.arange(500) / FPS)
    errors_deg, raw_deg, ratios = [], [], []
    for _ in range(40):
        noise_deg = sigma_deg * np.sqrt(0.5) * (smooth_noise(500, rng) + rng.standard_normal())
        angles = angles_of(true_deg + noise_deg, sigma_deg)
        found = angles.ranges(SHARES)
        raw_deg.append(np.ptp(angles.angle_deg) - np.ptp(true_deg))
        errors_deg.append(found.quantiles_deg[2, 0] - found.quantiles_deg[0, 0] - np.ptp(true_deg))
        off_deg = found.quantiles_deg[:, 0] - np.quantile(true_deg, SHARES)
        ratios.append((off_deg / found.sigma_deg[:, 0])[[0, 2]])
    assert np.mean(raw_deg) > 5.0
    # The constant half is taken for noise, as far as the curve is rough.
    assert abs(np.mean(errors_deg)) < 0.4 * np.mean(raw_deg)
    assert 0.6 < np.sqrt(np.mean(np.square(ratios))) < 1.1


def test_a_curve_that_is_smoother_than_its_noise_would_be_stays() -> None:
    """Of joints that are predicted, uncertain by 30 degrees."""
    slow_deg = 40 * np.sin(2 * np.pi * np.arange(500) / FPS / 5)
    found = angles_of(slow_deg, 30.0).ranges(SHARES)
    np.testing.assert_allclose(found.quantiles_deg[:, 0], np.quantile(slow_deg, SHARES), atol=2.0)
    np.testing.assert_allclose(found.sigma_deg, 30.0)


def test_quantiles_keep_their_order_where_all_is_noise() -> None:
    noise_deg = 3 * smooth_noise(300, np.random.default_rng(0))
    found = angles_of(noise_deg, 10.0).ranges(SHARES).quantiles_deg[:, 0]
    assert found[0] <= found[1] <= found[2]


def test_what_noise_adds_is_what_was_taken_away_and_every_call_gives_the_same() -> None:
    angles = angles_of(20 + 5 * smooth_noise(200, np.random.default_rng(0)), 4.0)
    found, again = angles.ranges(SHARES), angles.ranges(SHARES)
    np.testing.assert_allclose(found.quantiles_deg + found.noise_deg, angles.quantiles_deg(SHARES))
    np.testing.assert_array_equal(found.quantiles_deg, again.quantiles_deg)


@pytest.mark.parametrize("n_frames", [0, 1, 2, 5])
def test_few_frames_and_no_covariance_leave_quantiles_as_they_are(n_frames: int) -> None:
    """Of so few frames nobody knows how rough they are."""
    for sigma_deg in (3.0, np.nan):
        angles = angles_of(np.linspace(170.0, 190.0, n_frames), sigma_deg)
        found = angles.ranges(SHARES)
        np.testing.assert_array_equal(found.quantiles_deg, angles.quantiles_deg(SHARES))
    assert np.isnan(found.sigma_deg).all()


@pytest.mark.slow
def test_ranges_of_smoothed_recordings_hold_the_true_ones(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    truth_m, fps = motion_from_npz(MOCAP / "cmu_03_03_b.npz")
    noisy = simulate(truth_m[:250], skeleton, rig, fps, DetectionNoise(), NO_OCCLUSION, seed=0)
    trajectory = fgpose.smooth(replace(noisy.observations, points3d_m=None), rig)
    found = joint_angles(trajectory)
    still = replace(trajectory, positions_m=noisy.truth_m, covariance_m2=None)
    true_deg = joint_angles(still).quantiles_deg(SHARES)
    ranges = found.ranges(SHARES)
    off_deg = (ranges.quantiles_deg - true_deg)[[0, 2]]
    ratio = np.abs(off_deg / ranges.sigma_deg[[0, 2]])
    # 44 extremes, of joints that are in several angles.
    assert np.mean(ratio < 1.96) > 0.85
    raw_deg = found.quantiles_deg(SHARES) - true_deg
    assert abs(np.mean(off_deg[1] - off_deg[0])) < 0.5 * np.mean(raw_deg[2] - raw_deg[0])
