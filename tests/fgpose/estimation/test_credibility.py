"""An agreement of views that say themselves that they guess is not claimed to be known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose.assessment.metrics import nees
from fgpose.estimation.credibility import RunningUsual, credible, usual_confidence
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.skeleton import Skeleton
from fgpose.synthetic import NO_OCCLUSION, DetectionNoise, simulate, walking
from fgpose.trajectory import Status, Trajectory

FPS = 30.0
OF_99 = 11.345  # chi square, three degrees of freedom


def of_joints(*confidence: float) -> np.ndarray:
    """The same in two cameras."""
    return np.array([[confidence, confidence]])


def test_a_joint_is_as_credible_as_its_most_confident_camera() -> None:
    usual = usual_confidence(of_joints(0.8, 0.8, 0.8, 0.04))
    np.testing.assert_allclose(usual, 0.8)
    np.testing.assert_array_equal(credible(of_joints(0.8, 0.4, 0.3, 0.04), usual)[0], [1, 1, 1, 0])
    one_is_sure = np.array([[[0.7, 0.05], [0.05, 0.05]]])
    np.testing.assert_array_equal(credible(one_is_sure, usual)[0], [1, 0])
    np.testing.assert_array_equal(credible(of_joints(0.0), usual)[0], [1])  # nothing is detected, nothing is said


def test_low_confidence_that_is_usual_tells_nothing() -> None:
    for low in (0.3, 0.05, 1e-6):
        confidence = of_joints(low, 1.5 * low, low, low)
        np.testing.assert_array_equal(credible(confidence, usual_confidence(confidence))[0], 1.0)
    assert np.isnan(usual_confidence(of_joints(0.0)))
    np.testing.assert_array_equal(credible(of_joints(0.3), np.nan)[0], [1])


def test_where_some_confidence_is_high_it_is_a_probability() -> None:
    """Most of the person is hidden: the joints that are guessed are not usual because they are many."""
    confidence = of_joints(0.95, *[0.05] * 9)
    assert credible(confidence, usual_confidence(confidence))[0, 1:].max() < 0.1


def test_of_a_stream() -> None:
    running = RunningUsual()
    assert np.isnan(running.after(of_joints(0.0)))
    assert [running.after(of_joints(0.8)) for _ in range(3)] == pytest.approx([0.8] * 3)
    assert running.after(of_joints(0.05)) == pytest.approx(0.61, abs=0.01)  # the mean of four


def legs_guessed(rig: CameraRig, skeleton: Skeleton, confidence: float) -> tuple[Observations, np.ndarray, list[int]]:
    """All views put the legs straight down; in truth the person sits. And the truth, and the joints of the legs."""
    guessed_m = walking(45, FPS, skeleton)
    truth_m, legs = guessed_m.copy(), []
    for side in ("left", "right"):
        hip, knee, ankle = (skeleton.index(f"{side}_{joint}") for joint in ("hip", "knee", "ankle"))
        thigh_m = np.linalg.norm(guessed_m[:, knee] - guessed_m[:, hip], axis=-1, keepdims=True)
        shank_m = np.linalg.norm(guessed_m[:, ankle] - guessed_m[:, knee], axis=-1, keepdims=True)
        truth_m[:, knee] = guessed_m[:, hip] + thigh_m * np.array([1.0, 0.0, 0.0])
        truth_m[:, ankle] = truth_m[:, knee] - shank_m * np.array([0.0, 0.0, 1.0])
        legs += [knee, ankle]
    seen = simulate(guessed_m, skeleton, rig, FPS, DetectionNoise(), NO_OCCLUSION, seed=1).observations
    stated = seen.confidence.copy()
    stated[..., legs] = np.where(stated[..., legs] > 0, confidence, 0.0)
    return replace(seen, confidence=stated), truth_m, legs


def share_within(trajectory: Trajectory, truth_m: np.ndarray, joints: list[int]) -> float:
    assert trajectory.covariance_m2 is not None
    squared = nees((trajectory.positions_m - truth_m)[:, joints], trajectory.covariance_m2[:, joints])
    return float(np.mean(squared < OF_99))


def test_guesses_are_predicted_and_their_claims_contain_the_truth(rig: CameraRig, skeleton: Skeleton) -> None:
    observations, truth_m, legs = legs_guessed(rig, skeleton, 0.05)
    trajectory = fgpose.smooth(observations, rig)
    rest = [joint for joint in range(skeleton.n_joints) if joint not in legs]
    assert (trajectory.status[:, legs] == Status.PREDICTED).all()
    assert (trajectory.status[:, rest] == Status.OBSERVED).mean() > 0.99
    # The legs are off by 0.5 m and more in every frame: all of the errors, not 99 %, but one kind of them.
    assert share_within(trajectory, truth_m, legs) > 0.95
    assert trajectory.covariance_m2 is not None
    sigma_m = np.sqrt(np.trace(trajectory.covariance_m2, axis1=-2, axis2=-1) / 3)
    assert sigma_m[:, rest].max() < 0.05  # the others are known as before
    assert trajectory.visibility is not None
    assert np.nanmax(trajectory.visibility[:, :, legs]) < 0.5


def test_guesses_are_predicted_online(rig: CameraRig, skeleton: Skeleton) -> None:
    observations, truth_m, legs = legs_guessed(rig, skeleton, 0.05)
    estimator = fgpose.Estimator(rig, skeleton)
    estimate = [estimator.update(frame) for frame in observations][-1]
    assert (estimate.status[legs] == Status.PREDICTED).all()
    assert (np.delete(estimate.status, legs) == Status.OBSERVED).all()
    assert estimate.covariance_m2 is not None
    squared = nees((estimate.positions_m - truth_m[-1])[legs], estimate.covariance_m2[legs])
    assert squared.max() < OF_99


def test_the_same_with_the_confidence_of_all_joints(rig: CameraRig, skeleton: Skeleton) -> None:
    """A detector whose numbers are all low is believed as one that says 1."""
    observations, _, _ = legs_guessed(rig, skeleton, 0.05)
    stated = np.where(observations.confidence > 0, 0.05, 0.0)
    trajectory = fgpose.smooth(replace(observations, confidence=stated), rig)
    assert (trajectory.status == Status.OBSERVED).mean() > 0.99


def test_detections_below_a_confidence_are_taken_for_missing(rig: CameraRig, skeleton: Skeleton) -> None:
    observations, _, legs = legs_guessed(rig, skeleton, 0.05)
    kept = observations.confident(0.1)
    assert not kept.seen[:, :, legs].any()
    assert np.isnan(kept.points2d_px[:, :, legs]).all()
    others = np.delete(observations.confidence, legs, axis=2)
    np.testing.assert_array_equal(np.delete(kept.confidence, legs, axis=2), np.where(others < 0.1, 0.0, others))
    assert observations.confident(0.0) is observations
    with pytest.raises(ValueError, match=r"between 0 and 1, got 5"):
        observations.confident(5.0)
