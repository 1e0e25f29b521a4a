"""A limb that is faster than the motion model expects, seen by all cameras: it is followed, and not called hidden."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import fgpose
from fgpose.config import Config
from fgpose.estimation.evidence.gather import gather
from fgpose.estimation.visibility.agreement import Agreement, is_doubtful
from fgpose.estimation.visibility.detection_residuals import DetectionResiduals
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status
from fgpose_benchmarks.accuracy.variants import find_variant, record
from fgpose_benchmarks.comparison.recording import BenchmarkRecording
from fgpose_benchmarks.synthetic import NO_NOISE, NO_OCCLUSION, simulate, walking

CONFIG = Config()
SPREAD_M, USUAL = np.full(4, 0.018), 2 / 3
WRIST = 13  # left_wrist
PUNCHES = "cmu_02_05"


def said(
    skeleton: Skeleton, rig: CameraRig, path_by_m: np.ndarray, wrong_px: dict[int, np.ndarray] | None = None
) -> tuple[Agreement, np.ndarray]:
    """Of exact detections of a person whose wrist the path has so far off; some detections are wrong by so much. And
    where the wrist is."""
    truth_m = walking(1, 30.0, skeleton)
    observations = simulate(truth_m, skeleton, rig, 30.0, NO_NOISE, NO_OCCLUSION, seed=0).observations
    points_px = observations.points2d_px.copy()
    for camera, by_px in (wrong_px or {}).items():
        points_px[0, camera, WRIST] += by_px
    seen = fgpose.Observations(skeleton, observations.time_s, points_px, camera_names=rig.names)
    path_m = truth_m.copy()
    path_m[0, WRIST] += path_by_m
    residuals = DetectionResiduals.of(path_m, gather(seen, rig, CONFIG), rig, CONFIG)
    spread_m = SPREAD_M[: rig.n_cameras]
    usual = np.full(residuals.seen.shape, USUAL)
    given = residuals, spread_m[None, :, None], spread_m, usual, 0.0, rig, skeleton, CONFIG.visibility
    return Agreement.of(*given), truth_m[0, WRIST]


def test_views_that_agree_off_the_path_are_visible_there(rig: CameraRig, skeleton: Skeleton) -> None:
    """The elbow holds the wrist at the length of the forearm: it is as far from the elbow on its path."""
    forearm_m = np.diff(walking(1, 30.0, skeleton)[0, [WRIST - 1, WRIST]], axis=0)[0]
    across_m = np.cross(forearm_m, [0.0, 0.0, 1.0])
    swung_m = np.linalg.norm(forearm_m) * across_m / np.linalg.norm(across_m) - forearm_m
    for cameras in (rig.names, rig.names[:3]):
        found, wrist_m = said(skeleton, rig.subset(cameras), swung_m)
        assert found.log_odds[0, :, WRIST].min() > 3.0  # 20 to 1 for each
        # Exact detections, and the rounding of the triangulation.
        np.testing.assert_allclose(found.off_path_m[0, WRIST], wrist_m, atol=1e-6)
        assert np.isnan(np.delete(found.off_path_m, WRIST, axis=1)).all()


def test_hallucinations_that_do_not_meet_are_hidden(rig: CameraRig, skeleton: Skeleton) -> None:
    """60 px are 0.24 m, to different sides in three of four cameras."""
    wrong_px = {0: np.array([60.0, 0.0]), 1: np.array([0.0, -60.0]), 2: np.array([-50.0, 40.0])}
    found, _ = said(skeleton, rig, np.zeros(3), wrong_px)
    assert found.log_odds[0, :3, WRIST].max() < -1.0
    assert found.log_odds[0, 3, WRIST] > 1.0
    assert np.isnan(found.off_path_m).all()


def test_only_where_two_detections_are_off_is_there_a_doubt(rig: CameraRig, skeleton: Skeleton) -> None:
    away_m = np.zeros((rig.n_cameras, skeleton.n_joints))
    away_m[:, 0] = np.nan
    for camera in range(2):
        assert not is_doubtful(away_m, SPREAD_M)
        away_m[camera, WRIST] = 3 * SPREAD_M[camera]
    assert is_doubtful(away_m, SPREAD_M)


def fast(n_cameras: int) -> BenchmarkRecording:
    recording = record(find_variant("fast_4x_30hz"), PUNCHES, 40)
    names = recording.rig.names[:n_cameras]
    arrays: dict[str, Any] = {"observations": recording.observations.subset(names), "rig": recording.rig.subset(names)}
    return BenchmarkRecording(**{**vars(recording), **arrays})


def errors_m(positions_m: np.ndarray, recording: BenchmarkRecording) -> np.ndarray:
    return np.linalg.norm(positions_m - recording.truth_m, axis=-1)


@pytest.mark.parametrize(("n_cameras", "most_m"), [(4, 0.1), (3, 0.2)])
def test_punches_at_ten_metres_a_second_are_followed(n_cameras: int, most_m: float) -> None:
    """At 30 Hz a wrist moves by 0.3 m from frame to frame. With four cameras the errors were up to 0.43 m."""
    recording = fast(n_cameras)
    trajectory = fgpose.smooth(recording.observations, recording.rig)
    alone = fgpose.refine(recording.observations, recording.rig)
    error_m = errors_m(trajectory.positions_m, recording)
    # Detections are off by 5 px, 20 mm: 5 sigma of one of them. An outlier of three views leaves two.
    assert error_m.max() < most_m
    assert error_m.mean() < errors_m(alone.positions_m, recording).mean()
    assert (trajectory.status == Status.OBSERVED).all()
    assert trajectory.visibility is not None
    # One detection in a hundred is an outlier (DetectionNoise).
    assert np.mean(trajectory.visibility < 0.5) < 0.02


def test_punches_are_followed_online() -> None:
    """The newest pose, with nothing that comes after it. The mean error was 25 mm, and the pose one lag later worse."""
    recording = fast(4)
    estimator = fgpose.Estimator(recording.rig, recording.observations.skeleton)
    estimates = [estimator.update(frame) for frame in recording.observations]
    error_m = errors_m(np.stack([estimate.positions_m for estimate in estimates]), recording)
    alone = fgpose.refine(recording.observations, recording.rig)
    assert error_m.max() < 0.12  # 6 sigma of a detection
    assert error_m.mean() < errors_m(alone.positions_m, recording).mean()
    assert all((estimate.status == Status.OBSERVED).all() for estimate in estimates)
