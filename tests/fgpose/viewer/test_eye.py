"""From where the scene is looked at: all cameras are in view, however they stand."""

from __future__ import annotations

import numpy as np
import pytest
from jaxtyping import Float

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.up_axis import UpAxis

pytest.importorskip("rerun")
_K = np.array([[1000.0, 0.0, 960.0], [0.0, 1000.0, 540.0], [0.0, 0.0, 1.0]])


def world_T_looking(position_m: np.ndarray, target_m: np.ndarray, vertical: np.ndarray) -> Float[np.ndarray, "4 4"]:
    """z towards the target, y down."""
    forward = (target_m - position_m) / np.linalg.norm(target_m - position_m)
    right = np.cross(forward, vertical) / np.linalg.norm(np.cross(forward, vertical))
    world_T = np.eye(4)
    world_T[:3] = np.column_stack([right, np.cross(forward, right), forward, position_m])
    return world_T


@pytest.mark.parametrize("overview", [False, True])
@pytest.mark.parametrize("up", ["+z", "-y"])
@pytest.mark.parametrize(
    "azimuths_deg",
    [(0,), (0, 60), (10, 100, 190, 280), (0, 20, 40, 60, 80), tuple(range(0, 360, 45))],
    ids=["one", "two", "ring of four", "all on one side", "ring of eight"],
)
def test_all_cameras_are_in_view(azimuths_deg: tuple[int, ...], up: UpAxis, overview: bool) -> None:
    from fgpose.geometry.up_axis import up_vector
    from fgpose.viewer.rerun.blueprint import eye_m

    vertical = up_vector(up)
    first = np.roll(vertical, 1)
    second = np.cross(vertical, first)
    cameras = []
    for number, azimuth in enumerate(np.deg2rad(azimuths_deg).tolist()):
        # At 3 to 5 m, 1.5 to 2.5 m high.
        out_m = (3.0 + number % 3) * (np.cos(azimuth) * first + np.sin(azimuth) * second)
        place_m = out_m + (1.5 + 0.5 * (number % 3)) * vertical
        world_T = world_T_looking(place_m, 0.9 * vertical, vertical)
        cameras.append(Camera(f"cam{number}", (1920, 1080), _K, world_T, np.zeros(0)))
    rig = CameraRig(tuple(cameras))
    position_m, target_m = eye_m(rig, up, overview=overview)
    eye_T_world = np.linalg.inv(world_T_looking(position_m, target_m, vertical))
    x, y, depth = eye_T_world[:3, :3] @ rig.positions_m.T + eye_T_world[:3, 3:]
    # Rerun sees 55 degrees from top to bottom; the scene is 1.5 times as wide as it is high, at least.
    half = np.tan(np.deg2rad(55 / 2))
    assert (depth > 0).all()
    assert (np.abs(y) < half * depth).all()
    assert (np.abs(x) < 1.5 * half * depth).all()
    # No camera hides the person: one before them is 15 degrees off the line of sight.
    is_between = depth < np.linalg.norm(position_m - target_m)
    assert (np.hypot(x, y)[is_between] > np.tan(np.deg2rad(15)) * depth[is_between]).all()


def test_a_board_at_arms_length_before_two_cameras_side_by_side_is_seen_from_near_by() -> None:
    """Their axes meet nowhere: only where the board was tells how far away they look."""
    from fgpose.viewer.rerun.blueprint import eye_m
    from fgpose.viewer.rerun.scene import frustum_m

    vertical, board_m = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.4, 0.0])
    cameras = []
    for number, place_m in enumerate([np.array([-0.04, 0.0, 0.0]), np.array([0.04, 0.0, 0.0])]):
        world_T = world_T_looking(place_m, place_m + np.array([0.0, 1.0, 0.0]), vertical)
        cameras.append(Camera(f"cam{number}", (1920, 1080), _K, world_T, np.zeros(0)))
    rig = CameraRig(tuple(cameras))
    position_m, target_m = eye_m(rig, "+z", overview=True, around_m=board_m)
    np.testing.assert_allclose(target_m, board_m, atol=1e-6)
    assert np.linalg.norm(position_m - board_m) < 1
    assert frustum_m(rig, board_m) < 0.1
    assert np.linalg.norm(eye_m(rig, "+z", overview=True)[0] - board_m) > 2
