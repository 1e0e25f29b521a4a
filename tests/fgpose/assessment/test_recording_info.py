from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgpose.assessment.recording_info import recording_info
from fgpose.io.recordings import load_recording, recordings
from fgpose.observations import Observations
from fgpose_benchmarks.synthetic import Scene
from tests.wrong_rigs import in_another_world, turned


def exchanged(observations: Observations, camera: int, frames: slice) -> Observations:
    """The recording with left and right exchanged in some frames of one camera."""
    other = np.arange(observations.skeleton.n_joints)
    for left, right in observations.skeleton.left_right:
        other[[left, right]] = right, left
    points2d_px, confidence = observations.points2d_px.copy(), observations.confidence.copy()
    points2d_px[frames, camera] = points2d_px[frames, camera][:, other]
    confidence[frames, camera] = confidence[frames, camera][:, other]
    return replace(observations, points2d_px=points2d_px, confidence=confidence, points3d_m=None)


def hidden(observations: Observations, frames: slice, camera: int | slice, joint: int | slice) -> Observations:
    points2d_px = observations.points2d_px.copy()
    points2d_px[frames, camera, joint] = np.nan
    return replace(observations, points2d_px=points2d_px, confidence=observations.confidence.copy())


def test_nothing_is_suspected_of_a_clean_scene(walking_scene: Scene) -> None:
    info = recording_info(walking_scene.observations, walking_scene.rig)
    assert not info.suspicious
    assert info.gaps == ()
    assert info.fps == pytest.approx(30.0)
    assert sum(info.joint_frames_by_views) == 60 * 17


def test_nothing_is_suspected_of_an_occluded_scene(mocap_scene: Scene) -> None:
    assert recording_info(mocap_scene.observations, mocap_scene.rig).suspected_calibration is None


@pytest.mark.parametrize("name", recordings())
def test_untouched_recordings_have_only_their_known_fault(name: str) -> None:
    rig, observations = load_recording(name)
    info = recording_info(observations, rig)
    assert not info.suspicious
    # The README beside the data: something is wrong with cam_03.
    assert info.cameras[2].residual_px == max(camera.residual_px for camera in info.cameras)


@pytest.mark.parametrize("name", recordings())
@pytest.mark.parametrize("camera", range(4))
def test_turned_camera_is_found(name: str, camera: int) -> None:
    rig, observations = load_recording(name)
    info = recording_info(observations, turned(rig, camera, 5.0))
    assert info.suspected_calibration == rig.names[camera]
    assert info.suspicious


def test_exchanged_sides_are_found() -> None:
    rig, observations = load_recording("balance_openpose")
    info = recording_info(exchanged(observations, 1, slice(30, 40)), rig)
    assert info.suspected_swaps == ("cam_02",)
    # 10 of 100 frames, less the pairs whose exchange does not show.
    assert 0.05 < info.cameras[1].share_swapped < 0.12


def test_gap_is_listed_with_its_time(walking_scene: Scene) -> None:
    observations = hidden(walking_scene.observations, slice(20, 41), slice(1, None), 3)
    (gap,) = recording_info(observations, walking_scene.rig).gaps
    assert gap.joint == observations.skeleton.joints[3]
    assert gap.start_s == pytest.approx(19 / 30)
    assert gap.duration_s == pytest.approx(22 / 30)


def test_joint_never_seen_twice_is_named(walking_scene: Scene) -> None:
    observations = hidden(walking_scene.observations, slice(None), slice(1, None), 3)
    info = recording_info(observations, walking_scene.rig)
    assert info.never_seen == (observations.skeleton.joints[3],)
    assert info.gaps == ()


@pytest.mark.parametrize("n_cameras", [1, 2])
def test_few_cameras_are_reported_without_suspicion(walking_scene: Scene, n_cameras: int) -> None:
    names = walking_scene.rig.names[:n_cameras]
    info = recording_info(walking_scene.observations.subset(names), walking_scene.rig.subset(names))
    assert len(info.cameras) == n_cameras
    assert np.isnan(info.cameras[0].left_out_px)
    assert not info.suspicious


def test_single_frame_is_reported(walking_scene: Scene) -> None:
    info = recording_info(walking_scene.observations.frames(slice(0, 1)), walking_scene.rig)
    assert info.n_frames == 1
    assert np.isnan(info.fps)


@pytest.mark.slow
def test_long_recording_is_sampled(walking_scene: Scene) -> None:
    observations = walking_scene.observations
    times = 50
    many = replace(
        observations,
        time_s=np.arange(60 * times) / 30.0,
        points2d_px=np.tile(observations.points2d_px, (times, 1, 1, 1)),
        confidence=np.tile(observations.confidence, (times, 1, 1)),
        points3d_m=None,
    )
    info = recording_info(exchanged(many, 1, slice(1000, 1150)), walking_scene.rig)
    assert info.suspected_swaps == ("ring_1",)
    assert info.cameras[1].residual_px == pytest.approx(
        recording_info(observations, walking_scene.rig).cameras[1].residual_px, rel=0.05
    )


def test_wrong_unit_is_implausible(walking_scene: Scene) -> None:
    info = recording_info(
        replace(walking_scene.observations, points3d_m=None), in_another_world(walking_scene.rig, 1000.0)
    )
    assert any("person" in remark for remark in info.implausible)
    assert info.suspicious
