from __future__ import annotations

import numpy as np
import pytest

from fgpose_benchmarks.accuracy.linear import low_pass, triangulate_ransac
from fgpose_benchmarks.synthetic import ring_rig, walking

RIG = ring_rig()
TRUTH_M = walking(8, 50.0)
FPS = 50.0


def sine_m(frequency_hz: float, n_frames: int = 500) -> np.ndarray:
    """(frame, 1, 3): one joint that swings along x with an amplitude of 1 m."""
    wave = np.sin(2 * np.pi * frequency_hz * np.arange(n_frames) / FPS)
    return np.stack([wave, np.zeros(n_frames), np.ones(n_frames)], axis=-1)[:, None]


def test_ransac_is_exact_without_errors():
    # 1e-6 m: the normal equations of DLT square the condition of the matrix.
    np.testing.assert_allclose(triangulate_ransac(RIG.project(TRUTH_M), RIG), TRUTH_M, atol=1e-6)


@pytest.mark.parametrize("wrong", range(4))
def test_ransac_leaves_one_wrong_view_out(wrong):
    points_px = RIG.project(TRUTH_M)
    points_px[:, wrong] += [60.0, -80.0]
    np.testing.assert_allclose(triangulate_ransac(points_px, RIG), TRUTH_M, atol=1e-6)


def test_ransac_keeps_a_view_within_the_threshold():
    points_px = RIG.project(TRUTH_M)
    points_px[:, 2] += [20.0, 0.0]
    moved_m = np.linalg.norm(triangulate_ransac(points_px, RIG, 30.0) - TRUTH_M, axis=-1)
    # Of four views one is 20 px off, 8 cm at 4.5 m: kept, it pulls the point by some centimetres at most.
    assert np.all((moved_m > 0.001) & (moved_m < 0.05))
    np.testing.assert_allclose(triangulate_ransac(points_px, RIG, 5.0), TRUTH_M, atol=1e-6)


def test_ransac_minimises_the_huber_error_of_its_inliers():
    from scipy.optimize import minimize

    rng = np.random.default_rng(5)
    points_px = RIG.project(TRUTH_M[:1, :4]) + 4.0 * rng.standard_normal((1, 4, 4, 2))
    refined_m = triangulate_ransac(points_px, RIG, 1000.0)  # all views are inliers

    def cost(point_m: np.ndarray, joint: int) -> float:
        error_px = np.linalg.norm(RIG.project(point_m[None])[:, 0] - points_px[0, :, joint], axis=-1)
        return float(np.sum(np.where(error_px < 2.0, error_px**2, 4.0 * error_px - 4.0)))

    for joint in range(4):
        start_m = TRUTH_M[0, joint]
        best = minimize(cost, start_m, (joint,), method="Nelder-Mead", options={"xatol": 1e-8, "fatol": 1e-10})
        # Ten steps of reweighting leave less than a thousandth of the cost to be gained.
        assert cost(refined_m[0, joint], joint) <= best.fun * 1.001


def test_ransac_takes_what_there_is():
    points_px = RIG.project(TRUTH_M)
    points_px[0, 2:, 3] = np.nan  # two views left
    points_px[1, 1:, 3] = np.nan  # one
    points_px[2, :, 3] = np.nan
    result_m = triangulate_ransac(points_px, RIG)
    np.testing.assert_allclose(result_m[0], TRUTH_M[0], atol=1e-6)
    assert np.isnan(result_m[1:3, 3]).all()
    assert np.isfinite(np.delete(result_m, 3, axis=1)).all()


def test_two_views_that_disagree_still_give_a_point():
    points_px = RIG.project(TRUTH_M)[:, :2]
    points_px[:, 1, :, 1] += 100.0
    result_m = triangulate_ransac(points_px, RIG.subset(RIG.names[:2]))
    assert np.isfinite(result_m).all()


@pytest.mark.parametrize(("frequency_hz", "kept"), [(0.5, 1.0), (6.0, 0.5), (20.0, 0.0)])
def test_the_filter_halves_what_is_at_its_cutoff_and_delays_nothing(frequency_hz, kept):
    wave_m = sine_m(frequency_hz)
    inner = slice(100, -100)  # away from the ends, where it has nothing to look at
    filtered_m = low_pass(wave_m, FPS)
    # 2nd order, twice: 1 / (1 + (f/fc)^4) in amplitude, without a change of phase.
    np.testing.assert_allclose(filtered_m[inner, 0, 0], kept * wave_m[inner, 0, 0], atol=5e-3)
    np.testing.assert_allclose(filtered_m[:, 0, 2], 1.0, atol=1e-9)


def test_gaps_are_bridged_and_the_ends_hold():
    line_m = np.linspace(0.0, 1.0, 101)[:, None, None] * np.ones((101, 2, 3))
    gappy_m = line_m.copy()
    gappy_m[40:60, 0] = np.nan
    gappy_m[:10, 0, 1] = np.nan
    gappy_m[:, 1] = np.nan
    filtered_m = low_pass(gappy_m, FPS)
    # A straight line is what the filter keeps; near the held start it bends.
    np.testing.assert_allclose(filtered_m[30:90, 0], line_m[30:90, 0], atol=1e-3)
    assert np.isfinite(filtered_m[:, 0]).all()
    np.testing.assert_allclose(filtered_m[0, 0], 0.1, atol=0.01)
    assert np.isnan(filtered_m[:, 1]).all()


@pytest.mark.parametrize("n_frames", [1, 2, 5])
def test_a_short_recording_is_filtered_too(n_frames):
    still_m = np.ones((n_frames, 3, 3))
    np.testing.assert_allclose(low_pass(still_m, FPS), still_m, atol=1e-9)
