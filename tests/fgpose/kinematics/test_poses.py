from __future__ import annotations

import numpy as np
import pytest
from built_body import built, random_angles, trajectory

from fgpose.io.skeletons import load_skeleton
from fgpose.kinematics.motion import centre_m, heights_m, speeds_m_s
from fgpose.kinematics.opensim import opensim_coordinates
from fgpose.kinematics.poses import segment_poses
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Trajectory
from fgpose_benchmarks.synthetic import walking


def test_segments_are_rotations_that_point_along_their_bones() -> None:
    rng = np.random.default_rng(2)
    poses = segment_poses(trajectory(np.stack([built(random_angles(rng)) for _ in range(20)])))
    R = poses.world_R_segment
    np.testing.assert_allclose(R @ R.swapaxes(-1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-9)
    for index, segment in enumerate(poses.segments):
        if segment.name != "pelvis":
            along = poses.end_m[:, index] - poses.origin_m[:, index]
            along /= np.linalg.norm(along, axis=1, keepdims=True)
            np.testing.assert_allclose(R[:, index] @ np.array(segment.axis), along, atol=1e-9)
    assert poses.determined.all()  # all limbs are bent


def test_the_knee_turns_about_the_z_axis_of_the_thigh() -> None:
    rng = np.random.default_rng(5)
    wanted = [random_angles(rng) for _ in range(10)]
    poses = segment_poses(trajectory(np.stack([built(angles) for angles in wanted])))
    names = [segment.name for segment in poses.segments]
    for side in ("left", "right"):
        thigh, shank = (poses.world_R_segment[:, names.index(f"{side}_{name}")] for name in ("thigh", "shank"))
        knee = thigh.swapaxes(-1, -2) @ shank
        np.testing.assert_allclose(knee[:, 2], np.broadcast_to([0.0, 0.0, 1.0], (10, 3)), atol=1e-9)
        flexion_deg = np.rad2deg(np.arctan2(-knee[:, 1, 0], knee[:, 0, 0]))
        np.testing.assert_allclose(flexion_deg, [angles[f"{side}_knee_flexion"] for angles in wanted], atol=1e-6)


def test_the_rotation_of_a_straight_limb_is_interpolated_and_marked() -> None:
    def leg(knee_deg: float, rotation_deg: float) -> np.ndarray:
        angles = {"left_knee_flexion": knee_deg, "left_hip_flexion": 40.0, "left_hip_rotation": rotation_deg}
        return built(angles | {"left_elbow_flexion": 90.0, "right_elbow_flexion": 90.0})

    poses = segment_poses(trajectory(np.stack([leg(60.0, 10.0), leg(0.0, 0.0), leg(60.0, 20.0)])))
    names = [segment.name for segment in poses.segments]
    for name in ("left_thigh", "left_shank"):
        np.testing.assert_array_equal(poses.determined[:, names.index(name)], [True, False, True])
    thigh = poses.world_R_segment[:, names.index("left_thigh")]
    # Half way from the first rotation to the last one.
    half = thigh[0].T @ thigh[1]
    whole = thigh[0].T @ thigh[2]
    np.testing.assert_allclose(half @ half, whole, atol=1e-9)


def test_a_skeleton_without_a_trunk_has_no_segments() -> None:
    leg = Skeleton("leg", ("left_hip", "left_knee", "left_ankle"), bones=((0, 1), (1, 2)), root=(0,))
    with pytest.raises(ValueError, match="skeleton leg lacks right_hip, left_shoulder, right_shoulder"):
        segment_poses(Trajectory(leg, np.zeros(1), np.zeros((1, 3, 3)), np.zeros((1, 3))))


def test_a_foot_without_its_shank_is_left_out() -> None:
    """As of a file whose labels were damaged: what hangs on a segment that is not there has no pose."""
    joints = ("left_hip", "right_hip", "left_shoulder", "right_shoulder", "left_ankle", "left_big_toe")
    scattered = Skeleton("scattered", joints, bones=(), root=(0, 1))
    positions_m = np.random.default_rng(0).normal(size=(2, len(joints), 3))
    poses = segment_poses(Trajectory(scattered, np.arange(2.0), positions_m, np.ones((2, len(joints)))))
    assert [segment.name for segment in poses.segments] == ["pelvis", "thorax"]


def test_opensim_coordinates_of_a_known_posture() -> None:
    wanted = {
        "right_hip_flexion": 30.0,
        "left_hip_adduction": -12.0,
        "right_knee_flexion": 50.0,
        "left_ankle_dorsiflexion": 8.0,
        "left_elbow_flexion": 70.0,
        "spine_rotation": 15.0,
        # A person who faces the world's y faces x of OpenSim's ground, which is that of TRC files.
        "trunk_heading": 90.0,
    }
    found = opensim_coordinates(trajectory(built(wanted)[None]))
    expected = {
        "hip_flexion_r": 30.0,
        "hip_flexion_l": 0.0,
        "hip_adduction_l": -12.0,
        "knee_angle_r": 50.0,
        "ankle_angle_l": 8.0,
        "elbow_flex_l": 70.0,
        "arm_flex_r": 0.0,
        "lumbar_extension": 0.0,
        "lumbar_rotation": 15.0,
        "pelvis_tilt": 0.0,
        "pelvis_list": 0.0,
        "pelvis_rotation": -15.0,  # the trunk faces forward
    }
    assert {name: float(found[name][0]) for name in expected} == pytest.approx(expected, abs=1e-6)


def test_a_trunk_that_leans_forward_tilts_the_pelvis_as_opensim_counts() -> None:
    found = opensim_coordinates(trajectory(built({"trunk_heading": 90.0, "trunk_flexion": 20.0})[None]))
    assert found["pelvis_tilt"][0] == pytest.approx(-20.0)  # positive is backwards


@pytest.mark.parametrize("side", ["left", "right"])
def test_opensim_s_arms_by_scipy(side: str) -> None:
    # Of an arm raised by 40 degrees in abduction: about x alone.
    found = opensim_coordinates(trajectory(built({f"{side}_shoulder_elevation": 40.0})[None]))
    assert found[f"arm_add_{side[0]}"][0] == pytest.approx(-40.0)
    assert found[f"arm_flex_{side[0]}"][0] == pytest.approx(0.0, abs=1e-6)


def test_a_walker_on_a_circle_has_the_speed_of_the_circle() -> None:
    skeleton = load_skeleton("h36m_17")
    positions_m, time_s = walking(200, 50.0), np.arange(200) / 50.0
    centre = centre_m(positions_m, skeleton)
    # 1.2 rad/s at 1 m; it rises and falls by 15 mm with 1.9 Hz, 0.18 m/s at most.
    speed = speeds_m_s(centre, time_s)[1:-1]
    assert 1.19 < speed.min() < speed.max() < np.hypot(1.2, 0.18) + 0.01
    assert speeds_m_s(positions_m, time_s).shape == (200, 17)


def test_speeds_are_those_of_a_parabola_exactly() -> None:
    # Second-order differences, at times that are not even.
    time_s = np.array([0.0, 0.1, 0.18, 0.29, 0.34])
    positions_m = np.stack([time_s**2, 2 * time_s, 0 * time_s], axis=1)
    expected = np.hypot(2 * time_s, 2.0)
    np.testing.assert_allclose(speeds_m_s(positions_m, time_s)[1:-1], expected[1:-1], rtol=1e-12)
    assert np.isnan(speeds_m_s(positions_m[:1], time_s[:1])).all()
    positions_m[2] = np.nan
    for times_s in (time_s, np.arange(5.0)):
        np.testing.assert_array_equal(np.isnan(speeds_m_s(positions_m, times_s)), [False, True, True, True, False])
    with pytest.raises(ValueError, match="time_s must increase"):
        speeds_m_s(positions_m, np.zeros(5))


def test_there_is_no_speed_beside_frames_that_are_missing() -> None:
    """Somebody who has gone on by 3 m meanwhile; of 28 ms one frame is late, and none is missing."""
    time_s = np.array([0.0, 0.02, 0.04, 0.06, 1.06, 1.08, 1.108, 1.128])
    positions_m = np.stack([time_s + 3.0 * (time_s > 1), 0 * time_s, 0 * time_s], axis=1)
    speed = speeds_m_s(np.stack([positions_m, 2 * positions_m], axis=1), time_s)
    expected = np.array([1.0, 1.0, 1.0, np.nan, np.nan, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(speed, expected[:, None] * [1, 2], rtol=1e-12)


def test_heights_are_above_the_floor() -> None:
    positions_m = np.array([[[1.0, 2.0, 3.0]]])
    assert heights_m(positions_m) == 3.0
    assert heights_m(positions_m, world_up="y", floor_m=0.5) == 1.5
