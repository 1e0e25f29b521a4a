"""Less weight for detections that have not fitted for a while: hallucinated joints, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fgpose.estimation.persistence import RunningPersistence, persistence_weights

import fgpose
from fgpose.config import ProjectionConfig, config_from_dict
from fgpose.synthetic import DetectionNoise, Occlusion, Scene, motion_from_npz, simulate
from tests.conftest import MOCAP

STEP_S = 0.02
CONFIG = ProjectionConfig(persistent_px=12.0, memory_s=0.12)  # six frames before and after


def errors_px(n_frames: int = 40, n_cameras: int = 3, n_joints: int = 5) -> np.ndarray:
    """Reprojection errors of detections that all fit well."""
    return np.full((n_frames, n_cameras, n_joints), 2.0)


def weights_of(error_px: np.ndarray, step_s: float = STEP_S) -> np.ndarray:
    return persistence_weights(error_px, step_s * np.arange(len(error_px)), CONFIG)


def test_half_at_the_threshold_and_little_far_beyond_it() -> None:
    error_px = errors_px()
    error_px[:, 0, 1], error_px[:, 0, 2] = 12.0, 24.0
    weights = weights_of(error_px)
    np.testing.assert_allclose(weights[:, 0, 1], 0.5)
    np.testing.assert_allclose(weights[:, 0, 2], 1 / 17)  # twice the threshold, to the fourth power
    weights[:, 0, 1:3] = 1.0
    np.testing.assert_allclose(weights, 1 / (1 + (2 / 12) ** 4) * np.ones_like(weights), atol=1e-3)


@pytest.mark.parametrize("n_bad", [1, 6])
def test_what_passes_does_not_count(n_bad: int) -> None:
    """Fewer than half of the 13 frames around any frame: the median does not notice."""
    error_px, usual = errors_px(), weights_of(errors_px())
    error_px[15 : 15 + n_bad, 1, 3] = 300.0
    np.testing.assert_array_equal(weights_of(error_px), usual)


def test_what_lasts_counts_in_its_camera_and_joint_alone() -> None:
    error_px, usual = errors_px(), weights_of(errors_px())
    error_px[15:22, 1, 3] = 300.0
    weights = weights_of(error_px)
    assert weights[15:22, 1, 3].max() < 1e-5, "seven of thirteen, all of which each of the seven has around it"
    weights[15:22, 1, 3] = usual[15:22, 1, 3]
    np.testing.assert_array_equal(weights, usual)


def test_the_memory_is_a_time_not_a_number_of_frames() -> None:
    error_px = errors_px()
    error_px[20:, 0, 0] = 100.0
    for step_s in (0.02, 0.04):
        bad = weights_of(error_px, step_s)[:, 0, 0] < 0.5
        # the median changes where the errors do, whatever the window; before and after it nothing wavers
        np.testing.assert_array_equal(bad, np.arange(40) >= 20)
    single = errors_px()
    single[20:23, 0, 0] = 100.0
    assert not (weights_of(single, 0.04) < 0.5).any(), "three of seven"
    found = np.argwhere(weights_of(single, 0.06) < 0.5)
    np.testing.assert_array_equal(found, [[20, 0, 0], [21, 0, 0], [22, 0, 0]], "three of five")


def test_frames_within_microseconds_are_not_more_of_a_memory() -> None:
    """The window is a time: a burst of frames in it neither lengthens it elsewhere nor takes memory by their rate."""
    time_s = np.cumsum(np.r_[np.full(20, STEP_S), np.full(30, 1e-6), np.full(20, STEP_S)])
    error_px = errors_px(n_frames=len(time_s))
    error_px[20:50, 0, 0] = 100.0  # the burst
    error_px[60:63, 1, 1] = 100.0
    weights = persistence_weights(error_px, time_s, CONFIG)
    assert weights[14:55, 0, 0].max() < 0.01, "most frames within 0.12 s"
    assert weights[[12, 58], 0, 0].min() > 0.99, "0.16 s before and 0.18 s after the burst"
    assert weights[:, 1, 1].min() > 0.99, "three of thirteen"
    error_px[:40, 0, 0] = 100.0
    assert weights_of(error_px, 1e-9)[:, 0, 0].max() < 0.01, "all 70 frames are one moment, and 40 of them do not fit"


def test_a_camera_that_is_worse_than_the_others_loses_weight() -> None:
    """It has moved: its errors are 40 px everywhere, those of the others 2 px."""
    error_px = errors_px(n_joints=17)
    error_px[:, 2] = 40.0
    weights = weights_of(error_px)
    np.testing.assert_allclose(weights[:, 2], 1 / (1 + (40 / 12) ** 4))
    assert weights[:, :2].min() > 0.99


def test_errors_that_are_usual_in_the_recording_cost_no_weight() -> None:
    """Clocks that are off, or a detector that is less exact: joints that are worse still are nevertheless found."""
    rng = np.random.default_rng(0)
    error_px = np.abs(30.0 + rng.normal(0, 5, errors_px(n_joints=17).shape))
    error_px[:, 2, 4] = 120.0
    weights = weights_of(error_px)
    assert weights[:, 2, 4].max() < 0.07  # 1 / (1 + (120 / 60)^4) = 0.06
    # The median of 13 is known to 5 x 1.25 / sqrt(13) = 1.7 px; 36 px, at 3.5 sigma, weigh 1 / (1 + 0.6^4) = 0.89.
    assert np.delete(weights, 4, axis=2).min() > 0.85


def test_without_detections() -> None:
    """Nothing is known of a camera that saw nothing; a gap is judged by what is around it."""
    error_px = errors_px()
    error_px[:, 0] = np.nan
    error_px[:, 1, 2] = 50.0
    error_px[10:14, 1, 2] = np.nan
    weights = weights_of(error_px)
    assert (weights[:, 0] == 1.0).all()
    np.testing.assert_allclose(weights[:, 1, 2], weights[0, 1, 2])
    assert weights[0, 1, 2] < 0.01
    error_px[:, 1, 2] = np.nan
    error_px[[20, 21], 1, 2] = 50.0, 1.0
    # Of an even number of detections the lower one of the middle two, in favour of the detection.
    assert weights_of(error_px)[20, 1, 2] > 0.99


def test_one_frame_is_judged_by_itself() -> None:
    error_px = errors_px(n_frames=1)
    error_px[0, 0, 0] = 12.0
    assert weights_of(error_px)[0, 0, 0] == pytest.approx(0.5)


@pytest.mark.slow
def test_it_helps_under_occlusion(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    truth_m, fps = motion_from_npz(MOCAP / "cmu_03_03_b.npz")
    scene = simulate(truth_m[:100], skeleton, rig, fps, DetectionNoise(), Occlusion(), seed=1)
    with_it, without = (errors_mm(scene, persistent_px) for persistent_px in (12.0, 1e6))
    # Over six such scenes (three clips) the mean is 6 to 22 % lower and the worst 1 % of the joints 29 to 46 %.
    assert with_it.mean() < 0.9 * without.mean()
    assert np.percentile(with_it, 99) < 0.75 * np.percentile(without, 99)


def errors_mm(scene: Scene, persistent_px: float) -> np.ndarray:
    config = config_from_dict({"projection": {"persistent_px": persistent_px}})
    trajectory = fgpose.smooth(scene.observations, scene.rig, config)
    return 1000 * np.linalg.norm(trajectory.positions_m - scene.truth_m, axis=-1)


def test_where_everything_fits_hardly_anything_changes(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    truth_m, fps = motion_from_npz(MOCAP / "cmu_02_01_short.npz")
    noise = DetectionNoise(sigma_px=1.5, correlated_px=1.5, outlier_share=0.002)
    scene = simulate(truth_m[:40], skeleton, rig, fps, noise, Occlusion(n_views=0), seed=0)
    # errors of 2 px lose 1 / (1 + (2 / 12)^4) = 0.08 % of their weight, those of 6 px 6 %
    np.testing.assert_allclose(errors_mm(scene, 12.0), errors_mm(scene, 1e6), atol=0.2)


@pytest.mark.slow
def test_a_hallucination_of_one_joint_is_distrusted_however_rare(
    rig: fgpose.CameraRig, skeleton: fgpose.Skeleton
) -> None:
    """A wrist hallucinated in two of four views for 1 s, 0.8 % of the detections of 6 s."""
    truth_m, fps = motion_from_npz(MOCAP / "cmu_02_05.npz")
    scene = simulate(truth_m[:300], skeleton, rig, fps, DetectionNoise(), Occlusion(n_views=0), seed=0)
    wrist, second = skeleton.index("right_wrist"), slice(125, 175)
    worst_mm = {12.0: 0.0, 1e6: 0.0}
    for seed in (2, 3):
        points_px = scene.observations.points2d_px.copy()
        points_px[second, :2, wrist] += wandering_px(np.random.default_rng(seed), 50, 1 / fps)
        hallucinated = replace(scene, observations=replace(scene.observations, points2d_px=points_px))
        for persistent_px in worst_mm:
            worst = errors_mm(hallucinated, persistent_px)[second, wrist].max()
            worst_mm[persistent_px] = max(worst_mm[persistent_px], worst)
    # 44 mm when the detections are distrusted, 62 mm when they are not
    assert worst_mm[12.0] < 0.8 * worst_mm[1e6]


def wandering_px(rng: np.random.Generator, n_frames: int, step_s: float) -> np.ndarray:
    """Errors (frame, view, 2) of 45 px per axis that are correlated over 0.5 s, as hallucinations are."""
    keep = np.exp(-step_s / 0.5)
    error_px = [45.0 * rng.normal(size=(2, 2))]
    for _ in range(n_frames - 1):
        error_px.append(keep * error_px[-1] + np.sqrt(1 - keep**2) * 45.0 * rng.normal(size=(2, 2)))
    return np.array(error_px)


def test_running_persistence_forgets_what_is_older_than_the_memory() -> None:
    running = RunningPersistence((2, 1), CONFIG)
    np.testing.assert_array_equal(running.weights(), 1.0)
    for _ in range(60):  # ten times the memory
        running.add(STEP_S, np.array([[24.0], [2.0]]))
    np.testing.assert_allclose(running.weights()[:, 0], [1 / 17, 1.0], atol=1e-3)
    running.add(STEP_S, np.full((2, 1), np.nan))
    np.testing.assert_allclose(running.weights()[:, 0], [1 / 17, 1.0], atol=1e-3)  # unseen: nothing new
    for _ in range(60):
        running.add(STEP_S, np.array([[2.0], [2.0]]))
    np.testing.assert_allclose(running.weights(), 1.0, atol=1e-3)


def test_trust_is_relative_to_the_second_camera() -> None:
    """By joints: one camera of three does not fit; only one does; none does; only two see the joint; only one does."""
    bad, good = 72.0, 2.0
    error_px = np.array([[bad, good, bad, bad, bad], [good, bad, bad, 48.0, good], [good, 48.0, bad, good, good]])
    seen = np.ones(error_px.shape, dtype=bool)
    seen[2, 3] = seen[1:, 4] = False
    running = RunningPersistence(error_px.shape, CONFIG)
    running.add(STEP_S, error_px)
    trust = running.trust(seen)
    # 1 / (1 + (error / threshold)^4); the threshold is 24 px, or twice the second best error: 96 and 144 px
    np.testing.assert_allclose(trust[0], [1 / 82, 1.0, 16 / 17, 16 / 17, 1.0], rtol=1e-3)
    np.testing.assert_allclose(trust[1, :4], [1.0, 1 / (1 + 0.75**4), 16 / 17, 81 / 82], rtol=1e-3)
    np.testing.assert_allclose(trust[2, :3], [1.0, 16 / 17, 16 / 17], rtol=1e-3)
    np.testing.assert_array_equal(RunningPersistence((1, 5), CONFIG).trust(seen[:1]), 1.0)


@pytest.mark.slow
def test_online_a_hallucination_loses_its_weight(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    """Two views of four take the left wrist for the right one for a second."""
    truth_m, fps = motion_from_npz(MOCAP / "cmu_03_03_b.npz")
    scene = simulate(truth_m[:100], skeleton, rig, fps, DetectionNoise(), Occlusion(n_views=0), seed=0)
    points_px, wrist, hallucinated = scene.observations.points2d_px.copy(), skeleton.index("right_wrist"), slice(40, 90)
    points_px[hallucinated, :2, wrist] = points_px[hallucinated, :2, skeleton.index("left_wrist")]
    observations = replace(scene.observations, points2d_px=points_px, points3d_m=None, covariance3d_m2=None)

    def error_mm(persistent_px: float) -> float:
        config = config_from_dict({"projection": {"persistent_px": persistent_px}, "online": {"covariance": False}})
        estimator = fgpose.Estimator(rig, skeleton, config)
        positions_m = np.stack([estimator.update(frame).positions_m for frame in observations])
        return float(1e3 * np.linalg.norm(positions_m - scene.truth_m, axis=-1)[hallucinated, wrist].mean())

    # 27 and 47 mm
    assert error_mm(12.0) < 0.75 * error_mm(1e6)
