from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgpose.calibration.camera_faults import camera_faults
from fgpose.calibration.rig_refinement import refine_rig
from fgpose.io.recordings import load_recording, recordings
from fgpose.observations import Observations
from fgpose_benchmarks.synthetic import Scene
from tests.wrong_rigs import turned


def late(observations: Observations, camera: int, frames: int) -> Observations:
    """The recording with the images of one camera late by so many frames (negative: early)."""
    points2d_px, confidence = observations.points2d_px.copy(), observations.confidence.copy()
    points2d_px[:, camera] = np.roll(points2d_px[:, camera], frames, axis=0)
    confidence[:, camera] = np.roll(confidence[:, camera], frames, axis=0)
    unknown = slice(0, frames) if frames > 0 else slice(frames, None)
    points2d_px[unknown, camera], confidence[unknown, camera] = np.nan, 0.0
    return replace(observations, points2d_px=points2d_px, confidence=confidence, points3d_m=None)


def test_nothing_is_said_against_a_clean_scene(walking_scene: Scene) -> None:
    faults = camera_faults(walking_scene.observations, walking_scene.rig)
    assert [fault.name for fault in faults] == list(walking_scene.rig.names)
    assert not any(fault.late or fault.moved for fault in faults)


@pytest.mark.slow
def test_nothing_is_said_against_an_occluded_scene(mocap_scene: Scene) -> None:
    assert not any(fault.late or fault.moved for fault in camera_faults(mocap_scene.observations, mocap_scene.rig))


@pytest.mark.parametrize(("camera", "frames"), [(0, 2), pytest.param(1, -2, marks=pytest.mark.slow)])
def test_a_late_or_early_camera_is_found(walking_scene: Scene, camera: int, frames: int) -> None:
    """The first one too, by whose clock the others would all be wrong."""
    observations = late(walking_scene.observations, camera, frames)
    faults = camera_faults(observations, walking_scene.rig)
    assert [fault.name for fault in faults if fault.late] == [walking_scene.rig.names[camera]]
    assert not any(fault.moved for fault in faults)
    # Images that come late show what was before: they were taken earlier than they say.
    found = faults[camera]
    assert found.offset_frames == pytest.approx(-frames, abs=3 * 30 * found.offset_sigma_s)
    assert found.offset_s == pytest.approx(found.offset_frames / 30)
    assert 0 < found.offset_sigma_s < 0.02


def test_what_the_calibration_says_of_the_clocks_is_no_fault(walking_scene: Scene) -> None:
    scene = late(walking_scene.observations, 1, 2)
    known = walking_scene.rig.with_time_offsets(np.array([0.0, -2 / 30, 0.0, 0.0]))
    assert not any(fault.late for fault in camera_faults(scene, known))


@pytest.mark.slow
def test_a_turned_camera_is_found_with_how_far(walking_scene: Scene) -> None:
    observations = replace(walking_scene.observations, points3d_m=None, covariance3d_m2=None)
    faults = camera_faults(observations, turned(walking_scene.rig, 2, 1.5))
    assert [fault.name for fault in faults if fault.moved] == ["ring_2"]
    assert not any(fault.late for fault in faults)
    # The prior keeps some of it; a camera that moves aside instead of turning explains the rest.
    assert faults[2].rotation_deg == pytest.approx(1.5, abs=0.6)


@pytest.mark.slow
@pytest.mark.parametrize("name", recordings())
def test_cam_03_of_the_real_recordings_is_off(name: str) -> None:
    """In place rather than in time, as far as a man who hardly moves can tell."""
    rig, observations = load_recording(name)
    faults = camera_faults(observations, rig)
    assert not any(fault.late for fault in faults)
    # It shares the fault with cam_01, opposite to it.
    assert {"cam_03"} <= {fault.name for fault in faults if fault.moved} <= {"cam_01", "cam_03"}


@pytest.mark.slow
def test_a_late_camera_of_a_real_recording_is_found_beside_the_moved_ones() -> None:
    rig, observations = load_recording("balance_openpose")
    faults = camera_faults(late(observations, 3, 3), rig)
    assert [fault.name for fault in faults if fault.late] == ["cam_04"]
    assert faults[3].offset_frames == pytest.approx(-3, abs=0.5)


@pytest.mark.slow
def test_nothing_is_left_once_the_calibration_is_refined() -> None:
    rig, observations = load_recording("balance_openpose")
    refined = refine_rig(observations, rig)
    assert not any(fault.late or fault.moved for fault in camera_faults(refined.observations, refined.rig))


def test_nothing_can_be_said_of_too_little(walking_scene: Scene) -> None:
    rig, observations = walking_scene.rig, walking_scene.observations
    pair = rig.names[:2]
    assert camera_faults(observations.subset(pair), rig.subset(pair)) == ()
    assert camera_faults(observations.frames(slice(0, 1)), rig) == ()
    unseen = replace(observations, points2d_px=np.full_like(observations.points2d_px, np.nan), points3d_m=None)
    assert camera_faults(replace(unseen, confidence=np.zeros_like(unseen.confidence)), rig) == ()


def test_cameras_of_another_rig_are_refused(walking_scene: Scene) -> None:
    with pytest.raises(ValueError, match="camera"):
        camera_faults(walking_scene.observations, walking_scene.rig.subset(walking_scene.rig.names[:3]))
