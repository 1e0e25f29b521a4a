from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fgpose.geometry.camera import CameraRig
from fgpose.geometry.up_axis import SIGNED_AXES, up_vector, z_up_R_world
from fgpose.io.recordings import load_recording
from fgpose.io.skeletons import load_skeleton
from fgpose.kinematics.vertical import body_up, find_up
from fgpose.trajectory import Status, Trajectory
from fgpose_benchmarks.synthetic import ring_rig, walking

LYING = Rotation.from_euler("y", 90, degrees=True).as_matrix()


def of(positions_m: np.ndarray) -> Trajectory:
    status = np.full(positions_m.shape[:2], Status.OBSERVED)
    return Trajectory(load_skeleton("h36m_17"), np.arange(len(positions_m)) / 25, positions_m, status)


@pytest.fixture(scope="module")
def walk() -> Trajectory:
    return of(walking(200, 25.0))


def angle_deg(found: Any, true: np.ndarray) -> float:
    return float(np.rad2deg(np.arccos(np.clip(up_vector(found) @ true, -1, 1))))


@pytest.mark.parametrize("axis", SIGNED_AXES)
@pytest.mark.parametrize("usual", ["+z", "+y"])
def test_the_axis_that_a_walker_stands_along_is_found_and_said(walk: Trajectory, axis: Any, usual: Any) -> None:
    world_R_up = z_up_R_world(axis).T
    for rig in (None, ring_rig().turned(world_R_up)):
        found = find_up([walk.turned(world_R_up)], rig, usual)
        assert found.world_up == axis
        expected = "" if axis == usual else f"the body stands along {axis} of the world, not along {usual}"
        assert found.remark.startswith(expected)
        assert bool(found.remark) == (axis != usual)


def test_a_tilt_that_cameras_alone_tell_is_doubted(walk: Trajectory) -> None:
    """As of a boxer, who leans by as much as the world is tilted: it is not turned level, but said."""
    tilted = Rotation.from_euler("x", 16.0, degrees=True).as_matrix()
    leaning = walk.turned(Rotation.from_euler("y", 8.0, degrees=True).as_matrix())
    found = find_up([leaning], ring_rig().turned(tilted))
    assert (found.world_up, found.is_doubtful) == ("+z", True)
    assert "all cameras stand level to a vertical that is 16 degrees" in found.remark
    level = find_up([leaning], ring_rig())
    assert (level.remark, level.is_doubtful) == ("", False)
    two = ring_rig().turned(tilted).subset(ring_rig().names[:2])
    assert not find_up([leaning], two).is_doubtful  # two are level to some vertical always


@pytest.mark.parametrize("pitch_deg", [10.0, 20.0, 35.0])
def test_the_world_of_a_camera_that_looks_down_is_levelled(walk: Trajectory, pitch_deg: float) -> None:
    """Its y is down but for the pitch; body and cameras tell it to 3 degrees, which is what the remark says."""
    tilted = Rotation.from_euler("x", pitch_deg, degrees=True).as_matrix() @ z_up_R_world("-y").T
    found = find_up([walk.turned(tilted)], ring_rig().turned(tilted))
    assert angle_deg(found.world_up, tilted[:, 2]) < 3
    assert f"the world is tilted by {pitch_deg:.0f} degrees from -y up" in found.remark


def test_a_nearly_upright_world_is_levelled_only_where_bodies_and_cameras_tell_it(walk: Trajectory) -> None:
    tilted = Rotation.from_euler("x", 12.0, degrees=True).as_matrix()
    found = find_up([walk.turned(tilted)], ring_rig().turned(tilted))
    assert angle_deg(found.world_up, tilted[:, 2]) < 3
    assert "tilted by 12 degrees from +z" in found.remark
    # A body that leans in a level room, and cameras that are not level around somebody upright, tell nothing.
    for people, rig in (([walk.turned(tilted)], ring_rig()), ([walk], ring_rig().turned(tilted))):
        assert find_up(people, rig) == find_up([walk])


def test_somebody_who_lies_before_level_cameras_does_not_turn_the_world(walk: Trajectory) -> None:
    lying = walk.turned(LYING)
    found = find_up([lying], ring_rig())
    assert found.world_up == "+z"
    assert "lies or stands on its head: it points 90 degrees away from +z" in found.remark
    # Without cameras nobody knows; it is said.
    alone = find_up([lying])
    assert alone.world_up == "+x"
    assert "if the person lies, say --world-up=+z" in alone.remark


def test_two_cameras_side_by_side_are_enough_of_a_referee(walk: Trajectory) -> None:
    cameras = ring_rig(24).cameras[:2]
    world_R_up = z_up_R_world("-y").T
    assert find_up([walk.turned(world_R_up)], CameraRig(cameras).turned(world_R_up)).world_up == "-y"
    assert find_up([walk.turned(LYING)], CameraRig(cameras)).world_up == "+z"


def test_cameras_on_their_side_do_not_hinder(walk: Trajectory) -> None:
    sideways = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    turn = np.eye(4)
    turn[:3, :3] = sideways
    rig = CameraRig(tuple(replace(each, world_T_camera=each.world_T_camera @ turn) for each in ring_rig().cameras))
    assert find_up([walk], rig) == find_up([walk])


def test_most_people_count(walk: Trajectory) -> None:
    world_R_up = z_up_R_world("-y").T
    people = [walk.turned(world_R_up), walk.turned(world_R_up), walk.turned(LYING @ world_R_up)]
    assert find_up(people).world_up == "-y"


def test_what_tells_nothing_leaves_all_as_usual(walk: Trajectory) -> None:
    unknown = replace(walk, positions_m=np.full_like(walk.positions_m, np.nan))
    scattered = of(np.random.default_rng(0).normal(size=(50, 17, 3)))
    for nothing in ([], [unknown], [scattered], [of(walk.positions_m[:2] @ LYING.T)]):
        assert body_up(nothing) is None
        assert find_up(nothing, usual="+y").world_up == "+y"
        assert find_up(nothing).remark == ""
    # Cameras alone tell where they surround the scene.
    world_R_up = z_up_R_world("-y").T
    assert find_up([], ring_rig().turned(world_R_up)).world_up == "-y"
    assert find_up([], ring_rig()).world_up == "+z"


def test_the_lean_of_a_body_cancels_over_its_headings(walk: Trajectory) -> None:
    """A body that leans forwards by 8 degrees all the time, and walks on a circle."""
    points = walk.positions_m
    left = points[:, walk.skeleton.index("left_shoulder")] - points[:, walk.skeleton.index("right_shoulder")]
    left[:, 2] = 0
    lean = Rotation.from_rotvec(np.deg2rad(8.0) * left / np.linalg.norm(left, axis=1, keepdims=True))
    root = points[:, [0]]
    leaning = np.stack([lean[t].apply((points - root)[t]) for t in range(len(points))]) + root
    up = body_up([of(leaning)])
    assert up is not None
    # One round of the circle in 5 s: what is left is the part of the second one.
    assert np.rad2deg(np.arccos(up[2])) < 2


def test_cameras_that_are_not_level_tell_the_axis_all_the_same(walk: Trajectory) -> None:
    """Rolled by up to 24 degrees, as those of the recorded man who balances, who leans by 26."""
    rig, _ = load_recording("balance_openpose")
    world_R_up = z_up_R_world("-y").T
    assert find_up([], rig.turned(world_R_up)).world_up == "-y"
    leaning = walk.turned(Rotation.from_euler("x", 26, degrees=True).as_matrix())
    found = find_up([leaning.turned(world_R_up)], rig.turned(world_R_up))
    assert found.world_up == "-y"
    assert "it leans by 26 degrees: if the person does not, the world is tilted" in found.remark
    assert find_up([leaning], rig).world_up == "+z"
