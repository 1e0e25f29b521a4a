from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from fgpose.assessment.metrics import mpjpe_m
from fgpose.config import Config, OnlineConfig
from fgpose.estimation.estimator import Estimator
from fgpose_benchmarks.accuracy.methods import LINEAR, ORACLE, OURS, PER_FRAME, find_methods, methods
from fgpose_benchmarks.accuracy.variants import find_variant, record
from fgpose_benchmarks.comparison.recording import BenchmarkRecording, Method, MethodResult
from fgpose_benchmarks.synthetic import NO_NOISE

CLIP = "cmu_02_05"
ALL = methods()
NEARLY_PERFECT = replace(NO_NOISE, sigma_px=0.1)
"""0.1 px are 0.4 mm at 4.5 m."""


def solved(name: str, recording: BenchmarkRecording) -> MethodResult:
    (method,) = find_methods([name], ALL)
    return method.solve(recording)


def error_mm(result: MethodResult, recording: BenchmarkRecording) -> float:
    return 1000 * mpjpe_m(result.positions_m, recording.truth_m)


@pytest.fixture(scope="module")
def perfect() -> BenchmarkRecording:
    return record(replace(find_variant("clean"), noise=NEARLY_PERFECT), CLIP, 8)


@pytest.fixture(scope="module")
def lost() -> BenchmarkRecording:
    """A third of the time one of two occluded cameras is away."""
    return record(replace(find_variant("occluded_2_cameras"), lost=True), CLIP, 15)


@pytest.mark.parametrize("method", ALL, ids=lambda method: method.name)
def test_perfect_detections_give_the_truth(method: Method, perfect: BenchmarkRecording):
    result = method.solve(perfect)
    # Each frame alone: the noise, and the weak priors of the optimisers. Over time, motion that is not at constant
    # velocity or below 6 Hz is lost: a few mm in punches.
    limit_mm = 1.0 if method.group == "per-frame" else 12.0
    assert error_mm(result, perfect) < limit_mm
    assert np.isfinite(result.positions_m).all()
    assert 0 < result.time_s < 60


@pytest.mark.slow
@pytest.mark.parametrize("method", ALL, ids=lambda method: method.name)
def test_each_takes_what_is_left(method: Method, lost: BenchmarkRecording):
    result = method.solve(lost)
    assert result.positions_m.shape == lost.truth_m.shape
    known = np.isfinite(result.positions_m).all(axis=-1)
    assert known.mean() > 0.5
    # Two cameras, both occluded now and then: still nobody is far from home.
    assert error_mm(result, lost) < 500.0
    if result.covariance_m2 is not None:
        np.testing.assert_array_equal(np.isfinite(result.covariance_m2).all(axis=(-2, -1)), known)


@pytest.mark.slow
def test_those_that_state_a_covariance():
    recording = record(find_variant("clean"), CLIP, 4)
    stating = {method.name for method in (*OURS, ORACLE) if method.solve(recording).covariance_m2 is not None}
    batches = {f"fgpose batch{how}" for how in ("", ", time offsets", ", self-calibrated")}
    assert stating == {"fgpose online, lag 0", *batches, "oracle"}


def test_one_view_and_the_mean_of_views(lost: BenchmarkRecording):
    views_m = lost.observations.points3d_m
    assert views_m is not None
    np.testing.assert_array_equal(solved("one view", lost).positions_m, views_m[:, 0])
    mean_m = solved("mean of views", lost).positions_m
    both = np.isfinite(views_m).all(axis=(1, 3))
    np.testing.assert_allclose(mean_m[both], views_m.mean(axis=1)[both])
    only_second = np.isnan(views_m[:, 0]).any(axis=-1) & np.isfinite(views_m[:, 1]).all(axis=-1)
    assert only_second.any() or np.isnan(views_m[:, 1]).any()
    np.testing.assert_allclose(mean_m[only_second], views_m[:, 1][only_second])


def test_without_3d_of_the_views_their_mean_is_missing():
    recording = record(find_variant("clean"), CLIP, 3)
    flat = replace(recording, observations=replace(recording.observations, points3d_m=None))
    assert np.isnan(solved("one view", flat).positions_m).all()
    assert np.isnan(solved("mean of views", flat).positions_m).all()
    assert np.isfinite(solved("fusion (eq. 1)", flat).positions_m).all()  # triangulated instead


def test_confidence_weighs_the_equations():
    recording = record(replace(find_variant("clean"), noise=NO_NOISE), CLIP, 3)
    points_px, confidence = recording.observations.points2d_px.copy(), recording.observations.confidence.copy()
    points_px[:, 1] += 50.0
    confidence[:, 1] = 0.01
    misled = replace(
        recording, observations=replace(recording.observations, points2d_px=points_px, confidence=confidence)
    )
    assert error_mm(solved("DLT", misled), misled) > 20.0
    # A weight of 1e-4 leaves a ten-thousandth of the error.
    assert error_mm(solved("DLT by confidence", misled), misled) < 0.1


def test_the_filter_smooths_what_it_follows():
    recording = record(find_variant("clean"), CLIP, 60)
    for raw, filtered in (("DLT by confidence", "DLT by confidence, 6 Hz"), ("RANSAC", "RANSAC, 6 Hz")):
        rough_m, smooth_m = (solved(name, recording).positions_m for name in (raw, filtered))
        # Second differences amplify noise above 6 Hz, of which the filter leaves next to nothing.
        assert np.abs(np.diff(smooth_m, 2, axis=0)).mean() < 0.2 * np.abs(np.diff(rough_m, 2, axis=0)).mean()


@pytest.mark.slow
def test_online_results_are_those_of_their_own_frame():
    recording = record(find_variant("occluded"), CLIP, 20)
    newest, lagged = (solved(f"fgpose online, lag {lag}", recording) for lag in ("0", "0.2 s"))
    estimator = Estimator(recording.rig, recording.observations.skeleton, Config(online=OnlineConfig(lag_s=0.2)))
    estimates = [estimator.update(frame) for frame in recording.observations]
    # What is known later of the last ten frames is known from nothing that is seen after them.
    unseen = replace(
        recording.observations,
        time_s=recording.observations.frame_time_s + 20 / recording.fps,
        points2d_px=np.full_like(recording.observations.points2d_px, np.nan),
        confidence=np.zeros_like(recording.observations.confidence),
        points3d_m=None,
        covariance3d_m2=None,
    )
    later = [estimator.update(frame) for frame in unseen.frames(slice(0, 10))]
    assert newest.covariance_m2 is not None
    for number, estimate in enumerate(estimates):
        assert estimate.covariance_m2 is not None
        np.testing.assert_allclose(newest.positions_m[number], estimate.positions_m, atol=1e-12)
        np.testing.assert_allclose(newest.covariance_m2[number], estimate.covariance_m2, atol=1e-12)
    # 0.2 s are ten frames at 50 Hz: each of the twenty is ten frames old when it is taken.
    for number, estimate in enumerate([*estimates[10:], *later]):
        then = estimate.smoothed
        assert then is not None
        assert then.frame == number
        np.testing.assert_allclose(lagged.positions_m[number], then.positions_m, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("clip", [CLIP, "cmu_02_10"])
def test_self_calibration_helps_where_a_camera_was_bumped(clip: str):
    recording = record(find_variant("bumped"), clip, 100)  # for less, the bias of its detections tells as much
    calibrated, plain = (solved(f"fgpose batch{suffix}", recording) for suffix in (", self-calibrated", ""))
    # To the pelvis: where the cameras are as a whole cannot be told from the images.
    relative_mm = [1000 * mpjpe_m(each.positions_m, recording.truth_m, (0,)) for each in (calibrated, plain)]
    assert relative_mm[0] < relative_mm[1]


@pytest.mark.slow
def test_the_oracle_is_not_misled_by_what_misleads_the_others():
    recording = record(replace(find_variant("industrial"), noise=NEARLY_PERFECT), "cmu_02_07_a", 120)
    oracle_mm, batch_mm = (error_mm(solved(name, recording), recording) for name in ("oracle", "fgpose batch"))
    assert oracle_mm < 0.8 * batch_mm


def test_where_nobody_knows_there_is_no_oracle():
    recording = replace(record(find_variant("clean"), CLIP, 3), oracle_observations=None)
    with pytest.raises(ValueError, match=r"nobody knows what is occluded in cmu_02_05 \(clean\)"):
        ORACLE.solve(recording)


def test_methods_can_be_sent_to_another_process():
    for method in ALL:
        assert pickle.loads(pickle.dumps(method)).name == method.name


def test_names_differ_and_groups_hold():
    assert len({method.name for method in ALL}) == len(ALL)
    assert {method.group for method in PER_FRAME} == {"per-frame"}
    assert {method.group for method in LINEAR} == {"linear"}
    assert {method.group for method in OURS} == {"ours"}


def test_an_unknown_method_is_refused():
    with pytest.raises(ValueError, match="no method magic; there is one view; mean of views"):
        find_methods(["DLT", "magic"], ALL)
