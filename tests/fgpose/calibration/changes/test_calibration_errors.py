"""What calibrations of untouched cameras err by is no move, however many cameras there are; a bump is."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from fgpose.calibration.changes.change import Change
from fgpose.calibration.changes.find_changes import find_changes
from fgpose.calibration.changes.poses.move_errors import MoveErrors
from fgpose.config import CalibrationConfig
from fgpose.geometry.camera import CameraRig
from fgpose_benchmarks.synthetic import ring_rig
from tests.fgpose.calibration.changes.changing import RIG, filmed, walk_m

DECLARED = CalibrationConfig()
EIGHT = ring_rig(8, 5.0, 2.5, (0.0, 0.0, 0.9), focal_px=900.0, size_px=(1600, 1200))


def calibrated(rig: CameraRig, seed: int) -> CameraRig:
    """With errors as large as the configuration says."""
    rng, cameras = np.random.default_rng(seed), []
    for camera in rig.cameras:
        turn, shift_m = rng.normal(0, np.deg2rad(DECLARED.rotation_sigma_deg), 3), rng.normal(size=3)
        cameras.append(moved(camera, turn, DECLARED.translation_sigma_m * shift_m))
    return CameraRig(tuple(cameras))


def moved(camera, turn: np.ndarray, shift_m: np.ndarray):
    pose = camera.world_T_camera.copy()
    pose[:3, :3] = pose[:3, :3] @ gtsam.Rot3.Expmap(turn).matrix()
    pose[:3, 3] += shift_m
    return replace(camera, world_T_camera=pose)


def of_poses(seed: int, filming: CameraRig, rig: CameraRig) -> list[Change]:
    found = find_changes([filmed(walk_m(seed, 12.0), filming, seed + 5)], rig).changes
    return [each for each in found if not each.is_of_clock]


@pytest.mark.parametrize("seed", [0, 1])
def test_a_camera_that_is_off_by_what_calibrations_err_by_was_not_moved(seed: int) -> None:
    assert of_poses(seed, RIG, calibrated(RIG, seed)) == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_none_of_many_cameras_was_moved(seed: int) -> None:
    assert of_poses(seed, EIGHT, calibrated(EIGHT, seed)) == []


@pytest.mark.parametrize("rig", [RIG, pytest.param(EIGHT, marks=pytest.mark.slow)])
def test_a_bump_of_a_degree_is_found_beside_errors_of_the_calibration(rig: CameraRig) -> None:
    """Ten standard deviations of the calibration, so that hardly a standard deviation of the fit is left in doubt: the
    turn is found to three of these."""
    turn = np.deg2rad([0.0, 1.0, 0.0])
    cameras = list(rig.cameras)
    cameras[1] = moved(cameras[1], turn, np.array([0.02, 0.0, 0.0]))
    (found,) = of_poses(1, CameraRig(tuple(cameras)), calibrated(rig, 1))
    assert found.camera == 1
    allowed = 3 * (found.sigma + np.sqrt(3) * np.deg2rad(DECLARED.rotation_sigma_deg))
    assert np.linalg.norm(found.rotation - turn) < allowed


def test_untouched_cameras_seem_moved_as_seldom_as_is_said() -> None:
    """Of 4000 moves by errors alone 200 are of the least probable twentieth, 14 standard deviation by chance; what is
    about chi squared may differ by another fifth."""
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6)) * np.repeat([0.002, 0.01], 3)[:, None]
    calibration = np.diag(np.repeat([np.deg2rad(DECLARED.rotation_sigma_deg), DECLARED.translation_sigma_m], 3) ** 2)
    errors = MoveErrors(root @ root.T, calibration)
    moves = rng.multivariate_normal(np.zeros(6), errors.of_fit + errors.of_calibration, 4000)
    seldom = sum(errors.untouched(move) < 0.05 for move in moves)
    assert seldom == pytest.approx(200, abs=3 * 14 + 40)
