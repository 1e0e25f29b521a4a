from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from fgpose.assessment.evaluation import align_by_name, evaluate
from fgpose.io.skeletons import load_skeleton
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status, Trajectory

SKELETON = Skeleton("four", ("left_hip", "right_hip", "nose", "neck"), bones=((0, 1),), root=(0, 1))


def make(positions_m: np.ndarray, time_s: np.ndarray, skeleton: Skeleton = SKELETON) -> Trajectory:
    status = np.full(positions_m.shape[:2], Status.OBSERVED)
    return Trajectory(skeleton, time_s, positions_m, status)


@pytest.fixture
def reference() -> Trajectory:
    rng = np.random.default_rng(0)
    return make(rng.normal(size=(12, 4, 3)), np.arange(12) / 60)


def test_a_trajectory_agrees_with_itself(reference):
    scores = evaluate(reference, reference)
    assert scores.mpjpe_absolute_mm == scores.mpjpe_relative_mm == scores.acceleration_error_mps2 == 0.0
    # rounding of the alignment, in millimetres
    assert scores.pa_mpjpe_mm < 1e-9
    assert scores.jitter_estimate_mps3 == scores.jitter_reference_mps3 > 0
    assert (scores.pck, scores.n_joints, scores.n_frames, scores.share_missing) == (1.0, 4, 12, 0.0)
    assert scores.nees is None
    assert scores.coverage_95 is None


def test_errors_of_each_joint_in_millimetres(reference):
    positions_m = reference.positions_m.copy()
    positions_m[..., 0] += 0.1
    positions_m[:, 2, 1] += 0.2
    positions_m[:3, 3] = np.nan
    scores = evaluate(make(positions_m, reference.time_s), reference)
    by_name = {score.joint: score for score in scores.joints}
    assert by_name["left_hip"].mpjpe_absolute_mm == pytest.approx(100)
    assert by_name["left_hip"].mpjpe_relative_mm == pytest.approx(0, abs=1e-9)
    assert by_name["nose"].mpjpe_absolute_mm == pytest.approx(1000 * 0.05**0.5)
    assert by_name["nose"].mpjpe_relative_mm == pytest.approx(200)
    assert (by_name["nose"].pck, by_name["neck"].pck) == (0.0, 1.0)
    assert by_name["neck"].share_missing == 3 / 12
    assert scores.share_missing == 3 / 48
    # 12 frames of the hips and nose, 9 of the neck
    assert scores.mpjpe_relative_mm == pytest.approx(200 * 12 / 45)
    assert scores.pck == pytest.approx(33 / 45)


def test_joints_are_matched_by_name_in_the_order_of_the_estimate(reference):
    other = Skeleton("other", ("neck", "tail", "right_hip"), bones=(), root=(0,))
    positions_m = reference.positions_m[:, [3, 0, 1]].copy()
    positions_m[:, 1] += 100
    a_m, b_m, names = align_by_name(make(positions_m, reference.time_s, other), reference)
    assert names == ("neck", "right_hip")
    np.testing.assert_array_equal(a_m, b_m)


def test_frames_are_matched_by_time(reference):
    """A reference at twice the rate, between whose frames those of the estimate lie, and that begins later."""
    time_s = 0.05 + np.arange(60) / 120 + 0.002
    positions_m = np.tile(np.arange(60.0)[:, None, None], (1, 4, 3))
    fast = make(positions_m, time_s)
    _, b_m, _ = align_by_name(reference, fast)
    # the estimate's frames 4, 5, ... lie at 0.0667, 0.0833, ...; its frame 3 is before the first of the reference
    np.testing.assert_allclose(b_m[:, 0, 0], (np.arange(4, 12) / 60 - 0.052) * 120, atol=1e-9)
    a_m, _, _ = align_by_name(fast, reference)
    np.testing.assert_array_equal(a_m, b_m)


def test_another_rate_is_no_error_of_the_estimate():
    """A limb on a circle of 0.3 m at 2 Hz, 3.8 m/s; the nearest frame at 100 Hz is up to 5 ms, 19 mm, away."""

    def moving(rate_hz: float, covariance_m2: float | None = None) -> Trajectory:
        time_s = np.arange(0, 2, 1 / rate_hz)
        angle = 4 * np.pi * time_s
        circle_m = 0.3 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
        found = make(np.tile(circle_m[:, None], (1, 4, 1)), time_s)
        if covariance_m2 is None:
            return found
        return dataclasses.replace(found, covariance_m2=np.tile(covariance_m2 * np.eye(3), (len(time_s), 4, 1, 1)))

    for estimate, reference in ((moving(60), moving(100)), (moving(100, 1e-6), moving(60))):
        scores = evaluate(estimate, reference)
        # Half of the sagitta of the chord at most, a v^2/r: 47 m/s^2 (10 ms)^2 / 8.
        assert scores.mpjpe_absolute_mm < 0.6
        # The last frame at 60 Hz is at 1.983 s.
        assert scores.n_frames == 120
    assert (scores.nees or 0) < 3
    assert evaluate(moving(60), moving(120)).mpjpe_absolute_mm == pytest.approx(0, abs=1e-9)


def test_nothing_is_interpolated_across_a_gap(reference):
    fast = make(np.zeros((60, 4, 3)), np.arange(60) / 240)
    kept = np.r_[0:8, 20:60]
    scores = evaluate(reference, make(fast.positions_m[kept], fast.time_s[kept] + 0.001))
    # 0.001 to 0.030 s and 0.084 s to the end are there: frames 1 and 6 to 11 of the estimate.
    assert scores.n_frames == 7


def test_no_frame_is_used_twice(reference):
    slow = make(reference.positions_m[::4].copy(), reference.time_s[::4])
    assert evaluate(reference, slow).n_frames == evaluate(slow, reference).n_frames == 3


def test_frames_farther_apart_than_half_an_interval_do_not_match(reference):
    gap = np.array([0, 1, 2, 8, 9, 10, 11])
    scores = evaluate(make(reference.positions_m[gap].copy(), reference.time_s[gap]), reference)
    assert scores.n_frames == 7
    assert scores.mpjpe_absolute_mm == 0.0


def test_a_clock_of_its_own_is_set_by_an_offset(reference):
    shifted = make(reference.positions_m.copy(), reference.time_s + 100)
    with pytest.raises(ValueError, match=r"no frame in common.*0 to 0\.183333 s.*100 to 100\.183 s"):
        evaluate(reference, shifted)
    assert evaluate(reference, shifted, reference_offset_s=-100.0).mpjpe_absolute_mm == 0.0


def test_single_frames_match_when_their_times_are_equal(reference):
    one = make(reference.positions_m[:1].copy(), np.zeros(1))
    scores = evaluate(one, one)
    assert scores.n_frames == 1
    assert np.isnan(scores.jitter_estimate_mps3)
    with pytest.raises(ValueError, match="no frame in common"):
        evaluate(one, make(reference.positions_m[:1].copy(), np.ones(1)))
    assert evaluate(one, reference).n_frames == evaluate(reference, one).n_frames == 1


def test_nothing_in_common_is_an_error_that_shows_both_sides(reference):
    tail = Skeleton("tail", ("tail",), bones=(), root=(0,))
    with pytest.raises(ValueError, match=r"estimate has tail; the reference has left_hip"):
        evaluate(make(np.zeros((12, 1, 3)), reference.time_s, tail), reference)
    empty = make(np.zeros((0, 4, 3)), np.zeros(0))
    with pytest.raises(ValueError, match="no frame in common"):
        evaluate(empty, reference)


def test_relative_errors_need_a_root_on_both_sides(reference):
    headed = Skeleton("headed", ("left_hip", "nose", "neck", "pelvis"), bones=(), root=(3,))
    positions_m = np.zeros((12, 4, 3))
    scores = evaluate(make(positions_m, reference.time_s, headed), reference)
    assert np.isnan(scores.mpjpe_relative_mm)
    assert np.isfinite(scores.mpjpe_absolute_mm)
    # with both hips the reference's root serves, although the estimate's is another
    hips = Skeleton("hips", ("left_hip", "right_hip", "nose", "pelvis"), bones=(), root=(3,))
    assert np.isfinite(evaluate(make(positions_m, reference.time_s, hips), reference).mpjpe_relative_mm)


def test_covariance_is_measured_where_there_is_one():
    rng = np.random.default_rng(0)
    n_frames, sigma_m = 200, 0.03
    reference_m = rng.normal(size=(n_frames, 4, 3))
    estimate_m = reference_m + rng.normal(scale=sigma_m, size=reference_m.shape)
    covariance_m2 = np.broadcast_to(sigma_m**2 * np.eye(3), (n_frames, 4, 3, 3)).copy()
    time_s = np.arange(n_frames) / 50
    estimate = dataclasses.replace(make(estimate_m, time_s), covariance_m2=covariance_m2)
    scores = evaluate(estimate, make(reference_m, time_s))
    # the mean of 800 chi2(3), standard deviation sqrt(6 / 800) = 0.087, and a binomial share, 0.0077: 3.3 of each
    assert scores.nees == pytest.approx(3.0, abs=0.29)
    assert scores.coverage_95 == pytest.approx(0.95, abs=0.026)


def test_different_skeletons_share_what_their_names_share():
    coco, halpe = load_skeleton("coco_17"), load_skeleton("halpe_26")
    time_s = np.arange(5) / 50
    scores = evaluate(make(np.zeros((5, 17, 3)), time_s, coco), make(np.zeros((5, 26, 3)), time_s, halpe))
    assert scores.n_joints == 17
