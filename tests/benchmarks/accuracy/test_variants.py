from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgpose_benchmarks.accuracy.variants import (
    TEST_CLIPS,
    TUNING_CLIPS,
    VARIANTS,
    Variant,
    find_variant,
    record,
    recordings,
)
from fgpose_benchmarks.comparison.recording import BenchmarkRecording
from fgpose_benchmarks.synthetic import NO_NOISE

CLIP = "cmu_02_05"


def noise_free(name: str) -> Variant:
    return replace(find_variant(name), noise=NO_NOISE)


def offset_frames(recording: BenchmarkRecording, camera: int) -> float:
    """By how many frames a noise-free camera is late: least squares on how its image of the truth changes."""
    true_px = recording.true_rig.cameras[camera].project(recording.truth_m)
    seen_px = recording.observations.points2d_px[:, camera]
    change_px = np.gradient(true_px, axis=0)
    # Not the ends, where gradient() is one-sided and the motion had to be continued.
    inner = slice(3, -3)
    seen = np.isfinite(seen_px)[inner]
    delay_px, change_px = (seen_px - true_px)[inner][seen], change_px[inner][seen]
    return float(np.sum(delay_px * change_px) / np.sum(change_px**2))


def test_the_clips_are_split():
    assert not set(TUNING_CLIPS) & set(TEST_CLIPS)


@pytest.mark.parametrize("name", ["occluded", "industrial"])
def test_the_same_name_is_the_same_recording(name):
    first, second = (record(find_variant(name), CLIP, 60) for _ in range(2))
    np.testing.assert_array_equal(first.truth_m, second.truth_m)
    for array in ("points2d_px", "confidence", "points3d_m", "time_s"):
        np.testing.assert_array_equal(getattr(first.observations, array), getattr(second.observations, array))
    np.testing.assert_array_equal(first.true_rig.projection_matrices, second.true_rig.projection_matrices)
    np.testing.assert_array_equal(first.true_offsets_s, second.true_offsets_s)


def test_clips_differ_in_their_noise():
    first, second = (record(find_variant("clean"), clip, 60) for clip in ("cmu_02_05", "cmu_02_10"))
    noise_px = [each.observations.points2d_px - each.rig.project(each.truth_m) for each in (first, second)]
    assert np.nanmin(np.abs(noise_px[0] - noise_px[1]).max(axis=(1, 2, 3))) > 1.0


def test_occlusion_changes_occluded_joints_only():
    clean, occluded = (record(find_variant(name), CLIP, 60) for name in ("clean", "occluded"))
    assert not clean.occluded.any()
    assert 0.05 < occluded.occluded.mean() < 0.5
    # At no time are all views occluded.
    assert occluded.occluded.any(axis=2).sum(axis=1).max() == 3
    visible = ~occluded.occluded
    np.testing.assert_array_equal(occluded.observations.points2d_px[visible], clean.observations.points2d_px[visible])
    moved_px = np.linalg.norm(occluded.observations.points2d_px - clean.observations.points2d_px, axis=-1)
    assert np.nanmedian(moved_px[occluded.occluded]) > 20.0  # hallucinations have 45 px in each coordinate


@pytest.mark.parametrize("n_cameras", [2, 3])
def test_fewer_cameras_see_the_same(n_cameras):
    four, fewer = (record(find_variant(name), CLIP, 60) for name in ("occluded", f"occluded_{n_cameras}_cameras"))
    assert fewer.rig.names == fewer.observations.camera_names == four.rig.names[:n_cameras]
    np.testing.assert_array_equal(fewer.observations.points2d_px, four.observations.points2d_px[:, :n_cameras])
    np.testing.assert_array_equal(fewer.occluded, four.occluded[:, :n_cameras])
    assert fewer.true_offsets_s.shape == (n_cameras,)


@pytest.mark.parametrize("n_late", [1, 2, 3])
def test_desynchronised_cameras_deliver_another_frame(n_late):
    recording = record(noise_free(f"desync_{n_late}"), CLIP, 60)
    frames = np.round(recording.true_offsets_s * recording.fps).astype(int)
    assert frames[0] == 0
    assert np.count_nonzero(frames) == n_late
    assert set(frames[frames != 0].tolist()) <= {-2, -1, 1, 2}
    inner = np.arange(2, 58)
    for camera, late in enumerate(frames):
        expected_px = recording.rig.cameras[camera].project(recording.truth_m[inner + late])
        # The spline goes through the frames: only rounding is left.
        np.testing.assert_allclose(recording.observations.points2d_px[inner, camera], expected_px, atol=1e-6)


def test_the_first_desynchronised_cameras_stay_the_same():
    one, two, three = (record(find_variant(f"desync_{n}"), CLIP, 20).true_offsets_s for n in (1, 2, 3))
    assert np.all((one == 0) | (one == two))
    assert np.all((two == 0) | (two == three))


@pytest.mark.parametrize("name", ["subframe", "industrial"])
def test_parts_of_a_frame_can_be_seen_in_the_images(name):
    variant = replace(noise_free(name), occlusion=find_variant("clean").occlusion, lost=False)
    recording = record(variant, "cmu_03_03_b", 300)
    frames = recording.true_offsets_s * recording.fps
    assert frames[0] == 0
    assert np.all((np.abs(frames[1:]) <= 0.5) & (frames[1:] != 0))
    for camera, late in enumerate(frames.tolist()):
        # The motion is curved: a tenth of the largest offset is what a straight line may miss at 15 Hz.
        assert offset_frames(recording, camera) == pytest.approx(late, abs=0.05)


def test_the_truth_is_at_the_times_of_the_first_camera():
    for name in ("desync_3", "subframe", "industrial"):
        variant = replace(noise_free(name), occlusion=find_variant("clean").occlusion, lost=False)
        recording = record(variant, CLIP, 60)
        seen_px = recording.observations.points2d_px[:, 0]
        np.testing.assert_allclose(seen_px, recording.true_rig.cameras[0].project(recording.truth_m), atol=1e-6)


def bumped_camera(recording: BenchmarkRecording) -> int:
    moved = np.array(
        [
            not np.array_equal(true.world_T_camera, old.world_T_camera)
            for true, old in zip(recording.true_rig.cameras, recording.rig.cameras, strict=True)
        ]
    )
    assert moved.sum() == 1
    return int(np.argmax(moved))


@pytest.mark.parametrize("name", ["bumped", "industrial"])
def test_one_camera_was_bumped(name):
    variant = replace(noise_free(name), offsets="none", occlusion=find_variant("clean").occlusion, lost=False)
    recording = record(variant, CLIP, 40)
    index = bumped_camera(recording)
    old, true = recording.rig.cameras[index], recording.true_rig.cameras[index]
    turn = old.world_T_camera[:3, :3].T @ true.world_T_camera[:3, :3]
    assert np.rad2deg(np.arccos((np.trace(turn) - 1) / 2)) == pytest.approx(1.0, abs=1e-6)
    assert np.linalg.norm(true.position_m - old.position_m) == pytest.approx(0.02, abs=1e-12)
    seen_px = recording.observations.points2d_px[:, index]
    np.testing.assert_allclose(seen_px, true.project(recording.truth_m), atol=1e-6)
    # A turn about the axis of view moves the middle of the image little, any other by 20 px.
    assert np.median(np.linalg.norm(old.project(recording.truth_m) - seen_px, axis=-1)) > 2.0
    # The camera has not noticed: its own 3D is right in its own frame.
    assert recording.observations.points3d_m is not None
    own_m = old.to_camera_frame(recording.observations.points3d_m[:, index])
    np.testing.assert_allclose(own_m, true.to_camera_frame(recording.truth_m), atol=1e-9)


@pytest.mark.parametrize(("clip", "n_lost"), [("cmu_02_05", 100), ("cmu_02_03_short", 23)])
def test_one_camera_is_lost_for_two_seconds_or_a_third_of_the_clip(clip, n_lost):
    recording = record(find_variant("lost"), clip, 400)
    away = ~recording.observations.seen.any(axis=2)
    assert away.any(axis=0).sum() == 1
    (frames,) = np.nonzero(away.sum(axis=1))
    np.testing.assert_array_equal(frames, frames[0] + np.arange(n_lost))


def test_industrial_is_everything_at_once():
    recording = record(find_variant("industrial"), CLIP)
    assert recording.fps == 15.0
    np.testing.assert_allclose(np.diff(recording.observations.frame_time_s), 1 / 15.0)
    for camera in recording.rig.cameras:
        toward_m = np.array([0.0, 0.0, 1.0]) - camera.position_m
        assert np.linalg.norm(toward_m) == pytest.approx(4.0)
        down = -camera.world_T_camera[2, 2]
        assert np.rad2deg(np.arcsin(down)) == pytest.approx(40.0)
    # A third of the five seconds.
    lost = np.flatnonzero((~recording.observations.seen.any(axis=2)).sum(axis=0) == len(recording.truth_m) // 3)
    assert lost.size == 1
    assert lost[0] != bumped_camera(recording)
    assert recording.occluded.mean() > 0.05
    assert recording.true_offsets_s.any()


def test_industrial_is_the_same_motion_at_another_rate():
    slow, fast = record(find_variant("industrial"), CLIP, 101), record(find_variant("clean"), CLIP, 101)
    # Every third frame at 15 Hz is every tenth at 50 Hz.
    np.testing.assert_allclose(slow.truth_m[::3], fast.truth_m[::10], atol=1e-9)
    assert len(slow.truth_m) == 31


@pytest.mark.parametrize("name", ["desync_3_occluded", "industrial"])
def test_the_oracle_gets_what_was_seen_at_the_right_time(name):
    recording = record(noise_free(name), CLIP, 60)
    known = recording.oracle_observations
    assert known is not None
    true_px = recording.true_rig.project(recording.truth_m)
    np.testing.assert_allclose(known.points2d_px[known.seen], true_px[known.seen], atol=1e-6)
    assert known.points3d_m is not None
    at_every_camera = np.broadcast_to(recording.truth_m[:, None], known.points3d_m.shape)
    np.testing.assert_allclose(known.points3d_m[known.seen], at_every_camera[known.seen], atol=1e-9)


def test_the_oracle_gets_no_occluded_joint_and_every_other():
    recording = record(find_variant("occluded"), CLIP, 60)
    known = recording.oracle_observations
    assert known is not None
    np.testing.assert_array_equal(known.seen, recording.observations.seen & ~recording.occluded)
    np.testing.assert_array_equal(known.points2d_px[known.seen], recording.observations.points2d_px[known.seen])


def test_the_oracle_knows_the_noise():
    recording = record(find_variant("clean"), CLIP)
    error_px = recording.observations.points2d_px - recording.rig.project(recording.truth_m)
    # Outliers are rare: the middle half of a normal distribution is 0.6745 sigma wide on each side; 54,400 numbers,
    # correlated over 0.15 s, make 3 % a wide margin.
    assert np.median(np.abs(error_px)) / 0.6745 == pytest.approx(recording.sigma_px, rel=0.03)


def test_recordings_come_by_variant_then_clip():
    names = ("clean", "lost")
    made = list(recordings([find_variant(name) for name in names], TUNING_CLIPS[:2], 12))
    assert [(each.variant, each.clip) for each in made] == [(n, c) for n in names for c in TUNING_CLIPS[:2]]
    assert {each.observations.n_frames for each in made} == {12}


def test_names_differ_and_are_described():
    assert len({variant.name for variant in VARIANTS}) == len({v.description for v in VARIANTS}) == len(VARIANTS)
    assert sum(variant.family == "standard" for variant in VARIANTS) == 12


def test_an_unknown_name_is_refused():
    with pytest.raises(ValueError, match="no variant 'dirty'; there is clean, occluded"):
        find_variant("dirty")
    with pytest.raises(ValueError, match="no clip 'cmu_99'; there is cmu_01_04_a"):
        record(find_variant("clean"), "cmu_99")
