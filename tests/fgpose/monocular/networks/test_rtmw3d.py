from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import topdown_networks as tiny
from topdown_networks import JOINT_COLOURS, Boxes

from fgpose.geometry.camera import Camera
from fgpose.io.skeletons import load_skeleton
from fgpose.monocular.network import Network
from fgpose.monocular.networks.rtmw3d import RTMW3D, root_depth

SKELETON = load_skeleton("coco_17")
CAMERA = tiny.camera((960, 1280))
RANGE_M = 2.1744869


def direction(right: float, down: float, back: float) -> np.ndarray:
    return np.array([right, down, back]) / np.linalg.norm((right, down, back))


def person(height_m: float, root_m: tuple[float, float, float]) -> np.ndarray:
    """Facing the camera, arms and one leg out of the plane; limbs and trunk as long as Drillis and Contini say."""
    trunk_m = np.sqrt((0.288 * height_m) ** 2 - 0.08**2 - 0.05**2)
    joints = {"hip": np.array([0.1, 0.0, 0.0]), "shoulder": np.array([0.18, -trunk_m, 0.05])}
    chains = {
        "left": [direction(0.7, 0.5, -0.4), direction(0.5, -0.8, 0.1), direction(0.2, 0.9, -0.4), direction(0, 1, 0.3)],
        "right": [direction(-0.4, 0.9, 0.2), direction(-0.6, 0.5, -0.6), direction(-0.1, 1, 0.1), direction(0, 1, 0.2)],
    }
    points = np.zeros((17, 3))
    # A broad face, so that the discs lie side by side.
    points[:5] = np.array([(0, 0, -0.1), (0.1, -0.1, -0.08), (-0.1, -0.1, -0.08), (0.2, 0, 0), (-0.2, 0, 0)])
    points[:5] += (0, -0.25 - trunk_m, 0)
    for side, mirror in (("left", 1), ("right", -1)):
        upper_arm, lower_arm, upper_leg, lower_leg = chains[side]
        shoulder, hip = (joints[name] * (mirror, 1, mirror) for name in ("shoulder", "hip"))
        elbow, knee = shoulder + 0.186 * height_m * upper_arm, hip + 0.245 * height_m * upper_leg
        wrist, ankle = elbow + 0.146 * height_m * lower_arm, knee + 0.246 * height_m * lower_leg
        named = {"shoulder": shoulder, "elbow": elbow, "wrist": wrist, "hip": hip, "knee": knee, "ankle": ankle}
        for name, point in named.items():
            points[SKELETON.index(f"{side}_{name}")] = point
    return points + root_m


def image_points(points3d_m: np.ndarray, camera: Camera) -> np.ndarray:
    return camera.distort(camera.project(points3d_m))


def box_around(points_px: np.ndarray) -> tuple[float, ...]:
    low, high = points_px.min(axis=0) - 20, points_px.max(axis=0) + 20
    return *low.tolist(), *(high - low).tolist(), 0.9


def network(path: Path, points3d_m: np.ndarray, boxes: Boxes, **settings: Any) -> RTMW3D:
    """Finds the joints by their colour, and knows how far each lies behind the hips."""
    behind_m = points3d_m[:, 2] - points3d_m[[11, 12], 2].mean()
    bins = np.full(133, 288)
    bins[:17] = np.round((behind_m / RANGE_M + 1) * 288)
    tiny.simcc(path, 133, (288, 384), batch=1, depth_bins=bins, names=("input", "output", "1554", "1556"))
    return RTMW3D(path, boxes, **settings)


def picture(points_px: np.ndarray, camera: Camera = CAMERA) -> np.ndarray:
    image = np.full((*camera.size_px[::-1], 3), 60, dtype=np.uint8)
    tiny.discs(image, points_px, JOINT_COLOURS[:17], 8)
    return image


@pytest.mark.parametrize("root_m", [(0.1, -0.1, 3.5), (-0.8, 0.2, 4.2)])
def test_absolute_joints_of_a_person_of_the_assumed_height(tmp_path: Path, root_m: tuple[float, float, float]):
    points3d_m = person(1.70, root_m)
    points_px = image_points(points3d_m, CAMERA)
    found = network(tmp_path / "rtmw3d.onnx", points3d_m, Boxes([box_around(points_px)]))
    assert isinstance(found, Network)
    assert found.skeleton.name == "coco_17"
    people = found.tracker(CAMERA).detect(picture(points_px))
    crop_px = 1.25 * box_around(points_px)[3] / 384
    np.testing.assert_allclose(people.points2d_px[0], points_px, atol=crop_px)
    np.testing.assert_allclose(people.confidence, 0.9, atol=2e-3)
    # A limb spans about 60 pixels of the crop, each end is found to half of one, and ten bones count:
    # the distance is good to 1 %. A bin of depth is 7.5 mm.
    error_m = people.points3d_m[0] - points3d_m
    assert np.abs(error_m[:, 2]).max() < 0.01 * root_m[2] + 0.008
    assert np.abs(error_m[:, :2]).max() < 0.02
    assert np.abs(np.ptp(error_m[:, 2])) < 0.016


def test_the_distance_is_as_wrong_as_the_height_and_the_covariance_says_so(tmp_path: Path):
    points3d_m = person(1.70, (0.1, -0.1, 3.5))
    points_px = image_points(points3d_m, CAMERA)
    boxes = Boxes([box_around(points_px)])
    tall = network(tmp_path / "tall.onnx", points3d_m, boxes, height_m=1.70 * 1.06).tracker(CAMERA)
    people = tall.detect(picture(points_px))
    rays = people.points3d_m[0] / people.points3d_m[0, :, 2:]
    longer = people.points3d_m[0, [11, 12], 2].mean() / 3.5
    # Depths relative to the hips do not grow with the height, so the limbs out of the plane grow a little more.
    assert 1.05 < longer < 1.085
    # The error along the ray is within two standard deviations; across the ray they are a fifth of that at most.
    covariance_m2 = people.covariance_m2[0]
    depth_sigma_m = np.sqrt(covariance_m2[:, 2, 2])
    assert (np.abs(people.points3d_m[0, :, 2] - points3d_m[:, 2]) < 2 * depth_sigma_m).all()
    across = np.cross(rays, (0.0, 1.0, 0.0))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    assert (np.sqrt(np.einsum("ji,jik,jk->j", across, covariance_m2, across)) < 0.2 * depth_sigma_m).all()
    assert (np.linalg.eigvalsh(covariance_m2) > 0).all()
    # The unknown height (4.5 %) and the ten bones, whose shares of it differ by 10 %, count for themselves.
    assert (depth_sigma_m[[11, 12]] > 3.5 * np.hypot(0.045, 0.1 / np.sqrt(10))).all()


def test_without_a_height_there_are_2d_joints_only(tmp_path: Path):
    points3d_m = person(1.70, (0.1, -0.1, 3.5))
    points_px = image_points(points3d_m, CAMERA)
    flat = network(tmp_path / "rtmw3d.onnx", points3d_m, Boxes([box_around(points_px)]), height_m=None)
    people = flat.tracker(CAMERA).detect(picture(points_px))
    assert np.isfinite(people.points2d_px).all()
    assert np.isnan(people.points3d_m).all()
    assert np.isnan(people.covariance_m2).all()
    assert people.problems == ("",)
    for height_m in (0.2, 170.0):
        with pytest.raises(ValueError, match="height of a person"):
            network(tmp_path / "rtmw3d.onnx", points3d_m, Boxes([]), height_m=height_m)


def test_a_person_of_whom_only_the_head_is_seen_has_no_distance(tmp_path: Path):
    points3d_m = person(1.70, (0.1, -0.1, 3.5))
    points_px = image_points(points3d_m, CAMERA)
    points_px[7:] = np.nan
    head = network(tmp_path / "rtmw3d.onnx", points3d_m, Boxes([box_around(points_px[:7])]))
    people = head.tracker(CAMERA).detect(picture(points_px))
    assert (people.confidence[0, :7] > 0.8).all()
    assert not people.confidence[0, 7:].any()
    assert np.isnan(people.points2d_px[0, 7:]).all()
    assert np.isnan(people.points3d_m).all()
    assert np.isnan(people.covariance_m2).all()
    assert people.problems[0].startswith("few bones: fewer than 3")


def test_a_person_of_whom_five_joints_are_seen_has_a_problem_and_no_3d(tmp_path: Path):
    points3d_m = person(1.70, (0.1, -0.1, 3.5))
    points_px = image_points(points3d_m, CAMERA)
    seen = [SKELETON.index(name) for name in ("left_shoulder", "right_shoulder", "left_elbow", "left_hip", "right_hip")]
    points_px[np.setdiff1d(np.arange(17), seen)] = np.nan
    box = box_around(image_points(points3d_m, CAMERA))
    people = network(tmp_path / "rtmw3d.onnx", points3d_m, Boxes([box])).tracker(CAMERA).detect(picture(points_px))
    # Three bones tell the distance of the hips; the translation needs six joints.
    assert people.problems[0].startswith("few joints: 5 of 12 are seen")
    assert np.isnan(people.points3d_m).all()


def test_two_people_nobody_and_another_image(tmp_path: Path):
    left_m, right_m = person(1.70, (-0.8, 0.0, 5.0)), person(1.70, (0.9, 0.1, 5.0))
    left_px, right_px = image_points(left_m, CAMERA), image_points(right_m, CAMERA)
    boxes = Boxes([box_around(left_px), box_around(right_px)], [])
    tracker = network(tmp_path / "rtmw3d.onnx", left_m, boxes).tracker(CAMERA)
    people = tracker.detect(np.where(picture(left_px) == 60, picture(right_px), picture(left_px)))
    np.testing.assert_allclose(people.points3d_m, [left_m, right_m], atol=0.07)  # 1 % of the distance, and half a bin
    assert tracker.detect(picture(left_px)).n_people == 0
    with pytest.raises(ValueError, match="cam_1"):
        tracker.detect(np.zeros((10, 10, 3), dtype=np.uint8))


def test_another_number_of_keypoints_or_outputs_is_refused(tmp_path: Path):
    bins = np.full(134, 288)
    path = tiny.simcc(tmp_path / "other.onnx", 134, (288, 384), depth_bins=bins)
    with pytest.raises(ValueError, match=r"other\.onnx gives 134 keypoints; RTMW3D gives 133"):
        RTMW3D(path, Boxes([]))
    with pytest.raises(ValueError, match=r"flat\.onnx is another network.*simcc_z.*found"):
        RTMW3D(tiny.simcc(tmp_path / "flat.onnx", 133, (288, 384)), Boxes([]))


def test_the_name_tells_the_height(tmp_path: Path):
    points3d_m = person(1.70, (0.1, -0.1, 3.5))
    path = tmp_path / "rtmw3d.onnx"
    names = {network(path, points3d_m, Boxes([]), height_m=height).name for height in (1.7, 1.8, None)}
    assert len(names) == 3


def depths(points3d_m: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    root_z_m = points3d_m[[11, 12], 2].mean()
    return points3d_m[:, :2] / points3d_m[:, 2:], points3d_m[:, 2] - root_z_m, np.ones(17)


@pytest.mark.parametrize("height_m", [1.10, 1.70, 2.0])
def test_root_depth_is_exact_without_errors(height_m: float):
    points3d_m = person(height_m, (0.6, -0.3, 2.7))
    root_m, sigma_m = root_depth(*depths(points3d_m), SKELETON, height_m)
    assert root_m == pytest.approx(2.7, abs=1e-9)
    # Ten bones that each differ by 10 % or a little more: their mean, by 10 % / sqrt(10) = 3.2 % or a little more.
    assert 0.031 * 2.7 < sigma_m < 0.05 * 2.7


def test_joints_in_the_wrong_place_move_the_root_depth_little_and_noise_is_seen_in_its_sigma():
    u, behind_m, confidence = depths(person(1.70, (0.0, 0.0, 4.0)))
    expected_m = root_depth(u, behind_m, confidence, SKELETON, 1.70)[1]
    u[SKELETON.index("left_knee")] += (0.1, 0.03)
    behind_m[SKELETON.index("right_wrist")] += 0.8
    root_m, sigma_m = root_depth(u, behind_m, confidence, SKELETON, 1.70)
    assert abs(root_m - 4.0) < 0.05 * 4.0  # three of ten bones are wrong, the longest by 90 %
    assert abs(root_m - 4.0) < 2 * sigma_m
    noisy = np.random.default_rng(0).normal(0, 0.04, u.shape)
    assert root_depth(u + noisy, behind_m, confidence, SKELETON, 1.70)[1] > 1.2 * expected_m


def test_root_depth_needs_three_bones_that_are_seen_from_the_side():
    u, behind_m, confidence = depths(person(1.70, (0.0, 0.0, 4.0)))
    unseen = confidence.copy()
    unseen[[SKELETON.index(name) for name in ("left_elbow", "right_elbow", "left_knee", "right_hip")]] = 0.2
    assert np.isnan(root_depth(u, behind_m, unseen, SKELETON, 1.70)).all()
    unseen[SKELETON.index("right_hip")] = 1.0
    assert root_depth(u, behind_m, unseen, SKELETON, 1.70)[0] == pytest.approx(4.0, abs=1e-9)
    pointing = behind_m.copy()
    pointing[[SKELETON.index(f"{side}_{name}") for side in ("left", "right") for name in ("elbow", "knee")]] += 2.0
    assert np.isnan(root_depth(u, pointing, confidence, SKELETON, 1.70)).all()
    missing = np.full_like(u, np.nan)
    assert np.isnan(root_depth(missing, behind_m, 0 * confidence, SKELETON, 1.70)).all()


def test_a_fisheye_camera(tmp_path: Path):
    # 20 degrees off its axis the lens squeezes people by an eighth: not undone, they would seem that much farther away.
    camera = replace(tiny.camera((1440, 1280)), lens="fisheye", distortion=np.array([0.02, -0.01, 0.003, 0.0]))
    points3d_m = person(1.70, (1.3, 0.1, 3.5))
    points_px = image_points(points3d_m, camera)
    tracker = network(tmp_path / "rtmw3d.onnx", points3d_m, Boxes([box_around(points_px)])).tracker(camera)
    # 1 % of the distance, and half a bin.
    np.testing.assert_allclose(
        tracker.detect(picture(points_px, camera)).points3d_m[0], points3d_m, atol=0.01 * 3.5 + 0.008
    )
