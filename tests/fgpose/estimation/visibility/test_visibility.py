"""Whether a detection is of its joint, and what that does to the estimate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import Float

import fgpose
from fgpose.config import Config, config_from_dict
from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.evidence.gather import gather
from fgpose.estimation.visibility.running_visibility import RunningVisibility
from fgpose.estimation.visibility.visibility import judged
from fgpose.estimation.visibility.visibility_chain import Chain
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status, Trajectory
from fgpose_benchmarks.synthetic import (
    NO_NOISE,
    NO_OCCLUSION,
    DetectionNoise,
    Occlusion,
    Scene,
    motion_from_npz,
    simulate,
    walking,
)
from tests.conftest import MOCAP

FPS = 50.0
STEP_S = 1 / FPS
CONFIG = Config()
NEW = np.ones(4, dtype=bool)

STILL = np.zeros((17, 3))


def exact(
    rig: CameraRig, skeleton: Skeleton, time_s: Float[np.ndarray, " frame"] | None = None
) -> tuple[np.ndarray, Evidence]:
    """A person who stands still, and detections without errors whose weight tells nothing."""
    time_s = STEP_S * np.arange(40) if time_s is None else time_s
    truth_m = np.repeat(walking(1, FPS, skeleton), len(time_s), axis=0)
    evidence = gather(simulate(truth_m, skeleton, rig, FPS, NO_NOISE, NO_OCCLUSION, seed=0).observations, rig, CONFIG)
    return truth_m, replace(evidence, time_s=time_s, weights=np.full(evidence.weights.shape, 0.5))


def wrong(evidence: Evidence, frames: slice, camera: int, joint: int, by_px: float = 100.0) -> Evidence:
    """The evidence with the detections of a joint in a camera off by so much."""
    points_px = evidence.undistorted_px.copy()
    points_px[frames, camera, joint, 0] += by_px
    return replace(evidence, undistorted_px=points_px)


def with_noise(evidence: Evidence, sigma_px: float | np.ndarray) -> Evidence:
    error_px = sigma_px * np.random.default_rng(0).normal(size=evidence.undistorted_px.shape)
    return replace(evidence, undistorted_px=evidence.undistorted_px + error_px)


def without(evidence: Evidence, frames: slice, camera: int, joint: int | slice) -> Evidence:
    points_px = evidence.undistorted_px.copy()
    points_px[frames, camera, joint] = np.nan
    return replace(evidence, undistorted_px=points_px)


def judged_by(positions_m: np.ndarray, evidence: Evidence, rig: CameraRig, skeleton: Skeleton) -> Evidence:
    return judged(evidence, positions_m, rig, skeleton, CONFIG)


def test_what_is_wrong_for_a_while_is_hidden_in_its_camera_and_joint_alone(rig: CameraRig, skeleton: Skeleton) -> None:
    positions_m, evidence = exact(rig, skeleton)
    probability = judged_by(positions_m, wrong(evidence, slice(15, 22), 1, 3), rig, skeleton).visibility
    assert probability[15:22, 1, 3].max() < 0.01
    probability[15:22, 1, 3] = 1.0
    assert probability.min() > 0.9


def test_a_doubtful_detection_is_judged_by_those_around_it(rig: CameraRig, skeleton: Skeleton) -> None:
    """17 px off where the error is 4 px: among good detections visible, by itself and among wrong ones hidden."""
    positions_m, clear = exact(rig, skeleton)
    noisy = with_noise(clear, 4.0)
    points_px = noisy.undistorted_px.copy()
    points_px[20, 1, 3] = clear.undistorted_px[20, 1, 3] + np.array([17.0, 0.0])
    doubtful = replace(noisy, undistorted_px=points_px)
    alone = without(without(doubtful, slice(0, 20), 1, 3), slice(21, 40), 1, 3)
    among_wrong = wrong(wrong(doubtful, slice(10, 20), 1, 3), slice(21, 31), 1, 3)
    of_good, of_alone, of_wrong = (
        judged_by(positions_m, evidence, rig, skeleton).visibility[20, 1, 3]
        for evidence in (doubtful, alone, among_wrong)
    )
    # 0.92, 0.15 and 0.0003
    assert of_good > 0.8
    assert 0.05 < of_alone < 0.4
    assert of_wrong < 0.01


def test_errors_that_are_usual_in_the_recording_cost_little(rig: CameraRig, skeleton: Skeleton) -> None:
    """Of 12 px instead of the usual 5 px: a detector that is less exact. Worse ones are nevertheless found."""
    positions_m, evidence = exact(rig, skeleton)
    evidence = wrong(with_noise(evidence, 12.0), slice(None), 2, 4, 150.0)
    probability = judged_by(positions_m, evidence, rig, skeleton).visibility
    assert probability[:, 2, 4].max() < 0.01
    # 0.96: of errors in the tail, above 2.5 sigma, hallucinations are as likely.
    assert np.delete(probability, 4, axis=2).mean() > 0.93


def test_without_detections(rig: CameraRig, skeleton: Skeleton) -> None:
    """Nothing is known of a camera that saw nothing; a gap is judged by what is around it."""
    positions_m, evidence = exact(rig, skeleton)
    evidence = without(evidence, slice(None), 0, slice(None))
    evidence = without(wrong(evidence, slice(None), 1, 2), slice(10, 14), 1, 2)
    evidence = without(evidence, slice(10, 14), 2, 2)
    probability = judged_by(positions_m, evidence, rig, skeleton).visibility
    np.testing.assert_allclose(probability[:, 0], Chain(CONFIG.visibility).usual, rtol=1e-12)
    assert probability[10:14, 1, 2].max() < 0.05
    assert probability[10:14, 2, 2].min() > 0.9
    nobody = judged_by(np.full_like(positions_m, np.nan), evidence, rig, skeleton)
    np.testing.assert_allclose(nobody.visibility, Chain(CONFIG.visibility).usual, rtol=1e-12)
    np.testing.assert_array_equal(nobody.sigma_px, evidence.sigma_px)


def test_one_frame_is_judged_by_itself(rig: CameraRig, skeleton: Skeleton) -> None:
    positions_m, evidence = exact(rig, skeleton, np.zeros(1))
    found = judged_by(positions_m, wrong(evidence, slice(0, 1), 1, 3), rig, skeleton)
    assert found.visibility[0, 1, 3] < 0.01
    others = np.delete(found.visibility[0], 3, axis=1)
    assert others.min() > 0.99
    running = RunningVisibility(4, skeleton, CONFIG)
    running.add(positions_m[0], STILL, wrong(evidence, slice(0, 1), 1, 3), rig, NEW)
    # Online the spread is learned afterwards; in batch these exact detections have made it smaller already.
    np.testing.assert_allclose(running.probability, found.visibility[0], atol=0.02)


def test_frames_within_microseconds_tell_as_much_as_one(rig: CameraRig, skeleton: Skeleton) -> None:
    """Of a burst of 30 frames the first counts as a frame, the others by the time that they take."""
    time_s = np.cumsum(np.r_[np.full(40, STEP_S), np.full(29, 1e-6), np.full(40, STEP_S)])
    positions_m, clear = exact(rig, skeleton, time_s)
    noisy, burst = with_noise(clear, 4.0), slice(39, 69)
    points_px = noisy.undistorted_px.copy()
    points_px[burst] = noisy.undistorted_px[39]
    points_px[burst, 1, 3] = clear.undistorted_px[39, 1, 3] + np.array([17.0, 0.0])
    evidence = replace(noisy, undistorted_px=points_px)
    positions_m = positions_m.copy()
    positions_m[burst] = positions_m[39]
    once = np.r_[:40, 69:109]
    of_all = judged_by(positions_m, evidence, rig, skeleton).visibility
    of_once = judged_by(positions_m[once], evidence.frames(once), rig, skeleton).visibility
    assert 0.5 < of_once[39, 1, 3] < 0.99, "doubtful: 30 of them would tell"
    # 29 frames of 2.5e-5 measurements each; and the spread learned with them differs by a few percent.
    np.testing.assert_allclose(of_all[once], of_once, atol=0.05)


def test_behind_a_camera_the_spread_stays_what_it_was(rig: CameraRig, skeleton: Skeleton) -> None:
    """There is no scale of the image there; at 1 pixel per metre a detection would have 0.02 px."""
    positions_m, evidence = exact(rig, skeleton)
    positions_m, camera = positions_m.copy(), rig.cameras[2]
    positions_m[:, 5] = camera.position_m - camera.world_T_camera[:3, 2]
    sigma_px = judged_by(positions_m, evidence, rig, skeleton).sigma_px
    np.testing.assert_array_equal(sigma_px[:, 2, 5], CONFIG.projection.sigma_px)
    running = RunningVisibility(4, skeleton, CONFIG)
    before = running.predicted(evidence.frames(slice(0, 1)), positions_m[0], rig)
    assert before.sigma_px[0, 2, 5] == CONFIG.projection.sigma_px
    assert sigma_px.min() > 0.1


@pytest.mark.slow
def test_it_helps_under_occlusion(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    truth_m, fps = motion_from_npz(MOCAP / "cmu_03_03_b.npz")
    scene = simulate(truth_m[:100], skeleton, rig, fps, DetectionNoise(), Occlusion(), seed=1)
    with_it, without = (errors_mm(scene, model) for model in ("markov", "none"))
    # Over six such scenes (three clips) the mean is 7 to 20 % lower and the worst 1 % of the joints 23 to 52 %.
    assert with_it.mean() < 0.85 * without.mean()
    assert np.percentile(with_it, 99) < 0.6 * np.percentile(without, 99)


def errors_mm(scene: Scene, model: str, sigma_px: float = CONFIG.projection.sigma_px) -> np.ndarray:
    sections = {"visibility": {"model": model}, "projection": {"sigma_px": sigma_px}}
    config = config_from_dict({**sections, "solver": {"covariance": False}})
    trajectory = fgpose.smooth(scene.observations, scene.rig, config)
    return 1000 * np.linalg.norm(trajectory.positions_m - scene.truth_m, axis=-1)


def test_where_everything_fits_nothing_is_lost(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    """Against the graph that is told how exact the detections are, and against the one that takes them for 5 px."""
    truth_m, fps = motion_from_npz(MOCAP / "cmu_02_01_short.npz")
    noise = DetectionNoise(sigma_px=1.5, correlated_px=1.5, outlier_share=0.002)
    scene = simulate(truth_m[:40], skeleton, rig, fps, noise, Occlusion(n_views=0), seed=0)
    mean_mm = errors_mm(scene, "markov").mean()
    # Over two seeds 5.1 and 5.4 mm, 4.8 and 5.3 mm when told, 5.4 and 5.7 mm at 5 px.
    assert mean_mm < 1.08 * errors_mm(scene, "none", sigma_px=2.5).mean()
    assert mean_mm < errors_mm(scene, "none").mean()


@pytest.mark.slow
def test_a_hallucination_of_one_joint_is_distrusted_however_rare(
    rig: fgpose.CameraRig, skeleton: fgpose.Skeleton
) -> None:
    """A wrist hallucinated in two of four views for 1 s, 0.8 % of the detections of 6 s."""
    truth_m, fps = motion_from_npz(MOCAP / "cmu_02_05.npz")
    scene = simulate(truth_m[:300], skeleton, rig, fps, DetectionNoise(), Occlusion(n_views=0), seed=0)
    wrist, second = skeleton.index("right_wrist"), slice(125, 175)
    points_px = scene.observations.points2d_px.copy()
    points_px[second, :2, wrist] += wandering_px(np.random.default_rng(3), 50, 1 / fps)
    hallucinated = replace(scene, observations=replace(scene.observations, points2d_px=points_px))
    markov_mm, none_mm = (errors_mm(hallucinated, model)[second, wrist].max() for model in ("markov", "none"))
    # 43 and 60 mm
    assert markov_mm < 0.8 * none_mm


def wandering_px(rng: np.random.Generator, n_frames: int, step_s: float) -> np.ndarray:
    """Errors (frame, view, 2) of 45 px per axis that are correlated over 0.5 s, as hallucinations are."""
    keep = np.exp(-step_s / 0.5)
    error_px = [45.0 * rng.normal(size=(2, 2))]
    for _ in range(n_frames - 1):
        error_px.append(keep * error_px[-1] + np.sqrt(1 - keep**2) * 45.0 * rng.normal(size=(2, 2)))
    return np.array(error_px)


@pytest.mark.slow
def test_running_spread_becomes_that_of_the_recording(rig: CameraRig, skeleton: Skeleton) -> None:
    """Errors of 10 px in one camera, 3 px in the others; 20 s, twice as long as it remembers."""
    truth_m, evidence = exact(rig, skeleton, STEP_S * np.arange(1000))
    evidence = with_noise(evidence, np.array([3.0, 3.0, 10.0, 3.0])[:, None, None])
    running = running_after(evidence, truth_m, rig, skeleton)
    last = running.predicted(evidence.frames(slice(-1, None)), truth_m[-1], rig)
    batch_px = judged_by(truth_m, evidence, rig, skeleton).sigma_px[-1]
    # It began with 18 mm, 4.6 px, and forgets that as exp(-t / 10 s); 1 to 5 % of 50 to 100 % are left.
    np.testing.assert_allclose(last.sigma_px[0] / batch_px, 1.0, atol=0.08)


@pytest.mark.slow
def test_camera_by_camera_the_spread_is_that_of_whole_frames(rig: CameraRig, skeleton: Skeleton) -> None:
    """What one camera sees does not make another forget."""
    truth_m, evidence = exact(rig, skeleton, STEP_S * np.arange(60))
    evidence = with_noise(evidence, 10.0)
    sigma_px = []
    for groups in (NEW[None], np.tri(4, dtype=bool)):
        running = RunningVisibility(4, skeleton, CONFIG)
        for frame, position_m in enumerate(truth_m):
            for has_image in groups:
                running.add(position_m, STILL, evidence.frames(slice(frame, frame + 1)), rig, has_image)
        sigma_px.append(running.predicted(evidence.frames(slice(-1, None)), truth_m[-1], rig).sigma_px)
    np.testing.assert_allclose(sigma_px[0], sigma_px[1], rtol=2e-3)  # one detection may change sides of the median


def running_after(evidence: Evidence, positions_m: np.ndarray, rig: CameraRig, skeleton: Skeleton) -> RunningVisibility:
    running = RunningVisibility(rig.n_cameras, skeleton, CONFIG)
    for frame, position_m in enumerate(positions_m):
        is_new = np.ones(rig.n_cameras, dtype=bool)
        running.add(position_m, STILL, evidence.frames(slice(frame, frame + 1)), rig, is_new)
    return running


def test_running_visibility_finds_a_hallucination_and_its_end(rig: CameraRig, skeleton: Skeleton) -> None:
    positions_m, evidence = exact(rig, skeleton)
    evidence = wrong(evidence, slice(10, 25), 1, 3)
    probability = [
        running_after(evidence, positions_m[: n + 1], rig, skeleton).probability[1, 3] for n in (9, 12, 24, 27)
    ]
    assert probability[0] > 0.9
    assert probability[1] < 0.01
    assert probability[2] < 0.01
    assert probability[3] > 0.8
    unseen = without(evidence, slice(25, None), 1, 3)
    fading = [running_after(unseen, positions_m[: n + 1], rig, skeleton).probability[1, 3] for n in (24, 30, 39)]
    assert (np.diff(fading) > 0).all(), "unseen: what is known fades"
    assert fading[-1] < Chain(CONFIG.visibility).usual


def test_a_hidden_detection_tells_less_but_not_nothing(rig: CameraRig, skeleton: Skeleton) -> None:
    """Online as in batch: the weight of Student's distribution, once for as long as errors are correlated."""
    positions_m, evidence = exact(rig, skeleton)
    by_px = 300.0
    evidence = wrong(evidence, slice(None), 1, 3, by_px)
    running, last = running_after(evidence, positions_m[:-1], rig, skeleton), evidence.frames(slice(-1, None))
    known = running.predicted(last, positions_m[-1], rig)
    batch = judged_by(positions_m, evidence, rig, skeleton)
    scale_px = CONFIG.visibility.hallucinated_m * rig.px_per_m(positions_m[-1])[1, 3]
    predicted = Chain(CONFIG.visibility).predicted(running.probability, STEP_S)[1, 3]
    for found, sigma_px, probability in (
        (known.weights[0, 1, 3], known.sigma_px[0, 1, 3], predicted),
        (batch.weights[20, 1, 3], batch.sigma_px[20, 1, 3], batch.visibility[20, 1, 3]),
    ):
        information = 3 / (1 + (by_px / scale_px) ** 2) * (sigma_px / scale_px) ** 2
        # Seven of ten hidden joints are detected near the joint; errors count as one measurement within 0.3 s.
        hidden = 0.7 * information * STEP_S / 0.3
        assert found == pytest.approx(0.5 * probability + (1 - probability) * hidden, rel=1e-6)
    assert np.delete(known.weights / last.weights, 3, axis=2).min() > 0.9


def test_one_camera_is_not_judged(rig: CameraRig, skeleton: Skeleton) -> None:
    one = rig.subset(rig.names[:1])
    positions_m, evidence = exact(one, skeleton)
    running = running_after(wrong(evidence, slice(None), 0, 2), positions_m, one, skeleton)
    np.testing.assert_allclose(running.probability, Chain(CONFIG.visibility).usual)


@pytest.mark.slow
def test_online_a_wrong_pose_is_corrected_by_detections_that_it_distrusts(rig: CameraRig, skeleton: Skeleton) -> None:
    """Somebody who is 0.5 m further within one frame, which no camera's detections confirm in the predicted pose."""
    truth_m = np.repeat(walking(1, FPS, skeleton), 75, axis=0)
    truth_m[50:, :, 0] += 0.5
    scene = simulate(truth_m, skeleton, rig, FPS, DetectionNoise(), NO_OCCLUSION, seed=0)
    estimator = fgpose.Estimator(rig, skeleton, Config(online={"covariance": False}))
    estimates = [estimator.update(frame) for frame in scene.observations]
    positions_m = np.array([estimate.positions_m for estimate in estimates])
    error_mm = 1000 * np.linalg.norm(positions_m - truth_m, axis=-1)
    assert error_mm[60:].mean() < 2 * error_mm[20:50].mean()
    assert all((estimate.status == Status.OBSERVED).all() for estimate in estimates[60:])


def test_what_an_update_accepted_is_taken_back_within_the_lag(rig: CameraRig, skeleton: Skeleton) -> None:
    """A hallucination enters the graph with the weight of a visible detection: only its residual tells, afterwards."""
    wrist, onset = skeleton.index("right_wrist"), 30
    truth_m = np.repeat(walking(1, FPS, skeleton), 60, axis=0)
    scene = simulate(truth_m, skeleton, rig, FPS, DetectionNoise(), NO_OCCLUSION, seed=0)
    points_px = scene.observations.points2d_px.copy()
    points_px[onset:, 1, wrist] += [60.0, 40.0]
    live = fgpose.Estimator(rig, skeleton, Config(online={"covariance": False}))
    shares = []
    for frame in list(replace(scene.observations, points2d_px=points_px))[: onset + 12]:
        live.update(frame)
        state = next((state for state in live._body._window if state.at.frame == onset), None)
        if state is not None:
            shares.append((state.evidence.weights / state.gathered.weights)[0, :, wrist])
    assert shares[0].min() > 0.8, "as predicted from the frames before"
    assert shares[-1][1] < 0.1
    assert np.delete(shares[-1], 1).min() > 0.8


def test_without_the_model_nothing_changes(rig: CameraRig, skeleton: Skeleton) -> None:
    positions_m, evidence = exact(rig, skeleton)
    running = RunningVisibility(4, skeleton, Config(visibility={"model": "none"}))
    last = wrong(evidence, slice(None), 1, 3).frames(slice(-1, None))
    running.add(positions_m[-1], STILL, last, rig, NEW)
    before = running.predicted(last, positions_m[-1], rig)
    np.testing.assert_array_equal(running.probability, 1.0)
    assert before is last


@pytest.mark.slow
def test_online_a_hallucination_loses_its_weight(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    """Two views of four take the left elbow for the right wrist for a second."""
    truth_m, fps = motion_from_npz(MOCAP / "cmu_03_03_b.npz")
    scene = simulate(truth_m[:100], skeleton, rig, fps, DetectionNoise(), Occlusion(n_views=0), seed=0)
    points_px, wrist, hallucinated = scene.observations.points2d_px.copy(), skeleton.index("right_wrist"), slice(40, 90)
    points_px[hallucinated, :2, wrist] = points_px[hallucinated, :2, skeleton.index("left_elbow")]
    observations = replace(scene.observations, points2d_px=points_px, points3d_m=None, covariance3d_m2=None)

    def error_mm(model: str) -> float:
        config = config_from_dict({"visibility": {"model": model}, "online": {"covariance": False}})
        estimator = fgpose.Estimator(rig, skeleton, config)
        positions_m = np.stack([estimator.update(frame).positions_m for frame in observations])
        return float(1e3 * np.linalg.norm(positions_m - scene.truth_m, axis=-1)[hallucinated, wrist].mean())

    # 23 and 81 mm
    assert error_mm("markov") < 0.75 * error_mm("none")


@pytest.mark.parametrize("online", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_joint_that_one_camera_sees_is_predicted(rig: CameraRig, skeleton: Skeleton, online: bool) -> None:
    """Three of four views hallucinate the right wrist for a second, each somewhere else."""
    truth_m, fps = motion_from_npz(MOCAP / "cmu_02_01_short.npz")
    scene = simulate(truth_m[:120], skeleton, rig, fps, DetectionNoise(), Occlusion(n_views=0), seed=0)
    points_px, wrist, hidden = scene.observations.points2d_px.copy(), skeleton.index("right_wrist"), slice(40, 90)
    points_px[hidden, :3, wrist] += np.array([[150.0, 0.0], [-120.0, 90.0], [0.0, -140.0]])
    observations = replace(scene.observations, points2d_px=points_px)
    if online:
        estimator = fgpose.Estimator(rig, skeleton, Config(online={"covariance": False}))
        found = Trajectory.from_estimates([estimator.update(frame) for frame in observations], rig.names)
    else:
        found = fgpose.smooth(observations, rig, Config(solver={"covariance": False}))
    assert found.visibility is not None
    late = slice(50, 90)  # online, it takes some frames to tell
    # Single outliers are part of the noise of the scene.
    assert np.mean(found.status[late, wrist] == Status.PREDICTED) > 0.9
    assert np.mean(found.visibility[late, :3, wrist] < 0.5) > 0.9
    assert np.mean(found.visibility[late, 3, wrist] > 0.5) > 0.9
    others = np.arange(skeleton.n_joints) != wrist
    assert found.observed[:, others].mean() > 0.98


@pytest.mark.slow
@pytest.mark.parametrize("online", [False, True])
def test_a_joint_that_every_camera_hallucinates_is_given_up(rig: CameraRig, skeleton: Skeleton, online: bool) -> None:
    """Four views are 150 px off, each in another direction, with a confidence of 0.02, for two seconds."""
    truth_m, fps = motion_from_npz(MOCAP / "cmu_03_03_b.npz")
    scene = simulate(truth_m[:200], skeleton, rig, fps, DetectionNoise(), NO_OCCLUSION, seed=0)
    wrist, hidden = skeleton.index("right_wrist"), slice(40, 140)
    points_px, confidence = scene.observations.points2d_px.copy(), scene.observations.confidence.copy()
    points_px[hidden, :, wrist] += np.array([[150.0, 0.0], [0.0, 150.0], [0.0, -150.0], [-150.0, 0.0]])
    confidence[hidden, :, wrist] = 0.02
    observations = replace(scene.observations, points2d_px=points_px, confidence=confidence)
    config = config_from_dict({"motion": {"max_unseen_s": 0.5}})
    if online:
        estimator = fgpose.Estimator(rig, skeleton, config)
        found = Trajectory.from_estimates([estimator.update(frame) for frame in observations], rig.names)
    else:
        found = fgpose.smooth(observations, rig, config)
    status = found.status[:, wrist]
    assert (status[hidden] != Status.OBSERVED).all()
    assert (status[:39] == Status.OBSERVED).mean() > 0.9  # single outliers are part of the noise
    # Half a second after two cameras saw it; in batch, as long before they see it again.
    assert np.isnan(found.positions_m[66, wrist]).all()
    assert (status[66:113] == Status.UNOBSERVABLE).all() or online
    assert (status[150:] == Status.OBSERVED).mean() > 0.9
