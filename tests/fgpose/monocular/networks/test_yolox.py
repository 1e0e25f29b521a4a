from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import topdown_networks as tiny
from topdown_networks import FLOAT, Graph

from fgpose.monocular.networks.topdown import PersonDetector
from fgpose.monocular.networks.yolox import Yolox, letterbox

BLUE, RED = tiny.PERSON_COLOURS


def bare_head(path: Path, colour: np.ndarray = BLUE, side: int = 640, label: int = 0) -> Path:
    """YOLOX without decoding: a cell that is full of the colour (RGB) says: a thing of 96 by 192 around my middle."""
    graph = Graph()
    matched = tiny.match(graph, "images", colour[None, ::-1], 40.0)
    levels = []
    for stride in (8, 16, 32):
        n = (side // stride) ** 2
        full = graph.op("AveragePool", matched, kernel_shape=[stride, stride], strides=[stride, stride])
        full = graph.op("Reshape", full, graph.integers(1, n, 1))
        middle_and_size = np.tile([0.5, 0.5, np.log(96 / stride), np.log(192 / stride)], (1, n, 1))
        classes = np.tile(np.eye(80)[label], (1, n, 1)) * 0.9
        levels.append(graph.op("Concat", graph.constant(middle_and_size), full, graph.constant(classes), axis=2))
    graph.op("Concat", *levels, axis=1, output="output")
    n_cells = sum((side // stride) ** 2 for stride in (8, 16, 32))
    return graph.save(path, [("images", FLOAT, [1, 3, side, side])], [("output", FLOAT, [1, n_cells, 85])])


def rectangle(image: np.ndarray, left: int, top: int, width: int, height: int, colour: np.ndarray) -> None:
    image[top : top + height, left : left + width] = colour


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Yolox:
    return Yolox(tiny.yolox(tmp_path_factory.mktemp("yolox") / "dets.onnx"))


@pytest.mark.parametrize("size", [(640, 480), (1920, 1080), (1088, 1920), (320, 200)])
def test_boxes_of_people_in_pixels_of_the_image_whatever_its_size(exported: Yolox, size: tuple[int, int]):
    width, height = size
    image = np.full((height, width, 3), 20, dtype=np.uint8)
    first = (width // 10, height // 5, width // 4, height // 2)
    second = (width // 2, height // 10, width // 5, height // 3)
    rectangle(image, *first, BLUE)
    rectangle(image, *second, RED)
    boxes = exported.boxes(image)
    assert isinstance(exported, PersonDetector)
    # An edge is blurred over one pixel of the square and found to half of one, at either end.
    tolerance_px = max(1.0, max(size) / 640)
    np.testing.assert_allclose(boxes[:, :4], [second, first], atol=tolerance_px)
    np.testing.assert_allclose(boxes[:, 4], [0.9, 0.8], atol=1e-6)


def test_nobody_and_nothing_that_is_not_a_person(tmp_path: Path, exported: Yolox):
    image = np.full((480, 640, 3), 20, dtype=np.uint8)
    assert exported.boxes(image).shape == (0, 5)
    rectangle(image, 100, 100, 200, 300, BLUE)
    rectangle(image, 400, 100, 200, 300, RED)
    dog = Yolox(tiny.yolox(tmp_path / "dog.onnx", labels=(0, 16)))
    np.testing.assert_allclose(dog.boxes(image)[:, 0], [100], atol=1.0)
    sure = Yolox(tiny.yolox(tmp_path / "sure.onnx"), min_confidence=0.85)
    np.testing.assert_allclose(sure.boxes(image)[:, 0], [400], atol=1.0)


def test_the_square_is_filled_with_114_to_the_right_and_below():
    image = np.full((300, 600, 3), (10, 20, 30), dtype=np.uint8)
    square, scale = letterbox(image, 640)
    assert (square[0, :, :320] == np.array([30, 20, 10]).reshape(3, 1, 1)).all()
    assert (square[0, :, 320:] == 114).all()
    np.testing.assert_array_equal(scale, [640 / 600, 320 / 300])


@pytest.mark.parametrize("side", [640, 416])
def test_a_bare_head_is_decoded_on_its_grid(tmp_path: Path, side: int):
    detector = Yolox(bare_head(tmp_path / "raw.onnx", side=side))
    image = np.full((side * 3 // 4 * 2, side * 2, 3), 20, dtype=np.uint8)  # twice the square
    rectangle(image, 16 * 12, 16 * 20, 16, 16, BLUE)
    rectangle(image, 16 * 35, 16 * 14, 16, 16, BLUE)
    boxes = detector.boxes(image)
    # The cells of 8 pixels are full; those of 16 and 32 around them say the same a little less surely, and are dropped.
    expected = [(x * 16 + 8 - 96, y * 16 + 8 - 192, 192, 384) for x, y in ((35, 14), (12, 20))]
    np.testing.assert_allclose(boxes[:, :4], expected, atol=1e-3)  # single precision
    np.testing.assert_allclose(boxes[:, 4], 0.9, atol=1e-6)


def test_of_two_boxes_on_one_person_the_surer_one_stays(tmp_path: Path):
    image = np.full((640, 640, 3), 20, dtype=np.uint8)
    rectangle(image, 320, 320, 8, 8, BLUE)
    rectangle(image, 328, 320, 8, 6, BLUE)  # three quarters of the next cell: 88 of 96 columns in common
    path = bare_head(tmp_path / "raw.onnx")
    np.testing.assert_allclose(Yolox(path).boxes(image)[:, 0], [324 - 48], atol=1e-3)
    lenient = Yolox(path, max_overlap=0.95)
    np.testing.assert_allclose(lenient.boxes(image)[:, 4], [0.9, 0.675, 0.39375], atol=1e-5)


def test_another_class_of_a_bare_head_is_not_a_person(tmp_path: Path):
    image = np.full((640, 640, 3), 20, dtype=np.uint8)
    rectangle(image, 320, 320, 8, 8, BLUE)
    assert not len(Yolox(bare_head(tmp_path / "dog.onnx", label=16)).boxes(image))


def test_a_file_of_another_network_is_refused_with_what_is_expected_and_found(tmp_path: Path):
    image = ("images", [1, 3, 640, 640])
    cases = {
        "two inputs": ([image, ("scale", [1])], [("output", [1, 8400, 85])], "scale"),
        "nhwc": ([("images", [1, 640, 640, 3])], [("output", [1, 8400, 85])], r"\[1, 640, 640, 3\]"),
        "other grid": ([image], [("output", [1, 100, 85])], r"8400.*\[1, 100, 85\]"),
        "no classes": ([image], [("output", [1, 8400, 5])], r"8400, 5 \+ classes.*\[1, 8400, 5\]"),
        "no confidence": ([image], [("dets", [1, 7, 4]), ("labels", [1, 7])], r"5\].*\[1, 7, 4\]"),
        "labels of others": ([image], [("dets", [1, 7, 5]), ("labels", [1, 3])], r"labels.*\[1, 3\]"),
    }
    for name, (inputs, outputs, message) in cases.items():
        path = tiny.nothing(tmp_path / f"{name}.onnx", inputs, outputs)
        with pytest.raises(ValueError, match=rf"{name}\.onnx is another network.*{message}"):
            Yolox(path)


def test_bad_files_and_images(tmp_path: Path, exported: Yolox):
    with pytest.raises(OSError, match=r"missing\.onnx"):
        Yolox(tmp_path / "missing.onnx")
    (tmp_path / "text.onnx").write_text("no network")
    with pytest.raises(ValueError, match=r"text\.onnx"):
        Yolox(tmp_path / "text.onnx")
    for image in (np.zeros((10, 10), np.uint8), np.zeros((10, 10, 4), np.uint8), np.zeros((10, 10, 3))):
        with pytest.raises(ValueError, match="uint8"):
            exported.boxes(image)


def test_the_name_tells_files_and_settings_apart(tmp_path: Path):
    path = tiny.yolox(tmp_path / "a.onnx")
    names = [Yolox(path).name, Yolox(path, min_confidence=0.5).name]
    tiny.yolox(path, confidence=(0.7, 0.7))
    names.append(Yolox(path).name)
    assert len(set(names)) == 3
