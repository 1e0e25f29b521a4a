"""The view-dependent bias: smooth, of the stated size, no fixed point of the body, and the same for all cameras."""

from __future__ import annotations

import numpy as np
import pytest

from fgpose.io.skeletons import load_skeleton
from fgpose_benchmarks.synthetic import walking
from fgpose_benchmarks.synthetic.motion import turned
from fgpose_benchmarks.synthetic.view_bias import ViewBias, body_axes

SKELETON = load_skeleton("h36m_17")


@pytest.fixture(scope="module")
def bias() -> ViewBias:
    return ViewBias.drawn(np.random.default_rng(4), SKELETON)


def from_all_around(elevation_deg: float = 20.0, n: int = 72) -> np.ndarray:
    """Positions of cameras 5 m from the origin."""
    azimuth, elevation = np.linspace(0, 2 * np.pi, n, endpoint=False), np.deg2rad(elevation_deg)
    level = 5.0 * np.cos(elevation)
    height = np.full(n, 5.0 * np.sin(elevation))
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), height], axis=-1)


def biases_m(bias: ViewBias, elevation_deg: float = 20.0) -> np.ndarray:
    """Of one pose around the origin, as seen from all around: (camera, joint, 3)."""
    pose_m = walking(1, 50.0)
    pose_m = pose_m - pose_m[:, :1]
    return np.stack(
        [(bias.seen_m(pose_m, camera_m, SKELETON) - pose_m)[0] for camera_m in from_all_around(elevation_deg)]
    )


def test_its_size_is_as_stated(bias: ViewBias):
    squared = [np.sum(biases_m(bias, elevation) ** 2, axis=-1).mean(axis=0) for elevation in (0.0, 15.0, 30.0, 45.0)]
    rms_m = np.sqrt(np.mean(squared, axis=0))
    # Directions here are half as far apart as those for which the size is set.
    assert rms_m.min() > 0.0195
    assert rms_m.max() < 0.0405


def test_it_changes_smoothly_with_the_direction(bias: ViewBias):
    found_m = biases_m(bias)
    step_m = np.linalg.norm(found_m - np.roll(found_m, 1, axis=0), axis=-1)
    # Harmonics up to the second, and turning axes: at most (2 + 1) x 5 degrees of a length of up to twice the RMS.
    assert step_m.max() < 3 * np.deg2rad(5.0) * 0.08


def test_no_fixed_point_of_the_body_explains_it(bias: ViewBias):
    rows, values = [], []
    for elevation in (0.0, 15.0, 30.0, 45.0):
        cameras_m, found_m = from_all_around(elevation, 36), biases_m(bias, elevation)[::2]
        rays = cameras_m / np.linalg.norm(cameras_m, axis=-1, keepdims=True)
        across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
        rows.append(across.reshape(-1, 3))
        values.append(found_m.swapaxes(1, 2).reshape(-1, SKELETON.n_joints))
    fixed_m = np.linalg.lstsq(np.concatenate(rows), np.concatenate(values), rcond=None)[0]
    # Exactly the directions from which it was made free of it.
    np.testing.assert_allclose(fixed_m, 0.0, atol=1e-9)


def test_it_turns_with_the_body(bias: ViewBias):
    motion_m, camera_m = walking(20, 50.0), np.array([4.0, 1.0, 1.6])
    seen_m = bias.seen_m(motion_m, camera_m, SKELETON)
    angle = np.array(1.1)
    turned_m = bias.seen_m(turned(motion_m, angle), turned(camera_m, angle), SKELETON)
    np.testing.assert_allclose(turned_m, turned(seen_m, angle), atol=1e-12)


def test_left_and_right_are_treated_alike(bias: ViewBias):
    motion_m, camera_m = walking(20, 50.0), np.array([4.0, 1.0, 1.6])
    flip = np.array([1.0, -1.0, 1.0])
    mirrored_m = bias.seen_m((motion_m * flip)[:, SKELETON.mirror], camera_m * flip, SKELETON)
    np.testing.assert_allclose(
        mirrored_m[:, SKELETON.mirror] * flip, bias.seen_m(motion_m, camera_m, SKELETON), atol=1e-12
    )


def test_it_cannot_be_seen_along_the_ray(bias: ViewBias):
    along = from_all_around() / 5.0
    assert np.abs(np.einsum("cjk,ck->cj", biases_m(bias), along)).max() < 1e-9


def test_the_depth_of_each_joint_has_unit_size(bias: ViewBias):
    pose_m = walking(1, 50.0)
    pose_m = pose_m - pose_m[:, :1]
    depth = [
        bias.relative_depth(pose_m, camera_m, SKELETON)[0]
        for elevation in (0.0, 15.0, 30.0, 45.0)
        for camera_m in from_all_around(elevation, 36)
    ]
    # The same directions as those for which the size is set.
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(depth), axis=0)), 1.0, atol=1e-9)


def test_the_axes_of_a_body_are_its_own():
    motion_m = walking(100, 50.0)
    axes = body_axes(motion_m, SKELETON)
    np.testing.assert_allclose(axes @ axes.swapaxes(1, 2), np.broadcast_to(np.eye(3), axes.shape), atol=1e-12)
    steps_m = np.gradient(motion_m[:, 0, :2], axis=0)
    forward = steps_m / np.linalg.norm(steps_m, axis=-1, keepdims=True)
    # Hips and shoulders swing by 0.12 radians against each other.
    assert np.sum(axes[:, 0, :2] * forward, axis=-1).min() > np.cos(0.15)
