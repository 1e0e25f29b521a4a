"""An agreement of views that say themselves that they guess is not claimed to be known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose.assessment.metrics import nees
from fgpose.estimation.evidence.credibility import RunningCredibility, credible, usual_confidence
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status, Trajectory
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, simulate, walking

FPS = 30.0
OF_99 = 11.345  # chi square, three degrees of freedom


def of_joints(*confidence: float) -> np.ndarray:
    """The same in two cameras."""
    return np.array([[confidence, confidence]])


def at_once(confidence: np.ndarray) -> np.ndarray:
    """How credible the joints of the first image are, with nothing before or after it."""
    return credible(confidence, 10.0 * np.arange(len(confidence)))[0]


def of_stream(confidence: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    running, said = RunningCredibility(*confidence.shape[1:]), []
    for frame, now_s in zip(confidence, time_s, strict=True):
        running = running.plus(frame[None], float(now_s))
        said.append(running.credible(frame[None])[0])
    return np.array(said)


def test_a_joint_is_as_credible_as_its_most_confident_camera() -> None:
    np.testing.assert_allclose(usual_confidence(of_joints(0.8, 0.8, 0.8, 0.04)), 0.8)
    np.testing.assert_array_equal(at_once(of_joints(0.8, 0.8, 0.5, 0.04)), [1, 1, 1, 0])
    one_is_sure = np.array([[[0.7, 0.05], [0.05, 0.05]]])
    np.testing.assert_array_equal(at_once(one_is_sure), [1, 0])
    np.testing.assert_array_equal(at_once(of_joints(0.0)), [1])  # nothing is detected, nothing is said


def test_low_confidence_that_is_usual_tells_nothing() -> None:
    for low in (0.3, 0.05, 1e-6):
        np.testing.assert_array_equal(at_once(of_joints(low, 1.5 * low, low, low)), 1.0)
    assert np.isnan(usual_confidence(of_joints(0.0)))


def test_where_some_confidence_is_high_it_is_a_probability() -> None:
    """Most of the person is hidden: the joints that are guessed are not usual because they are many."""
    assert at_once(of_joints(0.95, *[0.05] * 9))[1:].max() < 0.1


def test_seconds_of_doubt_say_more_than_one_image() -> None:
    """A third of the usual confidence: among better images it is believed, for seconds on end it is not; and an image
    that is sure of the joint is believed in the midst of them."""
    time_s = np.arange(180) / FPS
    confidence = np.full((180, 2, 3), 0.9)
    confidence[::6, :, 1] = 0.3
    confidence[:, :, 2] = 0.3
    confidence[100, 1, 2] = 0.9
    for said in (credible(confidence, time_s), of_stream(confidence, time_s)):
        later = said[30:]
        assert later[:, :2].min() > 0.9
        assert later[70, 2] == 1.0
        assert np.delete(later[:, 2], 70).max() < 0.25  # of the stream, just after that image


def test_of_a_stream() -> None:
    """What is usual is the mean of the images."""
    stream = of_stream(np.concatenate([of_joints(0.0), of_joints(0.8), of_joints(0.8), of_joints(0.4)]), np.arange(4.0))
    np.testing.assert_array_equal(stream[:, 0], 1.0)
    assert of_stream(np.concatenate([of_joints(0.8)] * 3 + [of_joints(0.05)]), 9.0 * np.arange(4))[-1] == 0.0


def legs_guessed(
    rig: CameraRig, skeleton: Skeleton, confidence: float, n_frames: int = 45
) -> tuple[Observations, np.ndarray, list[int]]:
    """All views put the legs straight down; in truth the person sits. And the truth, and the joints of the legs."""
    guessed_m = walking(n_frames, FPS, skeleton)
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


@pytest.mark.parametrize("confidence", [0.05, 0.2])
def test_guesses_are_predicted_and_their_claims_contain_the_truth(
    rig: CameraRig, skeleton: Skeleton, confidence: float
) -> None:
    observations, truth_m, legs = legs_guessed(rig, skeleton, confidence)
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


def test_guesses_that_are_less_sure_than_the_joint_before(rig: CameraRig, skeleton: Skeleton) -> None:
    """Two seconds seen, then guessed for two with two thirds of the confidence, in all cameras: 22 % were within."""
    observations, truth_m, legs = legs_guessed(rig, skeleton, 0.5, 120)
    seen = simulate(truth_m, skeleton, rig, FPS, DetectionNoise(), NO_OCCLUSION, seed=1).observations
    is_guessed, rest = np.arange(120) >= 60, [joint for joint in range(skeleton.n_joints) if joint not in legs]
    observations = replace(
        observations,
        points2d_px=np.where(is_guessed[:, None, None, None], observations.points2d_px, seen.points2d_px),
        confidence=np.where(is_guessed[:, None, None], observations.confidence, seen.confidence),
        points3d_m=None,
        covariance3d_m2=None,
    )
    trajectory, estimator = fgpose.smooth(observations, rig), fgpose.Estimator(rig, skeleton)
    estimates = [estimator.update(frame) for frame in observations]
    covariance_m2 = np.stack([of for estimate in estimates if (of := estimate.covariance_m2) is not None])
    guesses = trajectory.frames(slice(90, 120))
    assert share_within(guesses, truth_m[90:], legs) > 0.95
    assert (guesses.status[:, legs] == Status.PREDICTED).all()
    assert guesses.covariance_m2 is not None
    assert trajectory.covariance_m2 is not None
    for of_m2 in (guesses.covariance_m2[:, rest], trajectory.covariance_m2[:60], covariance_m2[20:60]):
        assert np.sqrt(np.trace(of_m2, axis1=-2, axis2=-1) / 3).max() < 0.05  # the others and before: as ever
    assert np.median(np.sqrt(np.trace(covariance_m2[90:][:, legs], axis1=-2, axis2=-1) / 3)) > 0.1


def test_what_all_joints_state_less_is_no_guess() -> None:
    """Somebody walks away: all joints lose more than a quarter of their confidence; one always has less."""
    time_s = np.arange(300) / FPS
    confidence = np.linspace(0.9, 0.65, 300)[:, None, None] * np.array([1.0, 1.0, 0.85])[None, None]
    np.testing.assert_array_equal(credible(confidence.repeat(2, axis=1), time_s), 1.0)
    np.testing.assert_array_equal(of_stream(confidence.repeat(2, axis=1), time_s), 1.0)


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
