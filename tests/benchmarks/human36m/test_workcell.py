"""Evaluation against a reference whose position drifts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgpose.io.skeletons import load_skeleton
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status, Trajectory
from fgpose_benchmarks.human36m.workcell import aligned_reference, at_times, evaluate_workcell, with_joint_names
from fgpose_benchmarks.synthetic import walking

SKELETON = load_skeleton("h36m_17")
THORAX, WRIST = SKELETON.index("thorax"), SKELETON.index("left_wrist")
RATE = 60.0
TRUTH_M = walking(181, RATE, SKELETON)
TIME_S = np.arange(181) / RATE


def trajectory(positions_m: np.ndarray, time_s: np.ndarray, skeleton: Skeleton = SKELETON) -> Trajectory:
    status = np.where(np.isfinite(positions_m).all(axis=-1), int(Status.OBSERVED), int(Status.UNOBSERVABLE))
    return Trajectory(skeleton=skeleton, time_s=time_s, positions_m=positions_m, status=status)


def drifting() -> Trajectory:
    """The suit: the true shape, whose position walks off by 2 m in 3 s."""
    return trajectory(TRUTH_M + (TIME_S / 3.0)[:, None, None] * np.array([2.0, -1.0, 0.3]), TIME_S)


def estimate() -> Trajectory:
    """Every fourth frame, the left wrist wrong by 34 mm."""
    positions_m = TRUTH_M[::4].copy()
    positions_m[:, WRIST, 1] += 0.034
    return trajectory(positions_m, TIME_S[::4])


def test_drift_is_taken_out_at_the_neck():
    evaluation = evaluate_workcell(estimate(), drifting())
    # one joint of 17 is wrong by 34 mm
    assert evaluation.mpjpe_absolute_mm == pytest.approx(2.0, abs=1e-6)
    assert evaluation.mpjpe_relative_mm == pytest.approx(2.0, abs=1e-6)
    by_joint = {joint.joint: joint.mpjpe_absolute_mm for joint in evaluation.joints}
    assert by_joint["left_wrist"] == pytest.approx(34.0, abs=1e-6)
    assert by_joint["thorax"] == pytest.approx(0.0, abs=1e-6)
    assert (evaluation.n_frames, evaluation.share_missing) == (46, 0)


def test_with_another_tracker_the_neck_is_measured_too():
    offset = estimate()
    moved = replace(offset, positions_m=offset.positions_m + np.array([0.05, 0.0, 0.0]))
    tracker = trajectory(TRUTH_M[:, [THORAX]], TIME_S, Skeleton("neck", ("neck",), (), root=(0,)))
    evaluation = evaluate_workcell(moved, drifting(), tracker)
    by_joint = {joint.joint: joint.mpjpe_absolute_mm for joint in evaluation.joints}
    assert by_joint["thorax"] == pytest.approx(50.0, abs=1e-6)
    assert evaluation.mpjpe_relative_mm == pytest.approx(2.0, abs=1e-6)
    # at its own neck the error of position is gone
    own = evaluate_workcell(moved, drifting())
    assert own.mpjpe_absolute_mm == pytest.approx(2.0, abs=1e-6)


def test_a_clock_of_its_own_is_set_right():
    suit = drifting()
    late = replace(suit, time_s=suit.time_s + 12.5)
    evaluation = evaluate_workcell(estimate(), late, reference_offset_s=-12.5)
    # 12.5 s more leave 1e-15 s less of the time
    assert evaluation.mpjpe_absolute_mm == pytest.approx(2.0, abs=1e-6)


def test_the_reference_is_interpolated():
    line_m = np.linspace(0.0, 1.0, 11)[:, None, None] * np.ones((1, 17, 3))
    between = at_times(trajectory(line_m, np.arange(11) / 20.0), np.array([0.0, 0.02, 0.31, 0.5]))
    np.testing.assert_allclose(between.positions_m[:, 0, 0], [0.0, 0.04, 0.62, 1.0], atol=1e-12)


def test_nothing_is_made_up_outside_and_in_gaps():
    time_s = np.array([0.0, 0.05, 0.10, 0.50, 0.55])
    points_m = np.ones((5, 17, 3))
    points_m[1, WRIST] = np.nan
    moved = at_times(trajectory(points_m, time_s), np.array([-0.01, 0.02, 0.05, 0.10, 0.30, 0.50, 0.56]))
    known = np.asarray(np.isfinite(moved.positions_m).all(axis=-1))
    assert known[:, 0].tolist() == [False, True, True, True, False, True, False]
    # exactly on a frame its neighbours do not matter, between frames both do
    assert known[:, WRIST].tolist() == [False, False, False, True, False, True, False]
    np.testing.assert_array_equal(moved.status == Status.OBSERVED, known)


def test_frames_without_a_neck_are_not_scored():
    partly = estimate()
    positions_m = partly.positions_m.copy()
    positions_m[:23, THORAX] = np.nan
    evaluation = evaluate_workcell(trajectory(positions_m, partly.time_s), drifting())
    assert evaluation.share_missing == pytest.approx(0.5)
    assert evaluation.mpjpe_absolute_mm == pytest.approx(2.0, abs=1e-6)
    positions_m = partly.positions_m.copy()
    positions_m[:, THORAX] = np.nan
    with pytest.raises(ValueError, match="nothing can be aligned"):
        evaluate_workcell(trajectory(positions_m, partly.time_s), drifting())


def test_segments_of_the_suit_are_joints_by_their_origins():
    segments = ("pelvis", "neck", "right_shoulder", "right_upper_arm", "right_fore_arm", "right_hand", "left_foot")
    joints = with_joint_names(Skeleton("mvn", segments, (), root=(0,))).joints
    wanted = ("pelvis", "neck", "right_shoulder_segment", "right_shoulder", "right_elbow", "right_wrist", "left_ankle")
    assert joints == wanted
    assert with_joint_names(SKELETON) is SKELETON


def test_the_middle_of_the_shoulders_stands_in_for_a_neck():
    kept = [SKELETON.index(name) for name in ("left_shoulder", "right_shoulder", "left_hip", "right_hip", "left_wrist")]
    part = Skeleton("part", tuple(SKELETON.joints[joint] for joint in kept), (), root=(2, 3))
    without = trajectory(drifting().positions_m[:, kept], TIME_S, part)
    aligned = aligned_reference(estimate(), without)
    np.testing.assert_allclose(aligned.positions_m, TRUTH_M[::4][:, kept], atol=1e-9)
    with pytest.raises(ValueError, match="skeleton part has no joint 'thorax'"):
        aligned_reference(estimate(), without, neck="thorax")
    feet = Skeleton("feet", ("left_ankle",), (), root=(0,))
    with pytest.raises(ValueError, match="there is no neck"):
        aligned_reference(estimate(), trajectory(TRUTH_M[:, [6]], TIME_S, feet))


def test_recordings_of_different_times_are_refused():
    with pytest.raises(ValueError, match="no time in common: one trajectory lasts from 100 to 103 s"):
        evaluate_workcell(estimate(), drifting(), reference_offset_s=100.0)
