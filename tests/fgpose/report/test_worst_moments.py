"""The worst moments of a report: whatever is planted is among them, once."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from finished_walk import changed, finished_walk

from fgpose.geometry.camera import CameraRig
from fgpose.report import FinishedRecording
from fgpose.report.sections.worst_moments import WorstMoment, worst_moments
from fgpose.skeleton import Skeleton


@pytest.fixture(scope="module")
def walk(rig: CameraRig, skeleton: Skeleton) -> FinishedRecording:
    return finished_walk(rig, skeleton)


def at(moments: list[WorstMoment], first: int, last: int) -> WorstMoment:
    (found,) = [moment for moment in moments if first <= moment.frame <= last]
    return found


def with_errors(
    walk: FinishedRecording, frames: slice, camera: int, error_px: float, believed: bool = False
) -> FinishedRecording:
    """Of all joints of one camera; the median of the others is 4.7 px."""
    residual_px, visibility = np.array(walk.main.residual_px), np.array(walk.main.visibility)
    residual_px[frames, camera] = error_px
    visibility[frames, camera] = 0.97 if believed else 0.01
    return changed(walk, residual_px=residual_px, visibility=visibility)


def test_uncertainty_that_grows_is_a_worst_moment(walk: FinishedRecording) -> None:
    covariance_m2 = np.array(walk.main.covariance_m2)
    covariance_m2[200:204] *= 100
    moments = worst_moments(changed(walk, covariance_m2=covariance_m2))
    assert len(moments) == 5
    worst = at(moments, 200, 203)
    assert worst is moments[0]
    assert worst.reason.startswith("sigma of ")
    assert worst.reason.endswith("4 of 4 cameras see " + worst.joints[0])
    # One moment is not two.
    assert (np.diff(sorted(moment.time_s for moment in moments)) >= 0.1).all()


@pytest.mark.parametrize("believed", [False, True])
@pytest.mark.parametrize("n_frames", [1, 30])  # 30 are a tenth of all: what is seldom exceeded is exceeded
def test_a_spike_of_one_camera_is_a_worst_moment(walk: FinishedRecording, n_frames: int, believed: bool) -> None:
    planted = with_errors(walk, slice(140, 140 + n_frames), 2, 54.0, believed)
    # Sigma, too, has peaks, five of them and higher ones.
    covariance_m2 = np.array(walk.main.covariance_m2)
    covariance_m2[[10, 60, 110, 200, 260]] *= 1e4
    moments = worst_moments(changed(planted, covariance_m2=covariance_m2))
    worst = at(moments, 140, 139 + n_frames)
    assert worst.reason.startswith("camera ring_2 is 54 px beside the result, median of its joints, 1")


def test_one_joint_that_is_far_off_is_a_worst_moment(walk: FinishedRecording) -> None:
    residual_px = np.array(walk.main.residual_px)
    joint = walk.main.skeleton.index("left_wrist")
    residual_px[77, 1, joint] = 150
    worst = at(worst_moments(changed(walk, residual_px=residual_px)), 77, 77)
    assert worst.joints[0] == "left_wrist"
    assert worst.reason.startswith("reprojection error of left_wrist")


def test_what_else_is_large_is_said_too(walk: FinishedRecording) -> None:
    covariance_m2 = np.array(walk.main.covariance_m2)
    covariance_m2[140, 0] *= 100**2
    worst = at(
        worst_moments(changed(with_errors(walk, slice(140, 141), 2, 54.0), covariance_m2=covariance_m2)), 140, 140
    )
    assert f"sigma of {walk.main.skeleton.joints[0]} 100.0 times the usual" in worst.reason
    assert "camera ring_2 is 54 px beside the result" in worst.reason


def test_a_jump_is_a_worst_moment(walk: FinishedRecording) -> None:
    positions_m = walk.main.positions_m.copy()
    positions_m[150:] += (0.3, 0.0, 0.0)
    worst = at(worst_moments(changed(walk, positions_m=positions_m)), 149, 150)
    assert worst.reason.startswith("change of velocity of ")


def test_frames_that_are_missing_are_no_change_of_velocity(walk: FinishedRecording) -> None:
    over_time = ("time_s", "positions_m", "status", "covariance_m2", "residual_px", "visibility")
    arrays: dict[str, Any] = {
        name: np.delete(np.array(getattr(walk.main, name)), slice(150, 165), axis=0) for name in over_time
    }
    gap = FinishedRecording("gap", {0: replace(walk.main, **arrays)}, walk.rig)
    assert not [moment for moment in worst_moments(gap) if 145 <= moment.frame <= 155]


def test_the_largest_of_each_kind_is_there_in_short_recordings_too(walk: FinishedRecording) -> None:
    planted = with_errors(walk, slice(20, 21), 0, 54.0)
    over_time = ("time_s", "positions_m", "status", "covariance_m2", "residual_px", "visibility")
    main = planted.main
    arrays: dict[str, Any] = {name: np.array(getattr(main, name))[:45] for name in over_time}
    short = replace(main, **arrays)
    moments = worst_moments(FinishedRecording("short", {0: short}, walk.rig))
    assert at(moments, 20, 20).reason.startswith("camera ring_0 is 54 px")
    assert len(moments) >= 3


def test_a_spike_of_somebody_else_is_a_worst_moment(walk: FinishedRecording) -> None:
    other = with_errors(walk, slice(99, 100), 3, 54.0).main
    moments = worst_moments(replace(walk, people={0: walk.main, 5: other}, observations={}))
    assert at([moment for moment in moments if moment.person == 5], 99, 99).reason.startswith("camera ring_3 is 54 px")
    # It is the same motion: at the same time something may be wrong with both.
    assert len(moments) == 5


def test_a_single_frame_is_no_trouble(walk: FinishedRecording) -> None:
    over_time = ("time_s", "positions_m", "status", "covariance_m2", "residual_px", "visibility")
    arrays: dict[str, Any] = {name: np.array(getattr(walk.main, name))[:1] for name in over_time}
    one = replace(walk.main, **arrays)
    assert [moment.frame for moment in worst_moments(FinishedRecording("one", {0: one}, walk.rig))] == [0]
