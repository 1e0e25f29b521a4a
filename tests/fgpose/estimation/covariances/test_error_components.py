"""The components of detection errors, and the covariances that follow from them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose.estimation.covariances import error_components
from fgpose.estimation.covariances.error_components import Deviations, covariance_of_errors_m2
from fgpose.estimation.covariances.variance_components import TIMES_S, ErrorComponents, correlation_after
from fgpose.estimation.evidence.gather import gather
from fgpose.estimation.segment import Segment
from fgpose.estimation.solvers.levenberg_marquardt import levenberg_marquardt
from fgpose.estimation.solvers.normal_equations import NormalEquations
from fgpose.skeleton import BoneLengths
from fgpose_benchmarks.synthetic import (
    NO_NOISE,
    NO_OCCLUSION,
    DetectionNoise,
    Scene,
    motion_from_npz,
    ring_rig,
    simulate,
)
from tests.conftest import MOCAP

MEDIAN, NINETIETH = 2.366, 6.251  # of the chi-squared distribution with three degrees of freedom
NOISES = {
    "white": DetectionNoise(sigma_px=5.0, correlated_px=0.0, outlier_share=0.0),
    "as usual": DetectionNoise(outlier_share=0.0),
    "all correlated": DetectionNoise(sigma_px=0.0, correlated_px=5.0, outlier_share=0.0),
    "constant": DetectionNoise(sigma_px=3.0, correlated_px=0.0, outlier_share=0.0, min_bias_m=0.02, max_bias_m=0.03),
}


def scene(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton, noise: DetectionNoise, n_frames: int = 150) -> Scene:
    truth_m, fps = motion_from_npz(MOCAP / "cmu_03_03_b.npz")
    return simulate(truth_m[:n_frames], skeleton, rig, fps, noise, NO_OCCLUSION, seed=0)


def segment_of(
    observations: fgpose.Observations, rig: fgpose.CameraRig, config: fgpose.Config | None = None
) -> Segment:
    config = config or fgpose.Config()
    return Segment.of_recording(gather(observations, rig, config), rig, observations.skeleton, config)


def squared_errors(trajectory: fgpose.Trajectory, truth_m: np.ndarray) -> np.ndarray:
    """In the covariances that are claimed."""
    assert trajectory.covariance_m2 is not None
    error_m = trajectory.positions_m - truth_m
    return np.einsum("tji,tjik,tjk->tj", error_m, np.linalg.inv(trajectory.covariance_m2), error_m)


@pytest.mark.parametrize(
    ("noise", "n_cameras"),
    [
        ("as usual", 4),
        ("constant", 2),
        pytest.param("white", 4, marks=pytest.mark.slow),
        pytest.param("all correlated", 2, marks=pytest.mark.slow),
        pytest.param("as usual", 2, marks=pytest.mark.slow),
    ],
)
def test_the_ellipsoids_hold_as_many_errors_as_they_should(
    noise: str, n_cameras: int, rig: fgpose.CameraRig, skeleton: fgpose.Skeleton
) -> None:
    """Whatever the correlation of the errors: without the components, the standard deviations of slow ones are two to
    three times too small, and with two cameras the residuals hardly show them."""
    few = rig.subset(rig.names[:n_cameras])
    noisy = scene(few, skeleton, NOISES[noise])
    trajectory = fgpose.smooth(replace(noisy.observations, points3d_m=None), few)
    squared = squared_errors(trajectory, noisy.truth_m)
    # Three seconds of 17 joints hold few independent errors: constant ones are 34 vectors.
    for quantile, expected in ((0.5, MEDIAN), (0.9, NINETIETH)):
        ratio = np.sqrt(np.quantile(squared, quantile) / expected)
        # Constant errors are 34 vectors of nearly the same length, whose median is large: 1.2 to 1.6 in three draws.
        assert 0.75 < ratio < (1.65 if noise == "constant" else 1.4), f"at {quantile:.0%}"


@pytest.mark.parametrize("n_cameras", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_the_ellipsoids_hold_what_lasts_where_one_camera_is_worse(
    n_cameras: int, rig: fgpose.CameraRig, skeleton: fgpose.Skeleton
) -> None:
    """White noise of 10 px in one camera hides that its errors last, not that those of the others do: standard
    deviations were 1.3 times too small with two cameras, and with errors of real networks 1.7 times."""
    few = rig.subset(rig.names[:n_cameras])
    noisy = scene(few, skeleton, NOISES["all correlated"])
    points_px = noisy.observations.points2d_px.copy()
    points_px[:, 1] += np.random.default_rng(0).normal(0, 10.0, points_px[:, 1].shape)
    trajectory = fgpose.smooth(replace(noisy.observations, points2d_px=points_px, points3d_m=None), few)
    squared = squared_errors(trajectory, noisy.truth_m)
    assert 0.85 < np.sqrt(np.median(squared) / MEDIAN) < 1.15


def test_the_ellipsoids_hold_motion_that_is_faster_than_usual(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    """Motion that is four times as fast is more rough than the graph takes it for: by the graph alone half of
    the errors are larger than 1.11 times their ellipsoids. The residuals show it."""
    truth_m, fps = motion_from_npz(MOCAP / "cmu_03_03_b.npz")
    fast = simulate(truth_m[::6], skeleton, rig, fps * 4 / 6, NOISES["as usual"], NO_OCCLUSION, seed=0)
    trajectory = fgpose.smooth(replace(fast.observations, points3d_m=None), rig)
    squared = squared_errors(trajectory, fast.truth_m)
    for quantile, expected in ((0.5, MEDIAN), (0.9, NINETIETH)):
        assert 0.85 < np.sqrt(np.quantile(squared, quantile) / expected) < 1.1, f"at {quantile:.0%}"


def test_joints_deviate_as_the_detections_do(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    """Errors of a hundredth of a pixel move the solution as the linearised problem says."""
    config = fgpose.Config(projection={"kernel": "none"}, depth={"use": "never"}, solver={"step_tolerance_m": 1e-9})
    exact = segment_of(scene(rig, skeleton, NO_NOISE, n_frames=12).observations, rig, config)
    # A prior that contradicts the detections would leave residuals, with which the problem bends.
    exact = replace(exact, known=BoneLengths(exact.lengths_m, np.full(skeleton.n_lengths, 1e-3)))

    def solution_m(segment: Segment) -> np.ndarray:
        problem = NormalEquations(segment)
        return problem.positions_m(levenberg_marquardt(problem, problem.initial(), max_iterations=50).state)

    before_m, sigma_px = solution_m(exact), exact.evidence.detection_sigma_px
    errors = 0.01 * np.random.default_rng(0).standard_normal(exact.evidence.undistorted_px.shape)
    moved_px = exact.evidence.undistorted_px + errors
    after_m = solution_m(replace(exact, evidence=replace(exact.evidence, undistorted_px=moved_px)))
    deviation_m = NormalEquations(exact).linearized(before_m).deviation_m(errors / sigma_px[..., None])
    moved_m = after_m - before_m
    assert np.abs(moved_m).max() > 1e-6
    # Second order: a relative change of the geometry by 1e-5. Sigmas are rounded to a thousandth.
    np.testing.assert_allclose(deviation_m, moved_m, rtol=0, atol=5e-3 * np.abs(moved_m).max())


@pytest.mark.parametrize("time_s", [0.0, 0.15, np.inf])
def test_simulated_errors_have_the_correlation_of_their_component(time_s: float) -> None:
    correlation = float(correlation_after(time_s, np.array([0.05]))[0])
    errors = error_components._samples((100, 4, 17), correlation, np.random.default_rng(0))
    lags = np.array([0, 1, 3, 10])
    found = [np.mean(errors[:, : 100 - lag] * errors[:, lag:]) for lag in lags]
    expected = np.exp(-0.05 * lags / time_s) if time_s else np.array([1.0, 0, 0, 0])
    np.testing.assert_allclose(found, expected, atol=0.02)  # 1,000 independent vectors of 17 x 4 x 2


def test_where_nothing_is_known_errors_are_as_usual(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    """A single frame: its covariance is that of detections whose errors do not average."""
    segment = segment_of(replace(scene(rig, skeleton, NO_NOISE, n_frames=1).observations, points3d_m=None), rig)
    covariance_m2, _ = covariance_of_errors_m2(segment, segment.evidence.guess_m)
    linear_m2 = NormalEquations(segment).linearized(segment.evidence.guess_m).covariance_m2()
    ratio = np.trace(covariance_m2, axis1=-2, axis2=-1) / np.trace(linear_m2, axis1=-2, axis2=-1)
    assert np.isfinite(ratio).all()
    # The residuals of exact detections are zero, which outweighs the usual errors: 17 joints in 4 views against 10.
    assert (ratio < 1.0).all()
    assert (np.linalg.eigvalsh(covariance_m2) > 0).all()


def test_frames_nanoseconds_apart_take_no_more_memory_than_others(
    rig: fgpose.CameraRig, skeleton: fgpose.Skeleton
) -> None:
    """Found by a soak: an average over one second was one over 10^10 frames."""
    observations = replace(
        scene(rig, skeleton, NOISES["white"], n_frames=12).observations, time_s=1e-10 * np.arange(12)
    )
    trajectory = fgpose.smooth(observations, rig)
    assert trajectory.covariance_m2 is not None
    assert np.isfinite(trajectory.covariance_m2).all()


def test_enough_samples_are_drawn_of_what_lasts(skeleton: fgpose.Skeleton) -> None:
    """Nothing averages constant errors over time. Of six cameras, squared errors are 1.45 times as large as they should
    be in ellipsoids from eight samples, though these are as large as they should be on average."""
    rig = ring_rig(6, 3.0, 2.5, (0.0, 0.0, 0.9))
    noisy = scene(rig, skeleton, NOISES["as usual"], n_frames=20)
    segment = segment_of(replace(noisy.observations, points3d_m=None), rig)
    linearized = NormalEquations(segment).linearized(noisy.truth_m)
    n_slots = linearized.weight.shape[-1]
    variances = np.tile([float(np.isinf(time_s)) for time_s in TIMES_S], (n_slots, 1))
    constant = ErrorComponents(variances, np.eye(n_slots), np.ones((n_slots, 2)))
    drawn_m2 = Deviations.of(linearized, constant, 1.0, 1 / 30, np.random.default_rng(0)).covariance_m2
    exact_m2 = np.zeros_like(drawn_m2)
    for camera, slot, axis in np.ndindex(rig.n_cameras, n_slots, 2):
        error = np.zeros((*linearized.weight.shape, 2))
        error[:, camera, slot, axis] = 1.0
        moved_m = linearized.deviation_m(error)
        exact_m2 += np.einsum("tja,tjb->tjab", moved_m, moved_m)
    squared = np.trace(np.linalg.inv(drawn_m2) @ exact_m2, axis1=-2, axis2=-1) / 3
    # 64 samples give 1.07 if they are not orthogonal.
    assert 0.98 < squared.mean() < 1.08
