"""From which side cameras see the walker."""

from __future__ import annotations

import numpy as np
from walks import SKELETON

from fgpose.calibration.from_people.rig.sectors import sectors, upright
from fgpose_benchmarks.synthetic import ring_rig, walking

RIG = ring_rig(4)
POSES = np.stack([camera.world_T_camera for camera in RIG.cameras])
WALK_M = walking(160, 30.0, SKELETON)


def test_who_stands_in_front_is_opposite_to_who_stands_behind() -> None:
    """The walker goes along +x at first, on a circle to the left."""
    places_m = np.array([[-5.0, 0, 1], [0, -5.0, 1], [5.0, 0, 1], [0, 5.0, 1]])  # behind, right, in front, left
    # The walker stands 1 m to the right of the origin; half a sector more is far from the edges of quarters.
    turned = sectors(WALK_M[:1] + np.array([0, 1.0, 0]), SKELETON, places_m, 4)

    # Sector 0 begins straight behind, where rounding and the twist of the trunk decide: quarters are those between.
    diagonal_m = places_m + np.roll(places_m, -1, axis=0)
    assert sectors(WALK_M[:1] + np.array([0, 1.0, 0]), SKELETON, diagonal_m, 4).tolist() == [[0, 1, 2, 3]]
    assert turned.shape == (1, 4)


def test_all_sectors_come_by_while_the_walker_turns_once() -> None:
    """Once round takes 5.2 s."""
    own = sectors(WALK_M, SKELETON, POSES[:, :3, 3], 8)

    assert all(set(own[:, c]) == set(range(8)) for c in range(4))


def test_frames_without_a_trunk_take_the_nearest() -> None:
    joints_m = WALK_M.copy()
    joints_m[40:50, SKELETON.index("left_hip")] = np.nan
    own = sectors(joints_m, SKELETON, POSES[:, :3, 3], 8)

    np.testing.assert_array_equal(own[40:45], np.tile(own[39], (5, 1)))
    assert not sectors(np.full_like(joints_m, np.nan), SKELETON, POSES[:, :3, 3], 8).any()


def test_a_rolled_camera_sees_the_body_as_an_upright_one_does() -> None:
    angle = np.deg2rad(90.0)
    roll = np.eye(4)
    roll[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]

    # The trunk leans by a few degrees.
    np.testing.assert_allclose(upright(WALK_M, SKELETON, POSES), np.tile(np.eye(2), (4, 1, 1)), atol=0.05)
    # Axes of the body in the rolled image: turned the other way.
    np.testing.assert_allclose(upright(WALK_M, SKELETON, POSES @ roll)[0], roll[:2, :2].T, atol=0.05)
