"""The world of a calibration with boards, level from somebody who walks, against the truth."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose.assessment.rig_alignment import rig_similarity
from fgpose.calibration.board.calibrate import CalibratedFromBoards, calibrate_from_boards
from fgpose.calibration.board.walker import level_from_people, level_from_walker
from fgpose.calibration.board.world import parse_origin
from fgpose.calibration.from_people.calibrated import Grade
from fgpose.geometry.rigid import inverse
from fgpose.monocular.detected import Detected
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, simulate, walking
from fgpose_benchmarks.synthetic.boards import BoardScene, simulate_boards

N_FRAMES, FPS = 300, 25.0


@pytest.fixture(scope="module")
def scene() -> BoardScene:
    return simulate_boards(4, 5, noise_px=0.2, n_common=12, n_near=6)


@pytest.fixture(scope="module")
def result(scene: BoardScene) -> CalibratedFromBoards:
    return calibrate_from_boards(scene.sightings, origin=parse_origin("people"))


def walker_in(scene: BoardScene, result: CalibratedFromBoards, turned: np.ndarray) -> fgpose.Trajectory:
    """Somebody whom the cameras of the scene see walk, estimated with the rig that was found."""
    motion_m = walking(N_FRAMES, FPS) @ turned.T
    skeleton, noise = fgpose.load_skeleton("h36m_17"), DetectionNoise()
    seen = simulate(motion_m, skeleton, scene.rig, FPS, noise=noise, occlusion=NO_OCCLUSION, seed=0)
    return fgpose.smooth(replace(seen.observations, points3d_m=None, covariance3d_m2=None), result.rig)


@pytest.fixture(scope="module")
def walker(scene: BoardScene, result: CalibratedFromBoards) -> fgpose.Trajectory:
    return walker_in(scene, result, np.eye(3))


def test_vertical_and_floor_are_those_of_the_walk(
    scene: BoardScene, result: CalibratedFromBoards, walker: fgpose.Trajectory
) -> None:
    level = level_from_walker(result, walker)
    truth = rig_similarity(level.rig, scene.rig, with_scale=False)
    stated_deg, stated_mm = map(float, re.findall(r"± ([\d.]+) (?:deg|mm)", level.world))
    # Two standard deviations, as of two axes together: 0.95.
    assert np.rad2deg(np.hypot(*truth.R[:2, 2])) < 2 * stated_deg
    assert abs(truth.of(np.zeros(3))[2]) < 2 * stated_mm / 1000
    assert stated_deg < 3.0
    assert stated_mm < 40.0
    first = level.rig.cameras[0]
    np.testing.assert_allclose(first.position_m[:2], 0.0, atol=1e-9)
    assert first.world_T_camera[0, 2] > 0.0
    assert first.world_T_camera[1, 2] == pytest.approx(0.0, abs=1e-9)
    assert level.grade is result.grade


def test_cameras_and_board_move_together(result: CalibratedFromBoards, walker: fgpose.Trajectory) -> None:
    level = level_from_walker(result, walker)
    for before, after in zip(result.rig.cameras, level.rig.cameras, strict=True):
        np.testing.assert_allclose(
            inverse(after.world_T_camera) @ level.world_T_board,
            inverse(before.world_T_camera) @ result.world_T_board,
            atol=1e-9,
        )


def test_somebody_who_lies_is_named(scene: BoardScene, result: CalibratedFromBoards) -> None:
    lying = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    level = level_from_walker(result, walker_in(scene, result, lying))
    assert level.grade is Grade.COARSE
    assert any("the person lies, or the cameras do" in finding.reason for finding in level.findings)


def test_a_vertical_that_is_not_known_is_named(result: CalibratedFromBoards) -> None:
    # Somebody who stands on one leg for two seconds, the trunk tilted sideways: this tells little.
    rig, observations = fgpose.files.load_recording("balance_openpose")
    of_rig = replace(result, rig=rig, findings=())
    level = level_from_walker(of_rig, fgpose.smooth(observations, rig))
    assert [finding.grade for finding in level.findings] == [Grade.COARSE]
    (stated_deg,) = map(float, re.findall(r"± ([\d.]+) degrees only", level.findings[0].reason))
    truth = rig_similarity(level.rig, rig, with_scale=False)
    off_deg = np.rad2deg(np.arccos(truth.R[2, 2]))
    assert 5.0 < off_deg < 2 * stated_deg


def test_legs_that_were_never_seen_are_an_error(result: CalibratedFromBoards, walker: fgpose.Trajectory) -> None:
    unseen = walker.status.copy()
    unseen[:, walker.skeleton.index("left_knee")] = fgpose.Status.PREDICTED
    with pytest.raises(ValueError, match="need the legs and shoulders"):
        level_from_walker(result, replace(walker, status=unseen))


class Empty(Detected):
    """Images in which a network found nobody."""

    def __init__(self) -> None: ...

    def recalibrated(self, rig: fgpose.CameraRig) -> Detected:
        raise ValueError("nobody was seen in any image")


def test_where_nobody_is_seen_the_cameras_alone_tell(result: CalibratedFromBoards) -> None:
    same = level_from_people(result, Empty())
    assert same.rig is result.rig
    assert same.grade is Grade.COARSE
    assert "level by the cameras alone: nobody was seen" in same.findings[-1].reason
