"""Synthetic scenes: the truth is exact, noise has the statistics it claims, occlusion changes occluded joints only."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import (
    NO_NOISE,
    NO_OCCLUSION,
    DetectionNoise,
    Occlusion,
    Scene,
    motion_from_npz,
    ring_rig,
    simulate,
    walking,
)
from tests.conftest import MOCAP

FPS = 60.0
CLIPS = (
    *("cmu_01_01_a", "cmu_01_04_a"),
    *("cmu_02_01_short", "cmu_02_03_short", "cmu_02_05", "cmu_02_07_a", "cmu_02_10"),
    *("cmu_03_03_a", "cmu_03_03_b"),
)


@pytest.fixture(scope="module")
def standing_m(skeleton: Skeleton) -> np.ndarray:
    """A person frozen for 50 s: errors are then the only thing that varies."""
    return np.repeat(walking(1, FPS, skeleton), 3000, axis=0) - (0, -1, 0)


@pytest.fixture(scope="module")
def noisy_scene(standing_m: np.ndarray, skeleton: Skeleton, rig: CameraRig) -> Scene:
    return simulate(standing_m, skeleton, rig, FPS, DetectionNoise(), NO_OCCLUSION, seed=0)


def pixel_error(scene: Scene) -> np.ndarray:
    return scene.rig.undistort(scene.observations.points2d_px) - scene.rig.project(scene.truth_m)


def error_in_camera_m(scene: Scene) -> np.ndarray:
    points3d_m = scene.observations.points3d_m
    assert points3d_m is not None
    return np.stack(
        [
            camera.to_camera_frame(points3d_m[:, c]) - camera.to_camera_frame(scene.truth_m)
            for c, camera in enumerate(scene.rig.cameras)
        ],
        axis=1,
    )


def test_the_ring_looks_at_its_target() -> None:
    rig = ring_rig(n_cameras=3, radius_m=2.0, height_m=2.5, target_m=(1.0, 2.0, 0.5), size_px=(640, 480))
    for camera in rig.cameras:
        np.testing.assert_allclose(camera.project(np.array([1.0, 2.0, 0.5])), (320, 240), atol=1e-9)
        above, below = camera.project(np.array([[1.0, 2.0, 0.7], [1.0, 2.0, 0.3]]))
        assert above[1] < below[1], "image y points down"
        assert np.linalg.norm(camera.position_m - (1, 2, 2.5)) == pytest.approx(2)
    with pytest.raises(ValueError, match="radius of a ring of cameras must be positive, got 0 m"):
        ring_rig(radius_m=0.0)


def test_the_walking_person_is_rigid_and_symmetric(skeleton: Skeleton) -> None:
    positions_m = walking(120, 30.0, skeleton)
    lengths_m = skeleton.bone_lengths(positions_m)
    assert np.ptp(lengths_m, axis=0).max() < 1e-12
    for left, right in skeleton.limb_pairs:
        ends = [skeleton.bones.index(bone) for bone in (left, right)]
        assert np.ptp(lengths_m[:, ends]) < 1e-12


def test_the_walking_person_walks(skeleton: Skeleton) -> None:
    positions_m = walking(240, FPS, skeleton)
    velocity_mps = np.gradient(positions_m, 1 / FPS, axis=0)
    pelvis, left, right = (skeleton.index(name) for name in ("pelvis", "left_hip", "right_hip"))
    speed_mps = np.linalg.norm(velocity_mps[:, pelvis, :2], axis=-1)
    # A chord instead of the arc, and one-sided differences at both ends.
    np.testing.assert_allclose(speed_mps, 1.2, rtol=1e-3)
    to_the_left = positions_m[:, left] - positions_m[:, right]
    forward = velocity_mps[:, pelvis]
    assert (forward[:, 0] * to_the_left[:, 1] > forward[:, 1] * to_the_left[:, 0]).all(), "left is on the left"
    assert 0.02 < positions_m[..., 2].min() < 0.1, "ankles stay above the floor"
    swing_m = np.ptp(positions_m[:, skeleton.index("left_wrist"), 2])
    assert swing_m > 0.05


def test_a_skeleton_that_the_walker_lacks_is_named(skeleton: Skeleton) -> None:
    joints = tuple("nose" if joint == "head" else joint for joint in skeleton.joints)
    other = dataclasses.replace(skeleton, name="other", joints=joints)
    with pytest.raises(ValueError, match="no joint nose of skeleton other"):
        walking(1, FPS, other)


@pytest.mark.parametrize("clip", CLIPS)
def test_motion_clips_are_people(skeleton: Skeleton, clip: str) -> None:
    positions_m, fps = motion_from_npz(MOCAP / f"{clip}.npz")
    assert fps == 50
    assert positions_m.shape[1:] == (17, 3)
    # The clips are stored in single precision: 1e-7 of 2 m.
    assert np.ptp(skeleton.bone_lengths(positions_m), axis=0).max() < 1e-5
    height_m = positions_m[:, skeleton.index("head"), 2] - positions_m[:, skeleton.index("left_ankle"), 2]
    assert 1.2 < np.median(height_m) < 1.8


def test_the_clips_are_all_that_is_there() -> None:
    assert sorted(path.stem for path in MOCAP.glob("*.npz")) == sorted(CLIPS)
    readme = (MOCAP / "README.md").read_text(encoding="utf-8")
    for clip in CLIPS:
        assert f"| {clip}.npz | {len(motion_from_npz(MOCAP / f'{clip}.npz')[0])} |" in readme


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"positions_m": np.zeros((2, 17, 3))}, "fps is missing"),
        ({"positions_m": np.zeros((2, 17)), "fps": 50}, r"positions_m must be \(any, any, 3\), got \(2, 17\)"),
        ({"positions_m": np.full((2, 17, 3), np.nan), "fps": 50}, "positions_m must be finite"),
    ],
)
def test_a_bad_motion_clip_is_one_clear_error(tmp_path: Path, arrays: dict[str, Any], message: str) -> None:
    path = tmp_path / "clip.npz"
    np.savez(path, **arrays)
    with pytest.raises(ValueError, match=rf"clip\.npz: .*{message}"):
        motion_from_npz(path)
    path.write_text("not an archive")
    with pytest.raises(ValueError, match=r"clip\.npz: .*a damaged npz"):
        motion_from_npz(path)


def test_without_noise_detections_are_the_projected_truth(skeleton: Skeleton, rig: CameraRig) -> None:
    truth_m = walking(20, FPS, skeleton)
    scene = simulate(truth_m, skeleton, rig, FPS, NO_NOISE, NO_OCCLUSION, seed=0)
    np.testing.assert_allclose(scene.observations.points2d_px, rig.project(truth_m), atol=1e-9)
    assert scene.observations.points3d_m is not None
    np.testing.assert_allclose(scene.observations.points3d_m, np.repeat(truth_m[:, None], 4, axis=1), atol=1e-12)
    assert (scene.observations.confidence == 1).all()
    assert not scene.occluded.any()
    scene.observations.check_cameras(rig.names)
    np.testing.assert_allclose(np.diff(scene.observations.frame_time_s), 1 / FPS)


def test_detections_are_in_the_distorted_image(skeleton: Skeleton) -> None:
    straight = ring_rig(n_cameras=2)
    bent = CameraRig(
        tuple(
            Camera(c.name, c.size_px, c.K, c.world_T_camera, np.array([-0.2, 0.1, 0.001, -0.001]))
            for c in straight.cameras
        )
    )
    truth_m = walking(5, FPS, skeleton)
    scene = simulate(truth_m, skeleton, bent, FPS, NO_NOISE, NO_OCCLUSION, seed=0)
    assert np.abs(scene.observations.points2d_px - straight.project(truth_m)).max() > 1
    # The inverse of the distortion is iterative: its tolerance.
    np.testing.assert_allclose(bent.undistort(scene.observations.points2d_px), straight.project(truth_m), atol=1e-6)


def test_a_late_camera_sees_where_the_joints_are_later(skeleton: Skeleton, rig: CameraRig) -> None:
    """Uniform motion, of which every camera's time is known exactly: also before the first and after the last frame."""
    offsets_s = np.array([0.0, 0.04, -0.03, 0.5 / FPS])
    velocity_mps = np.array([0.8, -0.5, 0.1])
    time_s = np.arange(6) / FPS
    truth_m = walking(1, FPS, skeleton) + time_s[:, None, None] * velocity_mps
    scene = simulate(truth_m, skeleton, rig, FPS, NO_NOISE, NO_OCCLUSION, seed=0, offsets_s=offsets_s)
    later_m = truth_m[:, None] + offsets_s[:, None, None] * velocity_mps
    # A spline through points on a line is that line, to rounding: 1e-12 m, or 1e-9 px.
    np.testing.assert_allclose(scene.observations.points2d_px, rig.project_each(later_m), atol=1e-8)
    assert scene.observations.points3d_m is not None
    np.testing.assert_allclose(scene.observations.points3d_m, later_m, atol=1e-9)
    np.testing.assert_array_equal(scene.truth_m, truth_m)
    np.testing.assert_array_equal(scene.observations.time_s, time_s)  # what the observations say of their time


def test_a_late_camera_sees_the_curve_between_the_frames(skeleton: Skeleton, rig: CameraRig) -> None:
    """A walk sampled at 60 Hz, seen half a frame later, is the walk sampled at 120 Hz; the noise is the same."""
    fine_m = walking(60, 2 * FPS, skeleton)
    offsets_s = np.array([0.0, 0.5 / FPS, 0.0, 0.0])
    late = simulate(fine_m[::2], skeleton, rig, FPS, DetectionNoise(), NO_OCCLUSION, seed=0, offsets_s=offsets_s)
    on_time = simulate(fine_m[::2], skeleton, rig, FPS, DetectionNoise(), NO_OCCLUSION, seed=0)
    others = [0, 2, 3]
    late_px, on_time_px = late.observations.points2d_px, on_time.observations.points2d_px
    np.testing.assert_allclose(late_px[:, others], on_time_px[:, others], atol=1e-9)  # rounding of the spline
    moved_px = late_px[:, 1] - on_time_px[:, 1]
    expected_px = rig.cameras[1].project(fine_m[1::2]) - rig.cameras[1].project(fine_m[::2])
    # Half a frame of walking is some px; the spline is exact to thousandths inside, less so at its ends.
    assert np.median(np.abs(expected_px)) > 0.5
    np.testing.assert_allclose(moved_px[3:-3], expected_px[3:-3], atol=0.02)


def test_offsets_of_zero_change_nothing(skeleton: Skeleton, rig: CameraRig) -> None:
    truth_m = walking(20, FPS, skeleton)
    scenes = [
        simulate(truth_m, skeleton, rig, FPS, DetectionNoise(), Occlusion(), seed=0, offsets_s=offsets_s)
        for offsets_s in (None, np.zeros(4))
    ]
    for name in ("points2d_px", "points3d_m", "confidence", "covariance3d_m2"):
        np.testing.assert_array_equal(*(getattr(scene.observations, name) for scene in scenes))


def test_what_is_outside_the_image_is_missing(skeleton: Skeleton, rig: CameraRig) -> None:
    truth_m = walking(5, FPS, skeleton) + np.array([3.0, 3.0, 0.0])
    scene = simulate(truth_m, skeleton, rig, FPS, DetectionNoise(), NO_OCCLUSION, seed=0)
    true_px = rig.project(truth_m)
    inside = np.all((true_px >= 0) & (true_px < 1000), axis=-1)
    np.testing.assert_array_equal(scene.observations.seen, inside)
    assert 0 < inside.mean() < 1
    assert scene.observations.points3d_m is not None
    np.testing.assert_array_equal(np.isfinite(scene.observations.points3d_m).all(axis=-1), inside)


def test_pixel_noise_has_its_standard_deviation(standing_m: np.ndarray, skeleton: Skeleton, rig: CameraRig) -> None:
    noise = DetectionNoise(outlier_share=0.0)
    error_px = pixel_error(simulate(standing_m, skeleton, rig, FPS, noise, NO_OCCLUSION, seed=0))
    # 3 and 4 px make 5. 136 coordinates x 50 s / (2 x 0.15 s): 22,000 independent samples, SD known to 0.5 %; 4 sigma.
    assert error_px.std() == pytest.approx(5.0, rel=0.02)
    assert abs(error_px.mean()) < 4 * 5.0 / np.sqrt(22_000)
    # Only the correlated part survives a shift by one frame: 16 / 25 of the variance times exp(-1/60/0.15).
    shifted = np.mean(error_px[1:] * error_px[:-1]) / error_px.var()
    assert shifted == pytest.approx(16 / 25 * np.exp(-1 / FPS / 0.15), abs=0.02)


def test_outliers_have_their_share(standing_m: np.ndarray, skeleton: Skeleton, rig: CameraRig) -> None:
    noise = dataclasses.replace(NO_NOISE, outlier_share=0.03, outlier_px=40.0)
    error_px = pixel_error(simulate(standing_m, skeleton, rig, FPS, noise, NO_OCCLUSION, seed=0))
    moved = np.abs(error_px).max(axis=-1) > 1e-6
    # 204,000 detections: the share is known to 4e-4, the SD from 12,000 coordinates to 0.7 %; 4 sigma.
    assert moved.mean() == pytest.approx(0.03, abs=0.0016)
    assert error_px[moved].std() == pytest.approx(40.0, rel=0.03)


def test_depth_noise_has_its_structure(noisy_scene: Scene, skeleton: Skeleton) -> None:
    depth_m = error_in_camera_m(noisy_scene)[..., 2]
    around_body_m = depth_m - depth_m.mean(axis=2, keepdims=True)
    for joint, sigma_m in (("left_wrist", 0.150), ("right_elbow", 0.122), ("left_knee", 0.082)):
        # The mean over 17 joints takes part of each joint's own error away (< 9 %); 670 independent samples: 3 %.
        assert around_body_m[:, :, skeleton.index(joint)].std(axis=0).mean() == pytest.approx(sigma_m, rel=0.15)
    body_m = depth_m.mean(axis=2)
    # 0.10 m shared, and the mean of 17 errors of about 0.09 m: 0.103 m; 170 independent samples a camera, 4 cameras.
    assert body_m.std(axis=0).mean() == pytest.approx(0.103, rel=0.15)
    shifted = np.mean((body_m[1:] - body_m.mean(0)) * (body_m[:-1] - body_m.mean(0))) / body_m.var(axis=0).mean()
    assert shifted == pytest.approx(0.9, abs=0.02)


def test_every_camera_has_a_depth_bias_of_its_own(standing_m: np.ndarray, skeleton: Skeleton) -> None:
    noise = dataclasses.replace(NO_NOISE, camera_bias_m=0.08)
    scene = simulate(standing_m[:2], skeleton, ring_rig(n_cameras=200), FPS, noise, NO_OCCLUSION, seed=0)
    depth_m = error_in_camera_m(scene)[..., 2]
    np.testing.assert_allclose(np.ptp(depth_m, axis=(0, 2)), 0.0, atol=1e-12)
    # The SD of 200 samples is known to 5 %; 3 sigma.
    assert depth_m[0, :, 0].std() == pytest.approx(0.08, rel=0.15)


def test_lateral_error_is_the_measured_one(noisy_scene: Scene, skeleton: Skeleton, rig: CameraRig) -> None:
    error_m = error_in_camera_m(noisy_scene)
    true_m = np.stack([camera.to_camera_frame(noisy_scene.truth_m) for camera in rig.cameras], axis=1)
    estimated_m = true_m + error_m
    lateral_m = (estimated_m[..., :2] / estimated_m[..., 2:] - true_m[..., :2] / true_m[..., 2:]) * true_m[..., 2:]
    # 20 mm is what the documentation promises; outliers (1 % of 40 px) and other distances than 4.5 m add to it.
    assert np.median(np.abs(lateral_m)) / 0.6745 == pytest.approx(0.022, abs=0.003)


def test_confidence_informs_but_is_no_oracle(rig: CameraRig, skeleton: Skeleton) -> None:
    truth_m, fps = motion_from_npz(MOCAP / "cmu_02_05.npz")
    scene = simulate(truth_m[:400], skeleton, rig, fps, DetectionNoise(), Occlusion(), seed=0)
    confidence, seen = scene.observations.confidence, scene.observations.seen
    visible, occluded = confidence[seen & ~scene.occluded], confidence[seen & scene.occluded]
    # Chance that a visible joint is rated above an occluded one, over quantiles: 0.5 tells nothing, 1 is an oracle.
    grid = np.linspace(0.005, 0.995, 100)
    better = np.mean(np.quantile(visible, grid)[:, None] > np.quantile(occluded, grid))
    assert 0.75 < better < 0.95
    rank = np.corrcoef(confidence[seen], np.linalg.norm(pixel_error(scene)[seen], axis=-1))[0, 1]
    assert -0.9 < rank < -0.3


def test_occlusion_leaves_the_noise_of_visible_joints_alone(rig: CameraRig, skeleton: Skeleton) -> None:
    truth_m = walking(120, FPS, skeleton)
    scenes = [
        simulate(truth_m, skeleton, rig, FPS, DetectionNoise(), occlusion, seed=3)
        for occlusion in (NO_OCCLUSION, Occlusion(), Occlusion(n_views=1, n_occluders=1, missing_share=0.7))
    ]
    for scene in scenes[1:]:
        visible = ~scene.occluded
        assert scene.occluded.any()
        for name in ("points2d_px", "points3d_m", "confidence"):
            clear = getattr(scenes[0].observations, name)[visible]
            np.testing.assert_array_equal(getattr(scene.observations, name)[visible], clear)
        hidden = scene.occluded & scene.observations.seen
        moved = scene.observations.points2d_px[hidden] - scenes[0].observations.points2d_px[hidden]
        assert np.abs(moved).max(axis=-1).min() > 0


def test_the_same_seed_gives_the_same_scene(rig: CameraRig, skeleton: Skeleton) -> None:
    def scene(seed: int) -> Scene:
        return simulate(walking(30, FPS, skeleton), skeleton, rig, FPS, DetectionNoise(), Occlusion(), seed)

    first, again, other = scene(0), scene(0), scene(1)
    np.testing.assert_array_equal(first.observations.points2d_px, again.observations.points2d_px)
    np.testing.assert_array_equal(first.observations.points3d_m, again.observations.points3d_m)
    np.testing.assert_array_equal(first.occluded, again.occluded)
    assert not np.array_equal(first.observations.points2d_px, other.observations.points2d_px, equal_nan=True)


def test_the_share_of_occluded_joints_is_that_of_the_rule(rig: CameraRig, skeleton: Skeleton) -> None:
    truth_m, fps = motion_from_npz(MOCAP / "cmu_02_05.npz")
    shares = [
        simulate(truth_m[:400], skeleton, rig, fps, DetectionNoise(), Occlusion(n_views=n_views), seed).occluded.mean()
        for n_views in (1, 3)
        for seed in range(10)
    ]
    one_view, three_views = np.mean(shares[:10]), np.mean(shares[10:])
    # An occluder covers about a sixth of a person's joints, two about 30 %, in 3 of 4 views.
    assert 0.15 < three_views < 0.35
    # Draws of 10 x 5 periods leave about 10 % of scatter in each.
    assert one_view == pytest.approx(three_views / 3, rel=0.4)


def test_the_number_of_views_with_occluders_is_kept(rig: CameraRig, skeleton: Skeleton) -> None:
    huge = Occlusion(n_views=3, min_scale=20.0, max_scale=20.0)
    scene = simulate(walking(300, FPS, skeleton), skeleton, rig, FPS, DetectionNoise(), huge, seed=0)
    by_view = scene.occluded.all(axis=2)
    assert (scene.occluded.any(axis=2) == by_view).all()
    assert (by_view.sum(axis=1) == 3).all()
    assert by_view.any(axis=0).all(), "every view has its turn"
    changes_s = np.flatnonzero(np.diff(by_view, axis=0).any(axis=1)) / FPS
    # Drawn anew after at least a second, to within a frame; the draw may come out the same.
    assert (np.diff(changes_s) > 1 - 1 / FPS - 1e-9).all()


def test_hallucinations_are_large_correlated_and_on_one_ray(
    standing_m: np.ndarray, skeleton: Skeleton, rig: CameraRig
) -> None:
    huge = Occlusion(n_views=4, min_scale=20.0, max_scale=20.0, missing_share=0.2)
    scene = simulate(standing_m, skeleton, rig, FPS, NO_NOISE, huge, seed=0)
    assert scene.occluded.all()
    seen = scene.observations.seen
    # 68 tracks x 50 s / (2 x 0.3 s): 5,700 independent samples, share known to 0.005, SD to 1 %; 4 sigma.
    assert seen.mean() == pytest.approx(0.8, abs=0.03)
    error_px = pixel_error(scene)
    assert error_px[seen].std() == pytest.approx(45.0, rel=0.04)
    depth_m = error_in_camera_m(scene)[..., 2]
    assert depth_m[seen].std() == pytest.approx(0.15, rel=0.04)
    both = seen[1:] & seen[:-1]
    shifted = np.mean(error_px[1:][both] * error_px[:-1][both]) / error_px[seen].var()
    assert shifted == pytest.approx(np.exp(-1 / FPS / 0.3), abs=0.01)
    assert scene.observations.points3d_m is not None
    for c, camera in enumerate(rig.cameras):
        on_ray_px = camera.project(scene.observations.points3d_m[:, c])
        np.testing.assert_allclose(on_ray_px, scene.observations.points2d_px[:, c], atol=1e-6)
    gone = (seen[1:] != seen[:-1]).mean()
    assert gone < 0.1, "a joint is missing for a while, not from frame to frame"


def test_the_occluded_scene_of_the_other_tests_is_worth_its_name(mocap_scene: Scene, walking_scene: Scene) -> None:
    assert 0.1 < mocap_scene.occluded.mean() < 0.4
    assert (mocap_scene.observations.seen.sum(axis=1) >= 2).mean() > 0.95
    assert walking_scene.observations.seen.mean() > 0.99


@pytest.mark.parametrize(
    ("kind", "changes", "message"),
    [
        (DetectionNoise, {"sigma_px": -1.0}, r"DetectionNoise.sigma_px must be in \[0, inf\], got -1.0"),
        (DetectionNoise, {"outlier_share": 1.2}, r"DetectionNoise.outlier_share must be in \[0, 1\]"),
        (DetectionNoise, {"body_depth_m": float("nan")}, "DetectionNoise.body_depth_m"),
        (Occlusion, {"missing_share": 2.0}, "Occlusion.missing_share"),
        (Occlusion, {"min_scale": 2.0}, "Occlusion.min_scale must not exceed max_scale"),
        (Occlusion, {"min_duration_s": 0.0}, "Occlusion.min_duration_s must be positive"),
        (Occlusion, {"max_aspect": 0.5}, "max_aspect at least 1"),
    ],
)
def test_settings_without_meaning_are_refused(kind: type, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        kind(**changes)


def test_what_cannot_be_filmed_is_refused(rig: CameraRig, skeleton: Skeleton) -> None:
    truth_m = walking(3, FPS, skeleton)

    def film(truth_m: np.ndarray, occlusion: Occlusion) -> None:
        simulate(truth_m, skeleton, rig, FPS, DetectionNoise(), occlusion, seed=0)

    with pytest.raises(ValueError, match="5 occluded views need as many cameras, the rig has 4"):
        film(truth_m, Occlusion(n_views=5))
    with pytest.raises(ValueError, match=r"the truth must be \(frames, 17, 3\) and finite"):
        film(truth_m * np.nan, NO_OCCLUSION)
    with pytest.raises(ValueError, match=r"got \(3, 16, 3\)"):
        film(truth_m[:, 1:], NO_OCCLUSION)
