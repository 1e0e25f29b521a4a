from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import topdown_networks as tiny
from topdown_networks import FLOAT, FLOAT16, Boxes, Graph

from fgpose.geometry.camera import Camera
from fgpose.geometry.per_view.absolute_pose import UNSTATED_CONFIDENCE
from fgpose.monocular.network import Network
from fgpose.monocular.networks.metrabs import MeTRAbs, agreement, augmentations
from fgpose.skeleton import Skeleton

# Colours that no gamma changes.
COLOURS = np.array([(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (0, 1, 1), (1, 0, 1), (1, 1, 1)])
MIDDLE, PAIRS = ("head", "neck", "pelvis"), ("shoulder", "wrist", "knee", "ankle")
JOINTS = (*MIDDLE, *(f"{side}_{name}" for name in PAIRS for side in ("left", "right")))
SKELETON = Skeleton(
    "facing",
    JOINTS,
    bones=((2, 1), (1, 0), (1, 3), (1, 4), (3, 5), (4, 6), (2, 7), (2, 8), (7, 9), (8, 10)),
    root=(2,),
    left_right=((3, 4), (5, 6), (7, 8), (9, 10)),
)
# Of somebody who faces the camera: x right in the image, y down, z away, metres; the left side is on the image's right.
_RIGHT_SIDE = np.array([(-0.4, -0.5, 0.1), (-0.7, -0.1, -0.3), (-0.35, 0.35, -0.1), (-0.65, 0.45, 0.2)])
BODY_M = np.concatenate(
    [
        [(0.0, -0.8, 0.05), (0.02, -0.55, 0.0), (-0.02, 0.1, 0.0)],
        np.stack([_RIGHT_SIDE * (-0.95, 1, 1.2), _RIGHT_SIDE], axis=1).reshape(-1, 3),
    ]
)
CAMERA = tiny.camera((1280, 960))
# The crops show two metres on 256 pixels, and the middle of a disc is found to 0.4 of one.
TOLERANCE_M = 0.4 * 2.2 / 256


def body(x_m: float, y_m: float, z_m: float) -> np.ndarray:
    """At a place in front of the camera; both of a pair equally far from it, as the network below takes them to be."""
    points3d_m = BODY_M + np.array([x_m, y_m, z_m])
    distance_m = np.linalg.norm(points3d_m, axis=1, keepdims=True)
    points3d_m[4::2] *= distance_m[3::2] / distance_m[4::2]
    return points3d_m


def crop_model(
    path: Path,
    points3d_m: np.ndarray,
    side: int = 256,
    channels_first: bool = False,
    dtype: Any = np.float32,
    batch: int | str = 1,
) -> Path:
    """Finds the joints by colour, and the two of a pair by their half of the crop: right and left are as in the crop.

    It knows how far every joint is from the camera, which no turning of the camera changes, and where along the ray
    from the intrinsics.
    """
    graph, n = Graph(), len(JOINTS)
    image = graph.op("Cast", "image", to=FLOAT)
    image = image if channels_first else graph.op("Transpose", image, perm=[0, 3, 1, 2])
    colour = np.concatenate([[0, 1, 2], np.repeat([3, 4, 5, 6], 2)])
    matched = tiny.match(graph, image, COLOURS[colour].astype(float), 0.5)
    half = np.ones((1, n, side, side))
    half[:, 3::2, :, : side // 2] = 0
    half[:, 4::2, :, side // 2 :] = 0
    matched = graph.op("Mul", matched, graph.constant(half))
    K = graph.op("Reshape", graph.op("Cast", "intrinsics", to=FLOAT), graph.integers(-1, 9))
    rays = []
    for axis, focal, center in ((3, 0, 2), (2, 4, 5)):
        focal, center = (graph.op("Gather", K, graph.integers(index), axis=1) for index in (focal, center))
        rays.append(graph.op("Div", graph.op("Sub", tiny.middle(graph, matched, axis, side), center), focal))
    rays.append(graph.op("Add", graph.op("Mul", rays[0], graph.constant(0.0)), graph.constant(1.0)))
    rays = graph.op("Concat", *(graph.op("Unsqueeze", ray, graph.integers(2)) for ray in rays), axis=2)
    length = graph.op("ReduceL2", rays, axes=[2], keepdims=1)
    distance_mm = np.linalg.norm(points3d_m, axis=1)[None, :, None] * 1000
    graph.op("Div", graph.op("Mul", rays, graph.constant(distance_mm)), length, output="poses3d")
    shape = [batch, 3, side, side] if channels_first else [batch, side, side, 3]
    kind = FLOAT16 if dtype == np.float16 else FLOAT
    inputs = [("image", kind, shape), ("intrinsics", FLOAT, [batch, 3, 3])]
    return graph.save(path, inputs, [("poses3d", FLOAT, [batch, n, 3])])


def picture(points3d_m: np.ndarray, camera: Camera = CAMERA) -> tuple[np.ndarray, np.ndarray]:
    """The image of the joints, and their pixels."""
    points_px = camera.distort(camera.project(camera.to_world_frame(points3d_m)))
    image = np.zeros((*camera.size_px[::-1], 3), dtype=np.uint8)
    tiny.discs(image, points_px, 255 * np.concatenate([COLOURS[:3], np.repeat(COLOURS[3:], 2, axis=0)]), 9)
    return image, points_px


def box_around(points_px: np.ndarray, margin_px: float = 90) -> tuple[float, ...]:
    low, high = points_px.min(axis=0) - margin_px, points_px.max(axis=0) + margin_px
    return *low.tolist(), *(high - low).tolist(), 0.9


def test_a_network_that_answers_in_metres_is_refused(tmp_path: Path):
    points3d_m = body(0.0, 0.0, 3.5)
    image, points_px = picture(points3d_m)
    network = MeTRAbs(crop_model(tmp_path / "crop.onnx", points3d_m / 1000), Boxes([box_around(points_px)]), SKELETON)
    with pytest.raises(ValueError, match=r"crop\.onnx gives joints that are 3\.\d+ mm away: it seems to give metres"):
        network.tracker(CAMERA).detect(image)


@pytest.mark.parametrize("root_m", [(0.0, 0.0, 3.5), (-1.2, 0.5, 3.5), (1.4, -0.4, 4.5)])
@pytest.mark.parametrize("num_aug", [1, 5])
def test_absolute_joints_wherever_the_person_stands(tmp_path: Path, root_m: tuple[float, float, float], num_aug: int):
    points3d_m = body(*root_m)
    image, points_px = picture(points3d_m)
    network = MeTRAbs(
        crop_model(tmp_path / "crop.onnx", points3d_m), Boxes([box_around(points_px)]), SKELETON, num_aug=num_aug
    )
    assert isinstance(network, Network)
    people = network.tracker(CAMERA).detect(image)
    np.testing.assert_allclose(people.points3d_m[0], points3d_m, atol=TOLERANCE_M)
    np.testing.assert_allclose(people.points2d_px[0], points_px, atol=1.0)  # 0.3 pixels of the crop are 0.8 here
    assert np.isfinite(people.covariance_m2).all()
    assert people.problems == ("",)
    if num_aug == 1:
        assert (people.confidence == UNSTATED_CONFIDENCE).all()
    else:
        assert (people.confidence > 0.99).all()  # they agree to a few millimetres


@pytest.mark.parametrize(
    ("side", "channels_first", "dtype"), [(384, False, np.float32), (256, True, np.float32), (256, False, np.float16)]
)
def test_crops_as_the_file_wants_them(tmp_path: Path, side: int, channels_first: bool, dtype: Any):
    points3d_m = body(0.5, 0.2, 3.0)
    image, points_px = picture(points3d_m)
    path = crop_model(tmp_path / "crop.onnx", points3d_m, side, channels_first, dtype)
    people = MeTRAbs(path, Boxes([box_around(points_px)]), SKELETON).tracker(CAMERA).detect(image)
    np.testing.assert_allclose(people.points3d_m[0], points3d_m, atol=TOLERANCE_M)


@pytest.mark.parametrize(
    "camera",
    [
        replace(CAMERA, distortion=np.zeros(0)),
        replace(CAMERA, distortion=np.array([-0.35, 0.15, 0.002, -0.001, -0.03])),
        replace(CAMERA, lens="fisheye", distortion=np.array([0.05, -0.02, 0.01, -0.002])),
    ],
    ids=["pinhole", "wide", "fisheye"],
)
def test_the_lens_is_taken_out_of_the_crop(tmp_path: Path, camera: Camera):
    points3d_m = body(1.2, 0.6, 3.5)
    image, points_px = picture(points3d_m, camera)
    path = crop_model(tmp_path / "crop.onnx", points3d_m)
    people = MeTRAbs(path, Boxes([box_around(points_px)]), SKELETON).tracker(camera).detect(image)
    np.testing.assert_allclose(people.points3d_m[0], points3d_m, atol=TOLERANCE_M)
    np.testing.assert_allclose(people.points2d_px[0], points_px, atol=1.0)


def test_a_camera_on_its_side_sees_people_upright_when_told_what_is_up(tmp_path: Path):
    # The camera's y axis points to the world's x, so a person who stands upright (world y down) lies in the image.
    world_T_camera = np.eye(4)
    world_T_camera[:3, :3] = np.array([(0, 1, 0), (-1, 0, 0), (0, 0, 1)])
    camera = replace(CAMERA, world_T_camera=world_T_camera)
    points3d_m = camera.to_camera_frame(body(0.3, 0.2, 3.5))
    image, points_px = picture(points3d_m, camera)
    path, boxes = crop_model(tmp_path / "crop.onnx", points3d_m), Boxes([box_around(points_px)])
    upright = MeTRAbs(path, boxes, SKELETON, world_up=(0.0, -1.0, 0.0)).tracker(camera).detect(image)
    np.testing.assert_allclose(upright.points3d_m[0], points3d_m, atol=TOLERANCE_M)
    # Without that, left and right are no longer right and left of the middle.
    lying = MeTRAbs(path, boxes, SKELETON).tracker(camera).detect(image)
    assert np.abs(lying.points2d_px[0, 3:] - points_px[3:]).max() > 50


def test_two_people_nobody_and_another_image(tmp_path: Path):
    left_m, right_m = body(-1.0, 0.1, 4.5), body(1.0, 0.1, 4.5)
    # The network knows one distance per joint: the second person is moved to be at the same.
    right_m *= (np.linalg.norm(left_m, axis=1) / np.linalg.norm(right_m, axis=1))[:, None]
    (left, left_px), (right, right_px) = picture(left_m), picture(right_m)
    boxes = Boxes([box_around(left_px, 10), box_around(right_px, 10)], [])
    tracker = MeTRAbs(crop_model(tmp_path / "crop.onnx", left_m), boxes, SKELETON).tracker(CAMERA)
    people = tracker.detect(np.maximum(left, right))
    np.testing.assert_allclose(people.points3d_m, [left_m, right_m], atol=TOLERANCE_M)
    assert tracker.detect(left).points3d_m.shape == (0, 11, 3)
    with pytest.raises(ValueError, match="cam_1"):
        tracker.detect(left[:-1])


GRID_CROP = np.array([(40.0 + 44 * (n % 4), 30.0 + 90 * (n // 4)) for n in range(11)])


def bright(path: Path, knows_intrinsics: bool = True, points_crop: np.ndarray = GRID_CROP) -> Path:
    """Joints at these pixels of the crop, two metres away and as many more as the crop is bright.

    Brightness is red / 2 + green / 3 + blue / 6. A network without intrinsics takes the focal length to be 500.
    """
    graph, n = Graph(), len(points_crop)
    weighted = graph.op("Mul", "image", graph.constant([1 / 2, 1 / 3, 1 / 6]))
    brightness = graph.op("ReduceMean", graph.op("ReduceSum", weighted, graph.integers(3)), axes=[1, 2, 3], keepdims=0)
    depth_mm = graph.op("Mul", graph.op("Add", brightness, graph.constant(2.0)), graph.constant(1000.0))
    K = "K" if knows_intrinsics else graph.constant([[500, 0, 128], [0, 500, 128], [0, 0, 1]])
    K = graph.op("Reshape", K, graph.integers(9))
    focal, center = (graph.op("Gather", K, graph.integers(*indices)) for indices in ((0, 4), (2, 5)))
    rays = graph.op("Div", graph.op("Sub", graph.constant(points_crop[None]), center), focal)
    rays = graph.op("Concat", rays, graph.constant(np.ones((1, n, 1))), axis=2)
    graph.op("Mul", rays, depth_mm, output="poses3d")
    inputs = [("image", FLOAT, ["n", 256, 256, 3]), ("K", FLOAT, ["n", 3, 3])]
    return graph.save(path, inputs[: 1 + knows_intrinsics], [("poses3d", FLOAT, ["n", "j", 3])])


def crop_camera(camera: Camera, box: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and intrinsics of the crop of a box that lies in the image and is higher than wide, by hand."""
    left, top, width, height, _ = box
    x, y = left + width / 2, top + height / 2
    middle, above, below = camera.undistort(np.array([(x, y), (x, top), (x, top + height)]))
    forward, above, below = (np.linalg.inv(camera.K) @ (*pixel, 1) for pixel in (middle, above, below))
    z = forward / np.linalg.norm(forward)
    x = np.cross((0, 1, 0), z)
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z])
    above, below = R @ above, R @ below
    zoom = 256 / np.linalg.norm((below[:2] / below[2] - above[:2] / above[2]) * (900, 910))
    return R, np.array([[900 * zoom, 0, 128], [0, 910 * zoom, 128], [0, 0, 1]])


@pytest.mark.parametrize("knows_intrinsics", [True, False])
def test_what_the_network_sees_and_where_its_crop_looks(tmp_path: Path, knows_intrinsics: bool):
    image = np.full((960, 1280, 3), (200, 100, 50), dtype=np.uint8)
    box = (700.0, 380.0, 100.0, 200.0, 0.9)
    network = MeTRAbs(bright(tmp_path / "bright.onnx", knows_intrinsics), Boxes([box]), SKELETON)
    points3d_m = network.tracker(CAMERA).detect(image).points3d_m[0]
    # Values from 0 to 1, brightened by the mean of MeTRAbs's gammas, 0.8.
    depth_m = 2 + (np.array([200, 100, 50]) / 255) ** 0.8 @ (1 / 2, 1 / 3, 1 / 6)
    R, K = crop_camera(CAMERA, box)
    focal = np.diag(K)[:2] if knows_intrinsics else np.array([500, 500])
    crop_m = depth_m * np.concatenate([(GRID_CROP - 128) / focal, np.ones((11, 1))], axis=1)
    np.testing.assert_allclose(points3d_m, crop_m @ R, atol=1e-5)  # single precision of 2.5 m, and of two powers


def test_a_crop_is_made_smaller_in_linear_light(tmp_path: Path):
    image = np.zeros((960, 1280, 3), dtype=np.uint8)
    image[:, ::2] = 255
    # 2.4 pixels of the image make one of the crop: every other column is not skipped, but averaged.
    network = MeTRAbs(bright(tmp_path / "bright.onnx"), Boxes([(400, 200, 300, 600, 0.9)]), SKELETON)
    points3d_m = network.tracker(replace(CAMERA, distortion=np.zeros(0))).detect(image).points3d_m[0]
    R, _ = crop_camera(replace(CAMERA, distortion=np.zeros(0)), (400.0, 200.0, 300.0, 600.0, 0.9))
    depth_m = (points3d_m @ R.T)[:, 2]
    np.testing.assert_allclose(depth_m, 2 + 0.5 ** (0.8 / 2.2), atol=1e-4)  # a mean of 65 536 in single precision


def test_augmented_crops_are_turned_scaled_and_mirrored(tmp_path: Path):
    image = np.full((960, 1280, 3), 255, dtype=np.uint8)  # white is white after any gamma
    box = (596.0, 416.0, 100.0, 120.0, 0.9)
    camera = replace(CAMERA, distortion=np.zeros(0))
    network = MeTRAbs(bright(tmp_path / "bright.onnx"), Boxes([box]), SKELETON, num_aug=3)
    people = network.tracker(camera).detect(image)
    R, K = crop_camera(camera, box)
    np.testing.assert_allclose(R, np.eye(3), atol=1e-12)  # the box is in the middle
    answers_m = []
    for degrees, scale, mirrored in ((-25, 0.8, True), (0, 1.0, False), (25, 1.1, True)):
        crop_m = 3 * np.concatenate([(GRID_CROP - 128) / (np.diag(K)[:2] * scale), np.ones((11, 1))], axis=1)
        if mirrored:
            crop_m = crop_m[[0, 1, 2, 4, 3, 6, 5, 8, 7, 10, 9]] * (-1, 1, 1)
        cos, sin = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
        # A crop turned by so much clockwise shows a point that is to the right of the middle farther up.
        answers_m.append(crop_m @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]))
    np.testing.assert_allclose(people.points3d_m[0], np.mean(answers_m, axis=0), atol=1e-5)


def test_where_the_lens_model_turns_back_the_crop_is_black_and_a_joint_is_nowhere(tmp_path: Path):
    # r (1 - 0.5 r^4) grows up to r = 0.795 only, to 0.636; the image ends at 0.62, where r is 0.73.
    camera = tiny.camera((900, 680), (0.0, -0.5, 0.0, 0.0))
    box = (820.0, 0.0, 80.0, 680.0, 0.9)
    R, K = crop_camera(camera, box)

    def look(points_crop: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Whether the lens model puts points of the crop into the image, and whether it had turned back by then."""
        rays = np.concatenate([points_crop, np.ones((len(points_crop), 1))], axis=1) @ np.linalg.inv(K).T @ R
        u = np.where(rays[:, 2:] > 0, rays[:, :2] / rays[:, 2:], 1e3)
        points_px = camera.distort(u * np.diag(camera.K)[:2] + camera.K[:2, 2])
        return np.all((points_px >= 0) & (points_px <= (899, 679)), axis=1), np.hypot(*u.T) > 0.795

    inside, turned = look(np.argwhere(np.ones((256, 256)))[:, ::-1].astype(float))
    assert (inside & turned).sum() > 2000  # what a second look would show
    joints_crop = GRID_CROP + np.array([70.0, 0.0])
    joint_inside, joint_turned = look(joints_crop)
    assert (joint_inside & joint_turned).any()
    white = np.full((680, 900, 3), 255, dtype=np.uint8)
    network = MeTRAbs(bright(tmp_path / "bright.onnx", points_crop=joints_crop), Boxes([box]), SKELETON)
    people = network.tracker(camera).detect(white)
    np.testing.assert_array_equal(people.confidence[0] > 0, joint_inside & ~joint_turned)
    network = MeTRAbs(
        bright(tmp_path / "bright.onnx", points_crop=GRID_CROP - np.array([40.0, 0.0])), Boxes([box]), SKELETON
    )
    depth_m = (network.tracker(camera).detect(white).points3d_m[0] @ R.T)[:, 2]
    # The edge of the image is soft.
    np.testing.assert_allclose(depth_m, 2 + (inside & ~turned).mean(), atol=0.01)


def test_a_box_straight_above_has_some_crop(tmp_path: Path):
    image = np.full((960, 1280, 3), 100, dtype=np.uint8)
    box = (CAMERA.K[0, 2] - 50, CAMERA.K[1, 2] - 50, 100.0, 100.0, 0.9)
    camera = replace(CAMERA, distortion=np.zeros(0))
    network = MeTRAbs(bright(tmp_path / "bright.onnx"), Boxes([box]), SKELETON, world_up=(0.0, 0.0, 1.0))
    assert np.isfinite(network.tracker(camera).detect(image).points3d_m).all()


def test_a_joint_beyond_the_border_is_a_guess_in_3d_and_nothing_in_2d(tmp_path: Path):
    empty = np.zeros((960, 1280, 3), dtype=np.uint8)
    box = (-200.0, 300.0, 400.0, 400.0, 0.9)  # what lies in the image is 200 by 400, so the crop begins at -100
    people = MeTRAbs(bright(tmp_path / "bright.onnx"), Boxes([box]), SKELETON).tracker(CAMERA).detect(empty)
    outside = GRID_CROP[:, 0] < 60
    assert outside.sum() == 3
    assert (people.points3d_m[0, ~outside, 2] > 1.5).all()
    np.testing.assert_array_equal(people.confidence[0] == 0, outside)
    np.testing.assert_array_equal(np.isnan(people.points2d_px[0]).any(axis=1), outside)
    assert np.isfinite(people.points3d_m[0]).all()
    across_m2 = np.linalg.eigvalsh(people.covariance_m2[0])[:, 0]
    assert across_m2[outside].min() > 4 * across_m2[~outside].max()
    assert people.problems == ("",)  # 2 of the 10 joints that find the distance
    # With five of eleven joints in the image there is no telling how far the person is.
    box = (-300.0, 300.0, 400.0, 400.0, 0.9)
    people = MeTRAbs(bright(tmp_path / "bright.onnx"), Boxes([box]), SKELETON).tracker(CAMERA).detect(empty)
    assert (people.confidence > 0).sum() == 5
    assert np.isnan(people.points3d_m).all()
    assert people.problems[0].startswith("cut by the border: 5 of 10")


def test_augmentations_are_those_of_the_authors():
    (one,) = augmentations(1)
    assert (one.angle_rad, one.scale, one.mirrored) == (0.0, 1.0, False)
    assert one.gamma == pytest.approx(0.8)
    five = augmentations(5)
    np.testing.assert_allclose(np.rad2deg([each.angle_rad for each in five]), [-25, -12.5, 0, 12.5, 25])
    np.testing.assert_allclose([each.scale for each in five], [0.8, 0.9, 1.0, 1.05, 1.1])
    np.testing.assert_allclose([each.gamma for each in five], [0.6, 0.7, 0.8, 0.9, 1.0])
    assert [each.mirrored for each in five] == [False, True, False, True, False]


def test_confidence_is_the_agreement_of_the_augmentations_shifts_of_the_whole_body_apart():
    answers_m = np.tile(BODY_M, (4, 1, 1)) + np.array([0.0, 0.3, -0.2, 0.1])[:, None, None]
    np.testing.assert_allclose(agreement(answers_m), 1.0, atol=1e-12)
    answers_m[:, 5, 2] += np.array([0.1, -0.1, 0.1, -0.1])
    confidence = agreement(answers_m)
    # Its own standard deviation is 0.1 * sqrt(4/3), less a share of 1/11 that moves the mean of the body.
    assert confidence[5] == pytest.approx(1 / (1 + 4 / 3 * (10 / 11) ** 2))
    assert (np.delete(confidence, 5) > 0.98).all()
    assert (agreement(BODY_M[None]) == UNSTATED_CONFIDENCE).all()


def test_disagreeing_augmentations_are_seen_in_confidence_and_covariance(tmp_path: Path):
    points3d_m = body(0.2, 0.0, 3.5)
    image, points_px = picture(points3d_m)
    boxes, path = Boxes([box_around(points_px)]), crop_model(tmp_path / "crop.onnx", points3d_m)
    sure = MeTRAbs(path, boxes, SKELETON, num_aug=4).tracker(CAMERA).detect(image)
    # The wrists change sides from crop to crop when they are taken for a pair that is not mirrored.
    unmirrored = replace(SKELETON, left_right=SKELETON.left_right[:1] + SKELETON.left_right[2:])
    unsure = MeTRAbs(path, boxes, unmirrored, num_aug=4).tracker(CAMERA).detect(image)
    wrists = [JOINTS.index("left_wrist"), JOINTS.index("right_wrist")]
    others = [joint for joint in range(11) if joint not in wrists]
    assert (unsure.confidence[0, wrists] < 0.05).all()
    assert (unsure.confidence[0, others] > 0.9).all()
    sigma_m = np.sqrt(np.linalg.eigvalsh(unsure.covariance_m2[0]).max(axis=-1))
    assert (sigma_m[wrists] > 0.6).all()
    np.testing.assert_allclose(
        np.sqrt(np.linalg.eigvalsh(sure.covariance_m2[0]).max(axis=-1))[others], sigma_m[others], rtol=0.2
    )


def test_a_file_or_skeleton_that_does_not_fit_is_refused(tmp_path: Path):
    image, K, poses = ("image", [1, 256, 256, 3]), ("K", [1, 3, 3]), ("poses3d", [1, 11, 3])
    cases = {
        "flat": ([("image", [1, 256, 768]), K], [poses]),
        "grey": ([("image", [1, 256, 256, 1]), K], [poses]),
        "oblong": ([("image", [1, 256, 128, 3]), K], [poses]),
        "any side": ([("image", [1, "s", "s", 3]), K], [poses]),
        "three inputs": ([image, K, ("D", [1, 5])], [poses]),
        "five at a time": ([("image", [5, 256, 256, 3]), ("K", [5, 3, 3])], [poses]),
        "other K": ([image, ("K", [1, 4, 4])], [poses]),
        "scalar": ([image, ("f", [])], [poses]),
        "2D": ([image, K], [("poses2d", [1, 11, 2])]),
    }
    for name, (inputs, outputs) in cases.items():
        path = tiny.nothing(tmp_path / f"{name}.onnx", inputs, outputs)
        with pytest.raises(ValueError, match=rf"{name}\.onnx is another network: expected .*; found .*{outputs[0][0]}"):
            MeTRAbs(path, Boxes([]), SKELETON)
    path = tiny.nothing(tmp_path / "good.onnx", [image, K], [poses])
    with pytest.raises(ValueError, match=r"good\.onnx gives 11 joints, skeleton coco_17 has 17"):
        MeTRAbs(path, Boxes([]), "coco_17")
    with pytest.raises(ValueError, match="no skeleton 'body_99'"):
        MeTRAbs(path, Boxes([]), "body_99")
    with pytest.raises(ValueError, match="num_aug"):
        MeTRAbs(path, Boxes([]), SKELETON, num_aug=0)
    with pytest.raises(OSError, match=r"missing\.onnx"):
        MeTRAbs(tmp_path / "missing.onnx", Boxes([]), SKELETON)


def test_answers_without_sense_give_no_joints_and_no_warning(tmp_path: Path):
    path = tiny.nothing(tmp_path / "zeros.onnx", [("image", [1, 256, 256, 3]), ("K", [1, 3, 3])], [("p", [1, 11, 3])])
    network = MeTRAbs(path, Boxes([(300, 300, 200, 300, 0.9)]), SKELETON, num_aug=2)
    people = network.tracker(CAMERA).detect(picture(body(0.0, 0.0, 3.5))[0])
    assert not people.confidence.any()
    assert np.isnan(people.points2d_px).all()
    assert np.isnan(people.points3d_m).all()
    assert np.isnan(people.covariance_m2).all()


def test_a_box_where_the_lens_model_has_no_inverse_gives_no_joints(tmp_path: Path):
    # r (1 - 0.9 r^2) reaches 0.406 at most, so the lens model says nothing of the left third of the image.
    camera = tiny.camera((1280, 960), (-0.9, 0.0, 0.0, 0.0))
    network = MeTRAbs(bright(tmp_path / "bright.onnx"), Boxes([(20, 300, 200, 300, 0.9)]), SKELETON)
    people = network.tracker(camera).detect(np.full((960, 1280, 3), 100, dtype=np.uint8))
    assert people.n_people == 1
    assert not people.confidence.any()
    assert np.isnan(people.points2d_px).all()
    assert np.isnan(people.points3d_m).all()


def test_the_name_tells_whatever_the_joints_depend_on(tmp_path: Path):
    path = crop_model(tmp_path / "crop.onnx", BODY_M)
    boxes = Boxes([])
    names = [
        MeTRAbs(path, boxes, SKELETON).name,
        MeTRAbs(path, boxes, SKELETON, num_aug=5).name,
        MeTRAbs(path, boxes, SKELETON, world_up=(0.0, 0.0, 1.0)).name,
        MeTRAbs(crop_model(path, 1.1 * BODY_M), boxes, SKELETON).name,
    ]
    assert len(set(names)) == 4
