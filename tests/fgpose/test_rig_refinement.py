"""Refining the cameras on the recording itself."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

import fgpose
from fgpose.synthetic import Scene


def turned(rig: fgpose.CameraRig, camera: int, degrees: float) -> fgpose.CameraRig:
    """The rig with one camera turned about its vertical axis."""
    turn = np.eye(4)
    turn[:3, :3] = cv2.Rodrigues(np.deg2rad([0.0, degrees, 0.0]))[0]
    cameras = list(rig.cameras)
    cameras[camera] = replace(cameras[camera], world_T_camera=cameras[camera].world_T_camera @ turn)
    return fgpose.CameraRig(tuple(cameras))


def direction_error_deg(rig: fgpose.CameraRig, truth: fgpose.CameraRig, camera: int) -> float:
    relative = rig.cameras[camera].world_T_camera[:3, :3].T @ truth.cameras[camera].world_T_camera[:3, :3]
    return float(np.rad2deg(np.arccos((np.trace(relative) - 1) / 2)))


def test_a_turned_camera_is_turned_back(walking_scene: Scene, rig: fgpose.CameraRig) -> None:
    wrong = turned(rig, 2, 1.0)
    result = fgpose.refine_rig(walking_scene.observations, wrong)
    # A degree is three sigmas of the prior, so about half of it is believed, and the camera stands out.
    assert direction_error_deg(result.rig, rig, 2) < 0.6
    assert np.argmax(result.rotation_deg) == 2
    assert result.residual_after_px[2] < 0.6 * result.residual_before_px[2]


def test_a_right_rig_stays(walking_scene: Scene, rig: fgpose.CameraRig) -> None:
    result = fgpose.refine_rig(walking_scene.observations, rig)
    # 5 px of detection error, 20 looks: 1 px or 0.06 degrees of each camera's direction.
    assert result.rotation_deg.max() < 0.2
    assert result.translation_m.max() < 0.03


def test_frames_in_which_nobody_is_there_do_not_count(walking_scene: Scene, rig: fgpose.CameraRig) -> None:
    seen = walking_scene.observations
    points2d_px = np.full((3000, *seen.points2d_px.shape[1:]), np.nan)
    points2d_px[10:15] = seen.points2d_px[:5]  # between two of 50 frames spread evenly
    result = fgpose.refine_rig(fgpose.Observations(seen.skeleton, np.arange(3000) / 30, points2d_px), rig)
    assert np.isfinite(result.residual_after_px).all()


def test_nothing_to_learn_from(skeleton: fgpose.Skeleton, rig: fgpose.CameraRig) -> None:
    observations = fgpose.Observations(skeleton, np.arange(3) / 50, np.full((3, 4, 17, 2), np.nan))
    with pytest.raises(ValueError, match="no joint is seen by two cameras"):
        fgpose.refine_rig(observations, rig)
