from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import topdown_networks as tiny
from topdown_networks import FLOAT, JOINT_COLOURS, Graph

from fgpose.monocular.networks.rtmpose import BoxCrop, SimccNetwork, SimccPose

AXES = ("simcc_x", "simcc_y")


def fixed(path: Path, bins: np.ndarray, peaks: np.ndarray, size: tuple[int, int] = (192, 256)) -> SimccNetwork:
    """Answers with these bins, (keypoint, axis), and these peaks, whatever it is shown."""
    graph, (width, height) = Graph(), size
    lengths = (2 * width, 2 * height, 576)[: bins.shape[1]]
    axes = (*AXES, "simcc_z")[: bins.shape[1]]
    for axis, length, places, heights in zip(axes, lengths, bins.T, peaks.T, strict=True):
        histogram = np.full((1, len(bins), length), -1.0)
        histogram[0, np.arange(len(bins)), places] = heights
        graph.op("Identity", graph.constant(histogram), output=axis)
    graph.op("Identity", "input")
    outputs = [(axis, FLOAT, ["b", "k", "n"]) for axis in axes]
    return SimccNetwork(graph.save(path, [("input", FLOAT, [1, 3, height, width])], outputs), axes)


def pose_in(network: SimccNetwork, image: np.ndarray, box: Sequence[float]) -> SimccPose:
    (pose,) = network.poses(image, np.array([[*box, 1.0]], dtype=float))
    return pose


def test_a_bin_is_half_a_pixel_of_the_crop(tmp_path: Path):
    bins = np.array([[0, 0], [192, 256], [383, 511], [100, 7]])
    network = fixed(tmp_path / "fixed.onnx", bins, np.full((4, 2), 0.7))
    assert network.size == (192, 256)
    assert network.n_keypoints == 4
    # A box of 96 x 256 enlarged by 1.25 is as high as the crop; its middle is (148, 178).
    pose = pose_in(network, np.zeros((400, 400, 3), dtype=np.uint8), (100.0, 50.0, 96.0, 256.0))
    np.testing.assert_allclose(pose.points2d_px, (148, 178) + 1.25 * (bins / 2 - (96, 128)), rtol=1e-12)
    np.testing.assert_allclose(pose.confidence, 0.7, rtol=1e-6)
    assert np.isnan(pose.depth).all()


def test_confidence_is_the_lower_peak_between_0_and_1(tmp_path: Path):
    peaks = np.array([[0.4, 0.6], [0.6, 0.4], [1.3, 1.1], [0.5, -0.2], [0.0, 0.9]])
    network = fixed(tmp_path / "fixed.onnx", np.full((5, 2), 10), peaks)
    pose = pose_in(network, np.zeros((400, 400, 3), dtype=np.uint8), (0.0, 0.0, 96.0, 256.0))
    np.testing.assert_allclose(pose.confidence, [0.4, 0.4, 1.0, 0.0, 0.0], rtol=1e-6)
    np.testing.assert_array_equal(np.isnan(pose.points2d_px).all(axis=1), [False, False, False, True, True])


def test_a_third_axis_is_depth_by_its_own_length(tmp_path: Path):
    bins = np.array([[0, 0, 0], [0, 0, 288], [0, 0, 432], [0, 0, 575]])
    peaks = np.array([[1, 1, 0.1], [1, 1, 0.9], [1, 1, 0.9], [1, -1, 0.9]])
    network = fixed(tmp_path / "fixed.onnx", bins, peaks)
    pose = pose_in(network, np.zeros((400, 400, 3), dtype=np.uint8), (0.0, 0.0, 96.0, 256.0))
    np.testing.assert_allclose(pose.depth, [-1, 0, 0.5, np.nan])
    np.testing.assert_allclose(pose.confidence, [1, 1, 1, 0])


@pytest.mark.parametrize("box", [(300, 100, 100, 400), (200, 300, 500, 120), (600, 420, 400, 260)])
@pytest.mark.parametrize("size", [(192, 256), (288, 384)])
def test_what_is_seen_in_the_crop_is_found_in_the_image(tmp_path: Path, box: tuple[int, ...], size: tuple[int, int]):
    image = np.full((720, 960, 3), 60, dtype=np.uint8)
    left, top, width, height = box
    points_px = np.array([left, top]) + np.array([width, height]) * np.array([(0.2, 0.2), (0.8, 0.3), (0.5, 0.75)])
    scale = 1.25 * max(width / size[0], height / size[1])
    tiny.discs(image, points_px, JOINT_COLOURS[:3], 5 * scale)
    network = SimccNetwork(tiny.simcc(tmp_path / "simcc.onnx", size=size), AXES)
    pose = pose_in(network, image, box)
    # Bins are half a pixel of the crop apart, and the middle of a disc is found to another quarter.
    np.testing.assert_allclose(pose.points2d_px[:3], points_px, atol=0.5 * scale)
    np.testing.assert_allclose(pose.confidence[:3], 0.9, atol=2e-3)  # the bell's top lies up to half a bin beside one
    assert not pose.confidence[3:].any()


def test_the_crop_reaches_beyond_the_image_in_black():
    image = np.full((100, 100, 3), 200, dtype=np.uint8)
    crop = BoxCrop.around(np.array([-40.0, 0.0, 80.0, 80.0, 1.0]), (100, 100))
    assert crop.scale == 1.0
    assert crop.center_px == (0.0, 40.0)
    shown = crop.of(image)
    assert (shown[:, :50] == 0).all()
    assert (shown[10:, 50:] == 200).all()
    assert (shown[:10] == 0).all()
    np.testing.assert_array_equal(crop.to_image(np.array([[50.0, 50.0], [0.0, 10.0]])), [[0, 40], [-50, 0]])


def test_a_file_of_another_network_is_refused_with_what_is_expected_and_found(tmp_path: Path):
    image, x, y = ("input", [1, 3, 256, 192]), ("simcc_x", [1, 17, 384]), ("simcc_y", [1, 17, 512])
    cases = {
        "heat map": ([image], [("heatmap", [1, 17, 64, 48])], "simcc_y.*heatmap"),
        "one output": ([image], [x], "simcc_x.*simcc_y"),
        "two inputs": ([image, ("k", [3, 3])], [x, y], r"k \[3, 3\]"),
        "nhwc": ([("input", [1, 256, 192, 3])], [x, y], r"\[1, 256, 192, 3\]"),
        "y before x": ([image], [("a", y[1]), ("b", x[1])], r"\[1, K, 384\].*\[1, 17, 512\], \[1, 17, 384\]"),
        "other keypoints": ([image], [x, ("y", [1, 16, 512])], r"\[1, 16, 512\]"),
        "any size": ([("input", [1, 3, "h", "w"])], [x, y], "fixed"),
    }
    for name, (inputs, outputs, message) in cases.items():
        path = tiny.nothing(tmp_path / f"{name}.onnx", inputs, outputs)
        with pytest.raises(ValueError, match=rf"{name}\.onnx.*{message}"):
            SimccNetwork(path, AXES)


def test_the_names_in_the_file_and_a_fixed_batch_do_not_matter(tmp_path: Path):
    path = tiny.simcc(tmp_path / "simcc.onnx", batch=1, names=("image", "output", "1554"))
    assert SimccNetwork(path, AXES).n_keypoints == 17


def test_y_before_x_is_refused(tmp_path: Path):
    """Square crops have as many bins of each."""
    names = ("input", "simcc_y", "simcc_x")
    with pytest.raises(ValueError, match=r"sw\.onnx gives simcc_y, simcc_x in this order: export it with x before y"):
        SimccNetwork(tiny.simcc(tmp_path / "sw.onnx", size=(256, 256), names=names), AXES)
