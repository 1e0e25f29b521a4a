from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from adjusted_rigs import FPS, Adjusted, adjusted, angle_deg, walker

from fgpose.assessment.rig_alignment import Similarity
from fgpose.calibration.from_people.calibrated import Grade
from fgpose.calibration.from_people.walk import Walk
from fgpose.calibration.from_people.world.anatomy import Anatomy
from fgpose.calibration.from_people.world.metric import Metric, to_metric
from fgpose.calibration.from_people.world.scale import MeasuredDistance
from fgpose.calibration.from_people.world.steps import Steps
from fgpose.calibration.from_people.world.vertical import find_vertical
from fgpose.geometry.camera import CameraRig


def tilt_deg(found: Metric, case: Adjusted) -> float:
    """Between the true vertical and the one that was found."""
    return angle_deg(case.true_T(found.world_T_gauge).R[:, 2], np.array([0.0, 0.0, 1.0]))


def floor_error_m(found: Metric, case: Adjusted) -> float:
    """Height of the true floor in the world that was found, below the middle of the room."""
    return float(case.true_T(found.world_T_gauge).of(np.zeros(3))[2])


def distance_m(case: Adjusted) -> float:
    return float(np.linalg.norm(case.true_rig.cameras[0].position_m - case.true_rig.cameras[2].position_m))


def test_the_world_of_a_walker() -> None:
    # Detections with a bias of 30 mm that depends on the view, cameras that are 20 mm off.
    for seed in (1, 2, 3):
        case = adjusted(seed=seed)
        found = to_metric(case.walk, case.rig, case.joints_m, distances=[measured(case)])
        assert case.true_T(found.world_T_gauge).scale == pytest.approx(1.0, abs=0.01)  # twice 20 mm of 6.4 m, and 0.5 %
        assert tilt_deg(found, case) < min(1.4, 2.5 * found.vertical.sigma_deg)  # twice the target
        assert abs(floor_error_m(found, case)) < min(0.04, 2.5 * found.floor_sigma_m)


def measured(case: Adjusted) -> MeasuredDistance:
    return MeasuredDistance("ring_0", "ring_2", distance_m(case))


def test_z_is_up_the_floor_is_zero_and_x_is_where_the_first_camera_looks() -> None:
    case = adjusted(10.0, 4)
    found = to_metric(case.walk, case.rig, case.joints_m, stature_m=1.7)
    first = found.rig.cameras[0]
    assert first.position_m[:2] == pytest.approx([0, 0], abs=1e-9)
    assert first.position_m[2] == pytest.approx(1.7, abs=0.15)
    assert first.world_T_camera[1, 2] == pytest.approx(0, abs=1e-9)
    assert first.world_T_camera[0, 2] > 0.9
    # The images of the joints stay what they were.
    assert found.rig.project(found.joints_m) == pytest.approx(case.rig.project(case.joints_m), abs=1e-6, nan_ok=True)


def test_the_gauge_does_not_matter() -> None:
    case = adjusted(10.0, 5)
    turned = Similarity(
        7.0, np.array(gtsam.Rot3.Expmap(np.array([2.0, 0.3, -1.0])).matrix()), np.array([5.0, 1.0, 2.0])
    )
    one = to_metric(case.walk, case.rig, case.joints_m, stature_m=1.7)
    other = to_metric(case.walk, turned.rig(case.rig), turned.of(case.joints_m), stature_m=1.7)
    # But for medians of each coordinate, by which the joints move by 2 mm.
    assert other.joints_m == pytest.approx(one.joints_m, abs=5e-3, nan_ok=True)
    assert other.vertical.sigma_deg == pytest.approx(one.vertical.sigma_deg, rel=0.02)
    assert other.floor_sigma_m == pytest.approx(one.floor_sigma_m, rel=0.02)


def test_a_camera_that_looks_straight_down_has_x_where_its_image_is_up() -> None:
    case = adjusted(10.0, 6)
    found = to_metric(case.walk, case.rig, case.joints_m, stature_m=1.7)
    down = np.eye(4)
    down[:3, :3], down[:3, 3] = np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, 3.0]
    cameras = (replace(found.rig.cameras[0], world_T_camera=down), *found.rig.cameras[1:])
    again = to_metric(case.walk, CameraRig(cameras), found.joints_m, stature_m=1.7)
    # Up in the image of this camera is y of the old world.
    assert again.world_T_gauge.R @ np.array([0.0, 1.0, 0.0]) == pytest.approx([1, 0, 0], abs=0.1)


def test_a_stature_makes_metres() -> None:
    case = adjusted(seed=7)
    stature_m = stature_of(case.truth_m)
    found = to_metric(case.walk, case.rig, case.joints_m, stature_m=stature_m)
    # 2 % between bodies, and by 1 % more because the highest head is taken for the stature.
    assert case.true_T(found.world_T_gauge).scale == pytest.approx(1.0, abs=0.03)
    assert found.scale.source == f"stature {stature_m:.2f} m"
    assert 0.01 < found.scale.sigma < 0.03


def stature_of(truth_m: np.ndarray) -> float:
    """By the highest that the head ever is: that of somebody who walks with his head up is a centimetre lower."""
    _, skeleton = walker(5.0, 0)
    return float(np.max(truth_m[:, skeleton.index("head"), 2]))


def test_a_stature_that_is_wrong_contradicts_a_distance() -> None:
    case = adjusted(10.0, 8)
    wrong_m = 0.9 * stature_of(case.truth_m)
    found = to_metric(case.walk, case.rig, case.joints_m, stature_m=wrong_m, distances=[measured(case)])
    assert "stature" in found.scale.findings[0].reason


def test_the_network_tells_a_stature_that_is_far_off() -> None:
    case = adjusted(10.0, 8)
    points3d_m = np.stack([camera.to_camera_frame(case.truth_m) for camera in case.true_rig.cameras], axis=1)
    walk = replace(case.walk, points3d_m=points3d_m)
    assert to_metric(walk, case.rig, case.joints_m).scale.source == "metric 3D of the network"
    found = to_metric(walk, case.rig, case.joints_m, stature_m=0.7 * stature_of(case.truth_m))
    assert found.scale.findings


def test_nothing_is_known_without_legs() -> None:
    case = adjusted(10.0, 9)
    joints_m = case.joints_m.copy()
    joints_m[:, case.walk.skeleton.index("left_ankle")] = np.nan
    with pytest.raises(ValueError, match="legs"):
        to_metric(case.walk, case.rig, joints_m, stature_m=1.7)


def upright_on(ground_m: np.ndarray, heading: np.ndarray, lean_deg: float) -> tuple[np.ndarray, Anatomy]:
    """Somebody who leans forwards and glides, on a way."""
    truth_m, skeleton = walker(5.0, 0)
    body_m = truth_m[0] - [*truth_m[0, 0, :2], 0.0]
    across_m = body_m[skeleton.index("left_hip")] - body_m[skeleton.index("right_hip")]
    body_m = body_m @ about_z(-(np.arctan2(across_m[1], across_m[0]) - np.pi / 2)).T
    # Feet together below the head, then lean.
    anatomy = Anatomy(skeleton)
    off = anatomy.top_m(body_m[None])[0] - anatomy.bottom_m(body_m[None])[0]
    body_m[:, :2] -= body_m[:, 2:] * off[:2] / off[2]
    body_m[:, 0] += np.tan(np.deg2rad(lean_deg)) * body_m[:, 2]
    joints_m = np.einsum("tij,pj->tpi", np.stack([about_z(angle) for angle in heading]), body_m)
    joints_m[..., :2] += ground_m[:, None]
    return joints_m, anatomy


def about_z(angle: float) -> np.ndarray:
    return np.array(gtsam.Rot3.Rz(angle).matrix())


def up_of(joints_m: np.ndarray, anatomy: Anatomy) -> tuple[np.ndarray, float]:
    time_s = np.arange(len(joints_m)) / FPS
    found = find_vertical(joints_m, time_s, anatomy, Steps.of(joints_m, time_s, anatomy))
    return found.up, found.sigma_deg


def test_a_lean_cancels_where_the_walk_turns() -> None:
    heading = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    around_m = 1.5 * np.stack([np.sin(heading), -np.cos(heading)], axis=-1)
    up, sigma_deg = up_of(*upright_on(around_m, heading, 5.0))
    assert angle_deg(up, np.array([0.0, 0.0, 1.0])) < 0.1  # exact but for the shortening of the axis
    assert sigma_deg < 0.7


def test_on_the_spot_a_lean_is_a_tilt_and_the_sigma_says_so() -> None:
    up, sigma_deg = up_of(*upright_on(np.zeros((200, 2)), np.zeros(200), 3.0))
    off_deg = angle_deg(up, np.array([0.0, 0.0, 1.0]))
    assert 2.0 < off_deg < 3.1
    assert sigma_deg > off_deg


def test_the_floor_tells_a_lean_from_a_tilt() -> None:
    case = adjusted(seed=3, bias_m=0.0, error_m=0.0, noise_px=0.0)
    # To and fro on one line.
    line_m = case.truth_m.copy()
    line_m[..., 1] -= case.truth_m[:, :1, 1]
    up, sigma_deg = up_of(line_m, Anatomy(case.walk.skeleton))
    assert angle_deg(up, np.array([0.0, 0.0, 1.0])) < 2 * sigma_deg


def test_almost_half_of_the_frames_may_lie() -> None:
    truth_m, skeleton = walker(30.0, 2)
    lying = truth_m.copy()
    lies = np.arange(len(lying)) % 20 < 9
    lying[lies] = lying[lies] @ np.array(gtsam.Rot3.Rx(np.pi / 2).matrix()).T
    anatomy, time_s = Anatomy(skeleton), np.arange(len(lying)) / FPS
    found = find_vertical(lying, time_s, anatomy, Steps.of(truth_m, time_s, anatomy))
    assert angle_deg(found.up, np.array([0.0, 0.0, 1.0])) < 0.7
    assert 0.5 < found.upright < 0.6


def test_steps_are_where_feet_stand() -> None:
    truth_m, skeleton = walker(30.0, 1)
    time_s = np.arange(len(truth_m)) / FPS
    steps = Steps.of(truth_m, time_s, Anatomy(skeleton))
    # Two steps a second at most, one at least while walking, which is most of the time.
    assert 15 < len(steps) < 90
    assert np.median(np.abs(steps.foot_m[:, 2] - 0.09)) < 0.03  # ankles, some with the heel up
    assert np.median(truth_m[:, skeleton.index("left_ankle"), 2]) > np.median(steps.foot_m[:, 2])


def test_the_vertical_needs_a_body() -> None:
    truth_m, skeleton = walker(5.0, 0)
    anatomy, time_s = Anatomy(skeleton), np.arange(len(truth_m)) / FPS
    joints_m = truth_m.copy()
    joints_m[:, skeleton.index("head")] = np.nan
    with pytest.raises(ValueError, match="no vertical"):
        find_vertical(joints_m, time_s, anatomy, Steps.of(truth_m, time_s, anatomy))


def test_one_frame_has_a_vertical_and_a_floor() -> None:
    truth_m, skeleton = walker(5.0, 0)
    walk = Walk(skeleton, adjusted(10.0, 1).true_rig.names, np.zeros(1), np.zeros((1, 4, 17, 2)), np.ones((1, 4, 17)))
    found = to_metric(walk, adjusted(10.0, 1).true_rig, truth_m[:1])
    assert found.scale.source == "an adult's mean stature"
    # Nothing was measured: of a child it would be 60 % off.
    (finding,) = found.scale.findings
    assert finding.grade is Grade.COARSE
    assert "the scale is assumed (an adult's mean stature)" in finding.reason
    assert np.isfinite(found.joints_m).all()


def test_a_body_whose_size_is_not_known_tells_less_of_the_scale_and_the_floor() -> None:
    """Where all cameras look from one side, it may be larger and farther away; a measured distance does not care."""
    case = adjusted(seed=1)
    sure, unsure = (
        to_metric(case.walk, case.rig, case.joints_m, stature_m=1.7, body_sigma=sigma) for sigma in (0.0, 0.1)
    )
    assert unsure.scale.sigma == pytest.approx(np.hypot(sure.scale.sigma, 0.1))
    height_m = np.median(sure.rig.positions_m[:, 2])
    assert unsure.floor_sigma_m == pytest.approx(np.hypot(sure.floor_sigma_m, 0.1 * height_m))
    (finding,) = unsure.scale.findings
    assert "known to 10% only" in finding.reason
    assert not sure.scale.findings
    known = to_metric(case.walk, case.rig, case.joints_m, distances=[measured(case)], body_sigma=0.1)
    assert known.scale.sigma < 0.05
    assert not known.scale.findings
