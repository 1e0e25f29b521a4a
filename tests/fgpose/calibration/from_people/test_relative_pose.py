"""Two cameras from joints over time."""

from __future__ import annotations

import numpy as np
import pytest

from fgpose.assessment.rigs import angle_deg
from fgpose.calibration.from_people.rig.relative_pose import relative_poses
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.epipolar_distance import essential_matrix, sampson_errors
from fgpose_benchmarks.synthetic import ring_rig, walking

RIG = ring_rig(4)
TOLERANCE = 5 / 1145  # of a focal length


def at_unit(rig: CameraRig, frames: int = 120) -> np.ndarray:
    """(camera, frame, joint, 2), at unit focal length."""
    points_px = rig.project(walking(frames, 30.0))
    return np.moveaxis((points_px - 500.0) / 1145.0, 1, 0)


def true_pose(a: int, b: int) -> np.ndarray:
    pose = np.linalg.inv(RIG.cameras[a].world_T_camera) @ RIG.cameras[b].world_T_camera
    pose[:3, 3] /= np.linalg.norm(pose[:3, 3])
    return pose


def test_the_epipolar_errors_of_the_true_pose_are_zero_and_grow_with_an_offset() -> None:
    first, second = (points.reshape(-1, 2) for points in at_unit(RIG)[:2])
    E = essential_matrix(true_pose(0, 1))

    np.testing.assert_allclose(sampson_errors(E, second, first), 0.0, atol=1e-12)
    offset = np.abs(sampson_errors(E, second + 0.01, first))
    # The nearest correspondence that fits is at most as far as the offset.
    assert 0.001 < offset.max() <= 0.01 * np.sqrt(2) * 1.01


@pytest.mark.parametrize("second", [1, 2])
def test_noisy_joints_with_gross_errors_give_the_pose(second: int) -> None:
    rng = np.random.default_rng(1)
    points = at_unit(RIG)
    points = points + rng.normal(0, TOLERANCE, points.shape)
    wrong = rng.random(points.shape[:-1]) < 0.1
    points[wrong] += rng.normal(0, 0.1, (int(wrong.sum()), 2))

    best = relative_poses(points[0], points[second], TOLERANCE, None, rng)[0]

    truth = true_pose(0, second)
    # 2,000 joints of 4.4 mrad that vary over the image: 0.1 degrees by their number; the walk is within 2 m.
    assert angle_deg(best.first_T_second[:3, :3], truth[:3, :3]) < 1.0
    assert best.first_T_second[:3, 3] @ truth[:3, 3] > np.cos(np.deg2rad(2.0))
    assert np.isnan(best.cross_check_deg)
    assert best.in_front > 0.85


def test_the_referee_is_a_proposal_and_a_measure() -> None:
    points, rng = at_unit(RIG), np.random.default_rng(0)

    found = relative_poses(points[0], points[1], TOLERANCE, true_pose(0, 1), rng)

    assert found[0].cross_check_deg < 0.1
    assert found[0].cost < 1e-6


def test_too_few_common_joints_give_nothing() -> None:
    points, rng = at_unit(RIG, 10), np.random.default_rng(0)
    points[0, 1:] = np.nan

    assert relative_poses(points[0], points[1], TOLERANCE, None, rng) == []
