"""Trajectories: shapes are checked, status is counted, residuals are distances in the image."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fgpose.config import Config
from fgpose.geometry.reprojection import reprojection_residual_px
from fgpose.observations import Observations
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Convergence, Estimate, Status, Trajectory
from fgpose_benchmarks.synthetic import Scene

FRAMES = 4


@pytest.fixture
def parts(skeleton: Skeleton) -> dict[str, Any]:
    status = np.full((FRAMES, 17), Status.OBSERVED)
    status[0] = Status.PREDICTED
    status[1, :8] = Status.UNOBSERVABLE
    return {
        "skeleton": skeleton,
        "time_s": np.arange(FRAMES) / 50,
        "positions_m": np.zeros((FRAMES, 17, 3)),
        "status": status,
        "camera_names": ("a", "b"),
    }


def test_status_is_counted_over_joints_and_frames(parts: dict[str, Any]) -> None:
    trajectory = Trajectory(**parts)
    assert trajectory.n_frames == FRAMES
    assert trajectory.status_share(Status.PREDICTED) == 17 / 68
    assert trajectory.status_share(Status.UNOBSERVABLE) == 8 / 68
    assert trajectory.observed.sum() == 68 - 17 - 8
    assert sum(map(trajectory.status_share, Status)) == pytest.approx(1)


def test_all_shapes_that_belong_together_are_taken(parts: dict[str, Any], skeleton: Skeleton) -> None:
    trajectory = Trajectory(
        **parts,
        covariance_m2=np.zeros((FRAMES, 17, 3, 3)),
        residual_px=np.zeros((FRAMES, 2, 17)),
        visibility=np.ones((FRAMES, 2, 17)),
        bone_lengths_m=np.zeros(skeleton.n_lengths),
    )
    assert trajectory.n_frames == FRAMES


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("positions_m", (FRAMES, 16, 3)),
        ("status", (FRAMES + 1, 17)),
        ("covariance_m2", (FRAMES, 17, 3)),
        ("residual_px", (FRAMES, 3, 17)),
        ("visibility", (FRAMES, 2, 16)),
        ("bone_lengths_m", (16,)),
        ("bone_length_sigma_m", (16,)),
    ],
)
def test_a_shape_that_does_not_fit_is_one_clear_error(parts: dict[str, Any], name: str, shape: tuple[int, ...]) -> None:
    parts[name] = np.zeros(shape)
    with pytest.raises(ValueError, match=rf"{name} must be \(.*\), got \({shape[0]},"):
        Trajectory(**parts)


def test_a_result_cannot_be_changed(parts: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="read-only"):
        Trajectory(**parts).positions_m[0] = 1
    estimate = Estimate(parts["skeleton"], 0, 0.0, np.zeros((parts["skeleton"].n_joints, 3)), np.zeros(3))
    with pytest.raises(ValueError, match="read-only"):
        estimate.positions_m[0] = 1


def test_some_frames_by_slice_and_by_time(parts: dict[str, Any], skeleton: Skeleton) -> None:
    positions_m = np.arange(FRAMES * 17 * 3, dtype=float).reshape(FRAMES, 17, 3)
    trajectory = Trajectory(**(parts | {"positions_m": positions_m}), implausible_frames=(2,))
    np.testing.assert_array_equal(trajectory[1:3].positions_m, positions_m[1:3])
    np.testing.assert_array_equal(trajectory[::2].time_s, [0, 2 / 50])
    cropped = trajectory.crop(1 / 50, 2 / 50)
    np.testing.assert_array_equal(cropped.time_s, [1 / 50, 2 / 50])
    assert cropped.implausible_frames == (1,)
    with pytest.raises(ValueError, match=r"no frame is from 2 s to 5 s: there are frames from 0 s to 0\.06 s"):
        trajectory.crop(2.0, 5.0)
    with pytest.raises(ValueError, match="there is nothing from 5 s to 2 s"):
        trajectory.crop(5.0, 2.0)
    with pytest.raises(ValueError, match="frames are taken forward in time: a step of -1 would turn the recording"):
        trajectory[::-1]


def test_numbers_of_frames_are_taken_as_slices(parts: dict[str, Any]) -> None:
    trajectory = Trajectory(**parts)
    assert len(trajectory) == len(trajectory[:]) == FRAMES
    frames: tuple[tuple[Any, str], ...] = (
        (2, r"\[2:3\]"),
        ((1, 2), r"\[0:1\]"),
        (np.ones(FRAMES, dtype=bool), r"\.frames\(mask\)"),
    )
    for wanted, shown in frames:
        with pytest.raises(TypeError, match=f"joints and angles are taken by name, frames as a slice, .*{shown}"):
            trajectory[wanted]


def test_several_joints_by_name(parts: dict[str, Any], skeleton: Skeleton) -> None:
    positions_m = np.arange(FRAMES * 17 * 3, dtype=float).reshape(FRAMES, 17, 3)
    trajectory = Trajectory(**(parts | {"positions_m": positions_m}))
    both = trajectory[["left_wrist", "left_elbow"]]
    assert both.shape == (FRAMES, 2, 3)
    np.testing.assert_array_equal(both[:, 0], trajectory["left_wrist"])
    np.testing.assert_array_equal(both[:, 1], trajectory["left_elbow"])
    with pytest.raises(ValueError, match="no joint 'left_wirst'"):
        trajectory[["left_elbow", "left_wirst"]]


def test_parts_become_the_whole_again(parts: dict[str, Any], skeleton: Skeleton) -> None:
    whole = Trajectory(
        **(parts | {"positions_m": np.arange(FRAMES * 17 * 3, dtype=float).reshape(FRAMES, 17, 3)}),
        covariance_m2=np.ones((FRAMES, 17, 3, 3)),
        residual_px=np.arange(FRAMES * 34, dtype=float).reshape(FRAMES, 2, 17),
        bone_lengths_m=np.full(skeleton.n_lengths, np.nan),
        convergence=Convergence(True, 3, 2.0, 1.0),
        implausible_frames=(0, 3),
        config=Config(),
    )
    again = Trajectory.concatenate([whole[:1], whole[1:3], whole[3:]])
    for name in ("time_s", "positions_m", "status", "covariance_m2", "residual_px", "bone_lengths_m"):
        np.testing.assert_array_equal(getattr(again, name), getattr(whole, name))
    assert (again.implausible_frames, again.visibility, again.config) == ((0, 3), None, Config())
    assert again.convergence == Convergence(True, 3, 6.0, 3.0)


def test_what_parts_do_not_share_is_left_out_or_refused(parts: dict[str, Any], skeleton: Skeleton) -> None:
    first = Trajectory(**parts, covariance_m2=np.ones((FRAMES, 17, 3, 3)), bone_lengths_m=np.ones(skeleton.n_lengths))
    later = replace(first, time_s=first.time_s + 1)
    other = replace(later, covariance_m2=None, bone_lengths_m=np.full(skeleton.n_lengths, 2.0))
    joined = Trajectory.concatenate([first, other])
    assert (joined.n_frames, joined.covariance_m2, joined.bone_lengths_m) == (2 * FRAMES, None, None)
    for wrong, message in (
        ([], "there is no trajectory"),
        ([later, first], r"time must increase: a frame at 0 s follows one at 1\.06 s"),
        ([first, replace(later, camera_names=("a", "c"))], "trajectories 0 and 1 have another camera_names"),
        ([first, replace(later, skeleton=replace(skeleton, name="b"))], "trajectories 0 and 1 have another skeleton"),
    ):
        with pytest.raises(ValueError, match=message):
            Trajectory.concatenate(wrong)


def estimate(skeleton: Skeleton, frame: int, **parts: Any) -> Estimate:
    positions_m = np.full((17, 3), float(frame))
    return Estimate(skeleton, frame, frame / 50, positions_m, np.full(17, Status.OBSERVED), **parts)


def test_joints_by_name(parts: dict[str, Any], skeleton: Skeleton) -> None:
    positions_m = np.arange(FRAMES * 17 * 3, dtype=float).reshape(FRAMES, 17, 3)
    trajectory = Trajectory(**(parts | {"positions_m": positions_m}))
    wrist = skeleton.joints.index("left_wrist")
    np.testing.assert_array_equal(trajectory["left_wrist"], positions_m[:, wrist])
    newest = Estimate(skeleton, 0, 0.0, positions_m[2], np.zeros(17))
    np.testing.assert_array_equal(newest["left_wrist"], positions_m[2, wrist])
    for result in (trajectory, newest):
        with pytest.raises(ValueError, match=r"no joint 'left_wirst' \(did you mean left_wrist\?\); it has pelvis, "):
            result["left_wirst"]


def test_estimates_become_a_trajectory(skeleton: Skeleton) -> None:
    covariance_m2, residual_px = np.ones((17, 3, 3)), np.ones((2, 17))
    estimates = [
        estimate(skeleton, frame, covariance_m2=frame * covariance_m2, residual_px=frame * residual_px)
        for frame in (3, 4, 6)
    ]
    trajectory = Trajectory.from_estimates(estimates, ("a", "b"), Config())
    assert (trajectory.skeleton, trajectory.camera_names, trajectory.config) == (skeleton, ("a", "b"), Config())
    np.testing.assert_array_equal(trajectory.time_s, [3 / 50, 4 / 50, 6 / 50])
    np.testing.assert_array_equal(trajectory["left_wrist"][:, 0], [3, 4, 6])
    assert trajectory.observed.all()
    assert trajectory.covariance_m2 is not None
    assert trajectory.residual_px is not None
    np.testing.assert_array_equal(trajectory.covariance_m2[:, 5, 1, 2], [3, 4, 6])
    np.testing.assert_array_equal(trajectory.residual_px[:, 1, 5], [3, 4, 6])


def test_what_not_all_estimates_have_is_left_out(skeleton: Skeleton) -> None:
    covariance_m2, residual_px = np.ones((17, 3, 3)), np.ones((2, 17))
    estimates = [estimate(skeleton, 0, residual_px=residual_px), estimate(skeleton, 1, covariance_m2=covariance_m2)]
    trajectory = Trajectory.from_estimates(estimates, ("a", "b"))
    assert trajectory.covariance_m2 is None
    assert trajectory.residual_px is None
    assert Trajectory.from_estimates(estimates[:1]).residual_px is None, "residuals belong to cameras with names"


def test_of_several_estimates_of_one_frame_the_last_counts(skeleton: Skeleton) -> None:
    first, again, second = (estimate(skeleton, frame) for frame in (0, 0, 1))
    better = Estimate(skeleton, 0, 0.0, first.positions_m + 1, first.status)
    trajectory = Trajectory.from_estimates([first, again, better, second])
    np.testing.assert_array_equal(trajectory["pelvis"][:, 0], [1, 1])


def test_a_trajectory_of_no_estimate_is_an_error() -> None:
    with pytest.raises(ValueError, match="at least one estimate"):
        Trajectory.from_estimates([])


def test_the_worst_of_several_problems() -> None:
    parts = [Convergence(True, 5, 10.0, 1.0), Convergence(False, 3, 20.0, 2.0)]
    assert Convergence.worst(parts) == Convergence(False, 5, 30.0, 3.0)


def test_residuals_are_distances_to_the_detections(walking_scene: Scene) -> None:
    observed = walking_scene.observations
    shift_px = np.array([3.0, 4.0])
    exact_px = walking_scene.rig.project(walking_scene.truth_m) + shift_px
    exact_px[2, 1, 5] = np.nan
    shifted = Observations(observed.skeleton, observed.time_s, exact_px, camera_names=observed.camera_names)
    residual_px = reprojection_residual_px(
        walking_scene.rig.undistort(shifted.points2d_px), walking_scene.rig, walking_scene.truth_m
    )
    assert np.isnan(residual_px[2, 1, 5])
    # 3-4-5; rounding of pixels of order 1e3.
    np.testing.assert_allclose(residual_px[np.isfinite(residual_px)], 5.0, atol=1e-9)
    assert np.isfinite(residual_px).sum() == residual_px.size - 1


def test_as_part_of_more_frames_nothing_is_known_of_the_others(skeleton: Skeleton) -> None:
    known = Trajectory.from_estimates([estimate(skeleton, 0, covariance_m2=np.ones((17, 3, 3)))])
    time_s = np.array([0.0, 0.1, 0.2])
    whole = known.in_frames(time_s, np.array([1]))
    np.testing.assert_array_equal(whole.time_s, time_s)
    np.testing.assert_array_equal(whole.positions_m[1], known.positions_m[0])
    assert np.isnan(whole.positions_m[[0, 2]]).all()
    assert (whole.status[[0, 2]] == Status.UNOBSERVABLE).all()
    np.testing.assert_array_equal(whole.status[1], known.status[0])
    assert whole.covariance_m2 is not None
    assert np.isnan(whole.covariance_m2[[0, 2]]).all()
    assert whole.residual_px is None
