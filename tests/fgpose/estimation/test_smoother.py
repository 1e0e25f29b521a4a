"""Batch smoothing: accuracy, windows, covariance, and recordings with little in them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose.assessment.metrics import jitter_mps3
from fgpose.config import config_from_dict
from fgpose.estimation.evidence.gather import gather
from fgpose.io.skeletons import load_skeleton
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
from tests.wrong_rigs import in_another_world


@pytest.fixture(scope="module")
def long_scene(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> Scene:
    """Five seconds of real motion, noisy, nothing occluded."""
    truth_m, fps = motion_from_npz(MOCAP / "cmu_02_05.npz")
    return simulate(truth_m[:250], skeleton, rig, fps, DetectionNoise(), NO_OCCLUSION, seed=1)


@pytest.fixture(scope="module")
def long_smoothed(long_scene: Scene, rig: fgpose.CameraRig) -> fgpose.Trajectory:
    return fgpose.smooth(long_scene.observations, rig)


@pytest.fixture(scope="module")
def mocap_smoothed(mocap_scene: Scene, rig: fgpose.CameraRig) -> fgpose.Trajectory:
    return fgpose.smooth(mocap_scene.observations, rig)


def mean_error_m(trajectory: fgpose.Trajectory, scene: Scene) -> float:
    return float(np.nanmean(np.linalg.norm(trajectory.positions_m - scene.truth_m, axis=-1)))


def test_without_noise_the_truth_is_recovered(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    truth_m = walking(60, 50.0, skeleton)
    scene = simulate(truth_m, skeleton, rig, 50.0, NO_NOISE, NO_OCCLUSION, seed=0)
    trajectory = fgpose.smooth(scene.observations, rig, config_from_dict({"projection": {"sigma_px": 0.5}}))
    # What is left is smoothing of exact points as if their errors were 2 mm, the least spread that is learned.
    assert np.max(np.linalg.norm(trajectory.positions_m - truth_m, axis=-1)) < 1.5e-3
    assert trajectory.convergence is not None
    assert trajectory.convergence.converged


@pytest.mark.slow
def test_each_ingredient_helps_under_occlusion(
    mocap_scene: Scene, mocap_smoothed: fgpose.Trajectory, rig: fgpose.CameraRig
) -> None:
    full = mean_error_m(mocap_smoothed, mocap_scene)
    alone = mean_error_m(fgpose.refine(mocap_scene.observations, rig), mocap_scene)
    assert full < 0.6 * alone

    def error_m(sections: dict[str, dict[str, str]]) -> float:
        config = config_from_dict({**sections, "solver": {"covariance": False}})
        return mean_error_m(fgpose.smooth(mocap_scene.observations, rig, config), mocap_scene)

    kernel_alone = error_m({"visibility": {"model": "none"}})
    assert full < kernel_alone
    for without in ({"motion": {"model": "none"}}, {"symmetry": {"form": "none"}}):
        assert full < error_m(without), without
    # With the posterior of visibility, the kernel is worth less than 1 %.
    assert kernel_alone < error_m({"visibility": {"model": "none"}, "projection": {"kernel": "none"}})


@pytest.mark.slow
def test_the_fusion_weights_are_no_worse_than_the_others(
    mocap_scene: Scene, mocap_smoothed: fgpose.Trajectory, rig: fgpose.CameraRig
) -> None:
    """The default weighting against the options, where it matters: three of four views occluded, and nothing else
    that tells which detections are hallucinated."""

    def error_m(weighting: str, visibility: str) -> float:
        sections = {"projection": {"weighting": weighting}, "visibility": {"model": visibility}}
        config = config_from_dict({**sections, "solver": {"covariance": False}})
        trajectory = fgpose.smooth(mocap_scene.observations, rig, config)
        return mean_error_m(trajectory, mocap_scene)

    alone_m = error_m("fusion", "none")
    assert alone_m < error_m("uniform", "none")
    assert alone_m < 1.05 * error_m("confidence", "none")  # 5 %: within what one three-second scene can tell
    # What was found to be invented no longer needs the weights: over 12 such scenes they then gain 1.6 %, in this one
    # they lose up to 3 %, as the processor rounds.
    assert mean_error_m(mocap_smoothed, mocap_scene) < 1.05 * error_m("uniform", "markov")


@pytest.mark.slow
def test_the_depth_of_each_view_helps_where_two_cameras_are_occluded(
    rig: fgpose.CameraRig, skeleton: fgpose.Skeleton
) -> None:
    truth_m, fps = motion_from_npz(MOCAP / "cmu_02_05.npz")
    pair = rig.subset(rig.names[:2])
    scene = simulate(truth_m[:100], skeleton, pair, fps, DetectionNoise(), Occlusion(n_views=2), seed=0)

    def error_m(use: str) -> float:
        trajectory = fgpose.smooth(
            scene.observations, pair, config_from_dict({"depth": {"use": use}, "solver": {"covariance": False}})
        )
        return mean_error_m(trajectory, scene)

    few_views_m = error_m("few_views")
    # 39.5 and 44.7 mm
    assert few_views_m < error_m("never")
    # with two cameras no joint has more than two views
    assert few_views_m == error_m("always")


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1.0, 3.0])
def test_depths_without_covariance_have_that_of_the_recording(
    scale: float, long_scene: Scene, rig: fgpose.CameraRig
) -> None:
    """Errors along the ray, of which those of the second view are three times as large; in a single frame nothing tells
    their size."""
    filmed = long_scene.observations
    centres_m = np.array([camera.position_m for camera in rig.cameras])[:, None]
    rays_m = long_scene.truth_m[:, None] - centres_m
    relative = 0.02 * np.random.default_rng(0).normal(size=rays_m.shape[:3])
    relative[:, 1] *= scale
    views_m = centres_m + (1 + relative)[..., None] * rays_m
    observations = replace(filmed, points3d_m=views_m, covariance3d_m2=None)
    config = config_from_dict({"depth": {"use": "always"}})
    evidence = gather(observations, rig, config)
    found = np.median(evidence.depth_sigma_m / np.linalg.norm(views_m - centres_m, axis=-1), axis=(0, 2))
    # triangulation adds an error of 0.2 % of the distance; 2,000 depths tell a median to 3 %
    np.testing.assert_allclose(found, [0.02, 0.02 * scale, 0.02, 0.02], rtol=0.08)
    single = gather(observations.frames(slice(0, 1)), rig, config)
    np.testing.assert_allclose(single.depth_sigma_m[0, 0], 0.043 * np.linalg.norm(views_m - centres_m, axis=-1)[0, 0])


def test_estimated_bone_lengths(long_scene: Scene, rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    config = config_from_dict({"solver": {"covariance": False}})
    lengths_m = fgpose.smooth(long_scene.observations.frames(slice(0, 100)), rig, config).bone_lengths_m
    assert lengths_m is not None
    true_m = np.zeros(skeleton.n_lengths)
    true_m[list(skeleton.length_of_bone)] = skeleton.bone_lengths(long_scene.truth_m)[0]
    # Detection errors that last for the whole scene bias a length by millimetres; 12 mm is 4 % of a forearm.
    assert np.max(np.abs(lengths_m - true_m)) < 0.012


@pytest.mark.slow
def test_a_limb_mirrored_in_one_of_two_views_does_not_stretch_the_bones_of_windows(
    long_scene: Scene, rig: fgpose.CameraRig, skeleton: fgpose.Skeleton
) -> None:
    """Camera 1 takes the right arm for the left one throughout: the lengths come from frames that know that."""
    two = list(rig.names[:2])
    seen = long_scene.observations.frames(slice(0, 150)).subset(two)
    points2d_px = seen.points2d_px.copy()
    noise_px = np.random.default_rng(1).normal(0, 2, (150, 2, 2))
    for k, name in enumerate(("elbow", "wrist")):
        left, right = skeleton.index(f"left_{name}"), skeleton.index(f"right_{name}")
        points2d_px[:, 1, left] = points2d_px[:, 1, right] + noise_px[:, k]
    mirrored = replace(seen, points2d_px=points2d_px, points3d_m=None)
    config = config_from_dict({"solver": {"window_s": 1.0, "overlap_s": 0.2, "covariance": False}})
    lengths_m = fgpose.smooth(mirrored, rig.subset(two), config).bone_lengths_m
    true_m = np.zeros(skeleton.n_lengths)
    true_m[list(skeleton.length_of_bone)] = skeleton.bone_lengths(long_scene.truth_m)[0]
    upper_arm = skeleton.length_names.index("left_shoulder-left_elbow")
    assert lengths_m is not None
    assert lengths_m[upper_arm] == pytest.approx(true_m[upper_arm], abs=0.012)  # as without it


@pytest.mark.slow
def test_windows_leave_no_seam(long_scene: Scene, long_smoothed: fgpose.Trajectory, rig: fgpose.CameraRig) -> None:
    """Joined from windows of 1.6 s or solved in one piece: the same within 0.5 mm for half of all joints, 3 mm for
    every one. Half a millimetre of it are the bone lengths, which the windows take from frames that are solved before
    the motion is known; the rest is that the motion from which the process noise is learned is known to 5 mm."""
    steps = []
    joined = fgpose.smooth(
        long_scene.observations,
        rig,
        config_from_dict({"solver": {"window_s": 1.6, "overlap_s": 1.0}}),
        progress=lambda done, total: steps.append((done, total)),
    )
    assert [done for done, _ in steps] == sorted({done for done, _ in steps})
    assert len(steps) == 3
    assert steps[-1] == (250, 250)
    apart_m = np.linalg.norm(joined.positions_m - long_smoothed.positions_m, axis=-1)
    assert np.median(apart_m) < 0.5e-3
    assert np.max(apart_m) < 3e-3


@pytest.mark.slow
def test_covariance_in_windows_is_that_of_one_piece(long_scene: Scene, rig: fgpose.CameraRig) -> None:
    observations = long_scene.observations.frames(slice(0, 60))
    settings = {"covariance": True, "overlap_s": 0.4}
    whole = fgpose.smooth(observations, rig, config_from_dict({"solver": settings}))
    steps: list[tuple[int, int]] = []
    config = config_from_dict({"solver": {**settings, "window_s": 0.6}})
    joined = fgpose.smooth(observations, rig, config, progress=lambda done, total: steps.append((done, total)))
    assert len(steps) >= 2, "several windows"
    assert whole.covariance_m2 is not None
    assert joined.covariance_m2 is not None
    ratio = np.trace(joined.covariance_m2, axis1=2, axis2=3) / np.trace(whole.covariance_m2, axis1=2, axis2=3)
    # Held lengths instead of estimated ones make a window slightly more certain. And each window finds by itself how
    # its errors are correlated, of which 0.6 s tell little.
    assert np.median(ratio) == pytest.approx(1.0, abs=0.15)
    # Each window learns the errors of detections from its own frames: sigmas differ by a third, of 99 % of the joints.
    assert np.quantile(np.abs(np.sqrt(ratio) - 1.0), 0.99) < 0.4


def test_what_is_not_known_to_seven_digits_takes_half_of_the_memory(long_smoothed: fgpose.Trajectory) -> None:
    large = {name: getattr(long_smoothed, name).dtype for name in ("covariance_m2", "residual_px", "visibility")}
    assert large == dict.fromkeys(large, np.float32)
    assert long_smoothed.positions_m.dtype == np.float64


def test_keypoints_in_single_precision_are_kept_so_and_computed_with_in_double(
    long_scene: Scene, rig: fgpose.CameraRig
) -> None:
    seen = long_scene.observations.first_frames(20)
    single = fgpose.Observations(
        seen.skeleton, seen.time_s, seen.points2d_px.astype(np.float32), seen.confidence.astype(np.float32)
    )
    double = replace(single, points2d_px=single.points2d_px.astype(float), confidence=single.confidence.astype(float))
    assert (single.points2d_px.dtype, single.confidence.dtype) == (np.float32, np.float32)
    np.testing.assert_array_equal(fgpose.smooth(single, rig).positions_m, fgpose.smooth(double, rig).positions_m)


def test_a_joint_seen_again_later_is_bridged(
    long_scene: Scene, rig: fgpose.CameraRig, skeleton: fgpose.Skeleton
) -> None:
    wrist = skeleton.index("left_wrist")
    points2d_px, points3d_m = long_scene.observations.points2d_px.copy(), long_scene.observations.points3d_m
    assert points3d_m is not None
    points3d_m = points3d_m.copy()
    points2d_px[60:75, :, wrist] = np.nan
    points3d_m[60:75, :, wrist] = np.nan
    observations = replace(long_scene.observations, points2d_px=points2d_px, points3d_m=points3d_m)
    config = config_from_dict({"solver": {"covariance": True}})
    trajectory = fgpose.smooth(observations.frames(slice(0, 140)), rig, config)
    assert (trajectory.status[60:75, wrist] == fgpose.Status.PREDICTED).all()
    assert (trajectory.status[:60, wrist] == fgpose.Status.OBSERVED).all()
    error_m = np.linalg.norm(trajectory.positions_m[60:75, wrist] - long_scene.truth_m[60:75, wrist], axis=-1)
    assert np.max(error_m) < 0.15  # an arm at punching speed, 0.3 s unseen
    assert trajectory.covariance_m2 is not None
    sigma_m = np.sqrt(np.trace(trajectory.covariance_m2[:, wrist], axis1=1, axis2=2) / 3)
    assert sigma_m[67] > 3 * np.median(sigma_m[:50])


def test_a_joint_never_seen_is_unobservable(
    long_scene: Scene, rig: fgpose.CameraRig, skeleton: fgpose.Skeleton
) -> None:
    head = skeleton.index("head")
    points2d_px = long_scene.observations.points2d_px[:30].copy()
    points2d_px[:, :, head] = np.nan
    observations = fgpose.Observations(
        skeleton, long_scene.observations.time_s[:30], points2d_px, camera_names=rig.names
    )
    trajectory = fgpose.smooth(observations, rig, config_from_dict({"solver": {"covariance": True}}))
    assert np.isnan(trajectory.positions_m[:, head]).all()
    assert (trajectory.status[:, head] == fgpose.Status.UNOBSERVABLE).all()
    others = np.arange(skeleton.n_joints) != head
    assert np.isfinite(trajectory.positions_m[:, others]).all()
    assert trajectory.covariance_m2 is not None
    assert np.isfinite(trajectory.covariance_m2[:, others]).all()
    assert trajectory.bone_lengths_m is not None
    assert np.isnan(trajectory.bone_lengths_m).sum() == 1


def test_nothing_seen_at_all(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    observations = fgpose.Observations(skeleton, np.arange(5) / 50, np.full((5, 4, 17, 2), np.nan))
    trajectory = fgpose.smooth(observations, rig, config_from_dict({"solver": {"covariance": True}}))
    assert np.isnan(trajectory.positions_m).all()
    assert (trajectory.status == fgpose.Status.UNOBSERVABLE).all()
    assert np.isnan(fgpose.refine(observations, rig).positions_m).all()


def test_one_frame(long_scene: Scene, rig: fgpose.CameraRig) -> None:
    trajectory = fgpose.smooth(long_scene.observations.frames(slice(0, 1)), rig)
    error_m = np.linalg.norm(trajectory.positions_m - long_scene.truth_m[:1], axis=-1)
    assert np.median(error_m) < 0.04  # one frame of 5 px noise, robust: about twice that of the smoothed sequence


def test_one_camera_gives_the_fused_depth_or_nothing(long_scene: Scene, rig: fgpose.CameraRig) -> None:
    """One ray does not determine a joint: with per-view 3D the result is a prediction, without it is nothing."""
    name = rig.names[0]
    one = long_scene.observations.frames(slice(0, 20)).subset([name])
    with_3d = fgpose.smooth(one, rig.subset([name]))
    assert (with_3d.status == fgpose.Status.PREDICTED).all()
    assert np.median(np.linalg.norm(with_3d.positions_m - long_scene.truth_m[:20], axis=-1)) < 0.3  # depth SD 0.15 m
    without = fgpose.smooth(replace(one, points3d_m=None), rig.subset([name]))
    assert (without.status == fgpose.Status.UNOBSERVABLE).all()


def test_two_cameras(long_scene: Scene, rig: fgpose.CameraRig) -> None:
    names = list(rig.names[:2])
    trajectory = fgpose.smooth(long_scene.observations.frames(slice(0, 80)).subset(names), rig.subset(names))
    assert np.median(np.linalg.norm(trajectory.positions_m - long_scene.truth_m[:80], axis=-1)) < 0.04


def test_detections_of_a_camera_that_looks_away(long_scene: Scene, rig: fgpose.CameraRig) -> None:
    """The person is behind one camera, whose detector sees somebody all the same: it neither pulls nor crashes."""
    backward = np.diag([-1.0, 1.0, -1.0, 1.0])
    away = replace(rig.cameras[0], world_T_camera=rig.cameras[0].world_T_camera @ backward)
    wrong = fgpose.CameraRig((away, *rig.cameras[1:]))
    observations = replace(long_scene.observations.frames(slice(0, 40)), points3d_m=None)
    trajectory = fgpose.smooth(observations, wrong)
    assert trajectory.residual_px is not None
    assert np.isnan(trajectory.residual_px[:, 0]).all()
    assert np.median(np.linalg.norm(trajectory.positions_m - long_scene.truth_m[:40], axis=-1)) < 0.03


def test_a_calibration_in_millimetres(long_scene: Scene, rig: fgpose.CameraRig) -> None:
    observations = replace(long_scene.observations.frames(slice(0, 20)), points3d_m=None)
    with pytest.raises(ValueError, match="looks like millimetres"):
        fgpose.smooth(observations, in_another_world(rig, 1000.0))


@pytest.mark.slow
def test_a_person_who_comes_late(long_scene: Scene, rig: fgpose.CameraRig) -> None:
    """Nobody for the first three seconds: they are not solved, and nothing is known of them."""
    points2d_px = long_scene.observations.points2d_px[:150].copy()
    points2d_px[:90] = np.nan
    observations = replace(long_scene.observations.frames(slice(0, 150)), points2d_px=points2d_px, points3d_m=None)
    config = config_from_dict({"solver": {"window_s": 1.0, "overlap_s": 0.2}, "motion": {"max_unseen_s": 0.1}})
    trajectory = fgpose.smooth(observations, rig, config)
    assert trajectory.bone_lengths_m is not None
    assert np.isfinite(trajectory.bone_lengths_m).all()
    assert (trajectory.status[:80] == fgpose.Status.UNOBSERVABLE).all()
    assert np.median(np.linalg.norm(trajectory.positions_m[95:] - long_scene.truth_m[95:150], axis=-1)) < 0.03


def test_cameras_must_match(long_scene: Scene, rig: fgpose.CameraRig) -> None:
    with pytest.raises(ValueError, match=f"lacks camera {rig.names[3]}"):
        fgpose.smooth(long_scene.observations, rig.subset(rig.names[:3]))
    with pytest.raises(ValueError, match=f"camera {rig.names[3]} of the calibration has no keypoints"):
        fgpose.smooth(long_scene.observations.subset(list(rig.names[:3])), rig)


@pytest.mark.slow
@pytest.mark.parametrize("name", fgpose.files.recordings())
def test_real_recordings_against_each_frame_alone(name: str) -> None:
    """On real detections: lower jitter than per-frame refinement, and no higher median reprojection error."""
    rig, observations = fgpose.files.load_recording(name)
    smoothed, refined = fgpose.smooth(observations, rig), fgpose.refine(observations, rig)
    assert smoothed.residual_px is not None
    assert refined.residual_px is not None
    assert np.nanmedian(smoothed.residual_px) <= np.nanmedian(refined.residual_px)
    smoothed_jitter = jitter_mps3(smoothed.positions_m, smoothed.time_s)
    assert smoothed_jitter < 0.2 * jitter_mps3(refined.positions_m, refined.time_s)


@pytest.mark.slow
@pytest.mark.parametrize("name", fgpose.files.recordings())
def test_real_recordings_without_any_one_camera(name: str) -> None:
    """With the calibration refined (one camera of this rig is 25 px off), hiding any camera moves the joints little."""
    rig, observations = fgpose.files.load_recording(name)
    observations = observations.frames(slice(0, 50))
    rig = fgpose.calibration.refine_rig(observations, rig).rig
    whole = fgpose.smooth(observations, rig)
    for hidden in rig.names:
        names = [other for other in rig.names if other != hidden]
        part = fgpose.smooth(observations.subset(names), rig.subset(names))
        moved_m = np.linalg.norm(part.positions_m - whole.positions_m, axis=-1)
        assert np.nanmedian(moved_m) < 0.015, hidden


def test_a_recording_of_other_skeletons(rig: fgpose.CameraRig) -> None:
    """A skeleton without a pelvis, seen without noise."""
    skeleton = load_skeleton("coco_17")
    rng = np.random.default_rng(0)
    truth_m = rng.normal([0.0, 0.0, 1.0], 0.3, (1, 17, 3)) + np.linspace(0, 0.2, 20)[:, None, None] * [1.0, 0.5, 0.0]
    observations = fgpose.Observations(skeleton, np.arange(20) / 50, rig.project(truth_m), camera_names=rig.names)
    config = config_from_dict({"symmetry": {"form": "none"}})  # these random joints have no symmetric body
    trajectory = fgpose.smooth(observations, rig, config)
    assert np.max(np.linalg.norm(trajectory.positions_m - truth_m, axis=-1)) < 1e-3


def test_symmetry_within_each_frame_of_a_body_without_limb_pairs(walking_scene: Scene, rig: fgpose.CameraRig) -> None:
    """Nothing is left of it, in either backend; the two never agree to the last digit."""
    seen = walking_scene.observations.frames(slice(0, 5))
    bare = replace(seen, skeleton=replace(seen.skeleton, limbs=()))

    def positions_m(backend: str, form: str) -> np.ndarray:
        config = config_from_dict({"symmetry": {"form": form}, "solver": {"backend": backend}})
        return fgpose.smooth(bare, rig, config).positions_m

    ours_m, theirs_m = positions_m("numpy", "frame"), positions_m("gtsam", "frame")
    np.testing.assert_array_equal(ours_m, positions_m("numpy", "none"))
    np.testing.assert_array_equal(theirs_m, positions_m("gtsam", "none"))
    assert not np.array_equal(ours_m, theirs_m)
