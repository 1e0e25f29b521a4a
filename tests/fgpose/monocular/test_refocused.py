"""Absolute 3D of one view after its focal length was corrected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgpose.geometry.camera import Camera
from fgpose.geometry.per_view.absolute_pose import absolute_pose
from fgpose.io.skeletons import load_skeleton
from fgpose.monocular.detected import refocused
from fgpose.monocular.network import People
from fgpose_benchmarks.synthetic import ring_rig, walking

SKELETON = load_skeleton("h36m_17")


def seen(camera: Camera, truth_m: np.ndarray, relative_m: np.ndarray) -> People:
    """What a network whose root-relative 3D is exact would say, lifted with the lens of the camera."""
    points2d_px = ring_rig().cameras[0].project(truth_m)
    pose = absolute_pose(relative_m, points2d_px, np.ones(len(truth_m)), camera, SKELETON)
    assert not pose.problem
    return People.stacked(np.zeros((1, 5)), [points2d_px], [np.ones(len(truth_m))], [pose])


def test_it_is_as_if_it_had_been_detected_with_the_right_lens() -> None:
    right = ring_rig().cameras[0]
    wrong = replace(right, K=np.diag([0.8, 0.8, 1.0]) @ right.K)
    wrong = replace(wrong, K=np.where(np.eye(3, dtype=bool), wrong.K, right.K))
    truth_m = walking(1, 30.0, SKELETON)[0]
    relative_m = right.to_camera_frame(truth_m) - right.to_camera_frame(truth_m)[0]
    lifted, exact = seen(wrong, truth_m, relative_m), seen(right, truth_m, relative_m)
    corrected = refocused(lifted, wrong, right)
    before_m, after_m = (
        np.linalg.norm(each.points3d_m - exact.points3d_m, axis=-1).max() for each in (lifted, corrected)
    )
    # 20 % of 4.5 m; then what is of second order, the depth of a body over its distance: 0.3 of 4.5, times 20 % of it.
    assert before_m > 0.7
    assert after_m < 0.06
    # Across the ray the joints are on their detections.
    camera_frame = replace(right, world_T_camera=np.eye(4))
    np.testing.assert_allclose(camera_frame.project(corrected.points3d_m[0]), lifted.points2d_px[0], atol=1e-6)
    sigma, exact_sigma = (np.sqrt(each.covariance_m2[0, :, 2, 2]) for each in (corrected, exact))
    np.testing.assert_allclose(sigma, exact_sigma, rtol=0.1)


def test_nothing_changes_where_the_lens_is_the_same() -> None:
    camera = ring_rig().cameras[0]
    truth_m = walking(1, 30.0, SKELETON)[0]
    people = seen(camera, truth_m, camera.to_camera_frame(truth_m))
    assert refocused(people, camera, camera) is people
