"""What confidences say of visible and hallucinated detections, learned from the recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose.config import Config
from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.evidence.gather import gather
from fgpose.estimation.noise import MEMORY_S
from fgpose.estimation.visibility.stated_confidence import StatedConfidence
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.comparison.recording import BenchmarkRecording
from fgpose_benchmarks.random_recordings.conditions import draw
from fgpose_benchmarks.random_recordings.recording import record
from fgpose_benchmarks.synthetic import walking

N_FRAMES = 2000
WRIST = 13


def evidence_of(confidence: np.ndarray, rig: CameraRig, skeleton: Skeleton) -> Evidence:
    """Of exact detections that state these confidences."""
    truth_m = walking(len(confidence), 30.0, skeleton)
    seen = fgpose.Observations(
        skeleton, np.arange(len(confidence)) / 30.0, rig.project(truth_m), confidence, camera_names=rig.names
    )
    return gather(seen, rig, Config())


def told(
    rig: CameraRig, skeleton: Skeleton, visible: float, hidden: float, wrist: tuple[float, float] | None = None
) -> tuple[StatedConfidence, Evidence, np.ndarray]:
    """Of detections of which a third is hallucinated; shares of visible and of hidden ones, and of those of one joint,
    that state 0.85 and not 0.25."""
    rng, shape = np.random.default_rng(0), (N_FRAMES, rig.n_cameras, skeleton.n_joints)
    visibility = (rng.random(shape) > 1 / 3).astype(float)
    share = np.where(visibility > 0, visible, hidden)
    if wrist is not None:
        share[..., WRIST] = np.where(visibility[..., WRIST] > 0, *wrist)
    evidence = evidence_of(np.where(rng.random(shape) < share, 0.85, 0.25), rig, skeleton)
    return StatedConfidence.of(evidence, visibility, np.ones(1)), evidence, visibility


def test_confidences_say_what_they_said_so_far(rig: CameraRig, skeleton: Skeleton) -> None:
    stated, evidence, _ = told(rig, skeleton, visible=0.8, hidden=0.1)
    log_odds = stated.log_odds(evidence)
    is_high = evidence.confidence > 0.5
    # Each joint has 2,700 hidden detections: a share of 0.1 is known to 6 %, and the prior of 50 measurements of all
    # joints is of the same shares.
    np.testing.assert_allclose(log_odds[is_high], np.log(0.8 / 0.1), atol=0.25)
    np.testing.assert_allclose(log_odds[~is_high], np.log(0.2 / 0.9), atol=0.25)


def test_confidences_that_are_alike_for_both_say_nothing(rig: CameraRig, skeleton: Skeleton) -> None:
    stated, evidence, visibility = told(rig, skeleton, visible=0.5, hidden=0.5)
    # 2,700 hidden detections of a joint: 0.02 in each share of one half, 0.04 in its logarithm; the largest of 34.
    np.testing.assert_allclose(stated.log_odds(evidence), 0.0, atol=0.15)
    always_sure = replace(evidence, confidence=np.ones_like(evidence.confidence))
    of_sure = StatedConfidence.of(always_sure, visibility, np.ones(1))
    np.testing.assert_allclose(of_sure.log_odds(always_sure), 0.0, atol=1e-12)  # rounding


def test_a_joint_whose_confidence_is_turned_round_is_read_so(rig: CameraRig, skeleton: Skeleton) -> None:
    stated, evidence, _ = told(rig, skeleton, visible=0.8, hidden=0.1, wrist=(0.1, 0.8))
    of_wrist, is_high = stated.log_odds(evidence)[..., WRIST], evidence.confidence[..., WRIST] > 0.5
    np.testing.assert_allclose(of_wrist[is_high], np.log(0.1 / 0.8), atol=0.3)  # as above, and the prior of the others
    np.testing.assert_allclose(of_wrist[~is_high], np.log(0.9 / 0.2), atol=0.3)


def test_few_detections_say_little_and_single_views_nothing(rig: CameraRig, skeleton: Skeleton) -> None:
    confidence = np.full((1, rig.n_cameras, skeleton.n_joints), 0.85)
    confidence[:, 0] = 0.25
    evidence, visibility = evidence_of(confidence, rig, skeleton), (confidence > 0.5).astype(float)
    unknown = StatedConfidence.unknown(skeleton.n_joints)
    np.testing.assert_array_equal(unknown.log_odds(evidence), 0.0)
    # All 17 hidden detections are unsure and none of 51 visible ones; 30 measurements of either are as usual, a quarter
    # unsure: (17 + 7.5) / 47 over 7.5 / 81. One more of each joint, beside 50, changes that by 4 %.
    log_odds = StatedConfidence.of(evidence, visibility, np.ones(1)).log_odds(evidence)
    np.testing.assert_allclose(log_odds[:, 0], np.log(7.5 / 81 * 47 / 24.5), rtol=0.05)
    # A hundredth of a measurement each: (0.17 + 7.5) / 30.2 over 7.5 / 30.5 is 0.033, and each joint adds a little.
    little = StatedConfidence.of(evidence, visibility, np.full(1, 0.01))
    assert np.abs(little.log_odds(evidence)).max() < 0.05
    first = np.arange(rig.n_cameras)[:, None] == 0
    alone = replace(evidence, undistorted_px=np.where(first[..., None], evidence.undistorted_px, np.nan))
    np.testing.assert_array_equal(StatedConfidence.of(alone, visibility, np.ones(1)).counts, 0.0)
    of_several = StatedConfidence.of(evidence, visibility, np.ones(1))
    np.testing.assert_array_equal(of_several.log_odds(alone)[~alone.detected], 0.0)


def test_a_stream_forgets(rig: CameraRig, skeleton: Skeleton) -> None:
    stated, _, _ = told(rig, skeleton, visible=0.8, hidden=0.1)
    later = stated.then(StatedConfidence.unknown(skeleton.n_joints), MEMORY_S)
    np.testing.assert_allclose(later.counts, np.exp(-1) * stated.counts, rtol=1e-12)  # rounding
    both = stated.then(stated, 0.0)
    np.testing.assert_allclose(both.counts, 2 * stated.counts, rtol=1e-12)


@pytest.fixture(scope="module")
def drawn_in() -> BenchmarkRecording:
    """Eight cameras, in which half of the limbs are hidden at any time: these are all detected drawn in towards the
    body, so that hallucinations agree, with confidences of 0.2."""
    whole, some = record(draw(70026)), slice(110, 170)
    return replace(whole, observations=whole.observations.frames(some), truth_m=whole.truth_m[some])


@pytest.mark.parametrize("solver", ["batch", "window", pytest.param("isam2", marks=pytest.mark.slow)])
def test_two_views_that_see_a_limb_outvote_six_that_invent_it(drawn_in: BenchmarkRecording, solver: str) -> None:
    observations = drawn_in.observations
    ankles = [observations.skeleton.joints.index(f"{side}_ankle") for side in ("left", "right")]

    def errors_m(observations: fgpose.Observations) -> np.ndarray:
        if solver == "batch":
            found_m = fgpose.smooth(observations, drawn_in.rig, Config(solver={"covariance": False})).positions_m
        else:
            config = Config(online={"solver": solver, "covariance": False})
            estimator = fgpose.Estimator(drawn_in.rig, observations.skeleton, config)
            found_m = np.stack([estimator.update(frame).positions_m for frame in observations])
        return np.linalg.norm(found_m - drawn_in.truth_m, axis=-1)[:, ankles]

    silent = replace(observations, confidence=np.where(observations.seen, 1.0, 0.0))
    knows_m, nothing_m = errors_m(observations), errors_m(silent)
    # Measured: 0.5 of the errors are larger than 0.2 m, and 0 to 0.07; the mean is 0.27 m, and 0.02 to 0.05 m.
    assert np.mean(knows_m > 0.2) < 0.3 * np.mean(nothing_m > 0.2)
    assert np.mean(knows_m) < 0.3 * np.mean(nothing_m)
