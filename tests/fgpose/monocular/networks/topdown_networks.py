"""Tiny ONNX networks with the signatures of the real ones. They find discs and rectangles by their exact colour.

So they answer rightly wherever a thing is, but only if channel order, range, normalisation and resizing are right.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from fgpose.geometry.camera import Camera

FLOAT, FLOAT16, INT64 = TensorProto.FLOAT, TensorProto.FLOAT16, TensorProto.INT64
# The colours of joints: 26 that differ by 100 in a channel. Those of people and of anything else lie between them.
_LEVELS = (30, 130, 230)
JOINT_COLOURS = np.array([(r, g, b) for r in _LEVELS for g in _LEVELS for b in _LEVELS if {r, g, b} != {130}])
PERSON_COLOURS = np.array([(80, 80, 180), (180, 80, 80)])


class Graph:
    """Puts a network together, operator by operator."""

    def __init__(self) -> None:
        self._nodes: list[onnx.NodeProto] = []
        self._constants: list[onnx.TensorProto] = []

    def constant(self, value: Any, dtype: Any = np.float32) -> str:
        name = f"constant_{len(self._constants)}"
        self._constants.append(numpy_helper.from_array(np.asarray(value, dtype=dtype), name))
        return name

    def integers(self, *values: int) -> str:
        return self.constant(values, np.int64)

    def op(self, kind: str, *inputs: str, output: str = "", **attributes: Any) -> str:
        output = output or f"value_{len(self._nodes)}"
        self._nodes.append(helper.make_node(kind, inputs, [output], **attributes))
        return output

    def save(self, path: Path, inputs: Sequence[tuple[str, int, Any]], outputs: Sequence[tuple[str, int, Any]]) -> Path:
        """inputs and outputs: name, element type and shape."""
        graph = helper.make_graph(
            self._nodes,
            "tiny",
            [helper.make_tensor_value_info(*each) for each in inputs],
            [helper.make_tensor_value_info(*each) for each in outputs],
            self._constants,
        )
        onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
        return path


def match(graph: Graph, image: str, colours: np.ndarray, tolerance: float) -> str:
    """[N, 3, H, W] and (K, 3) -> [N, K, H, W]: 1 where a pixel has the colour, 0 from the tolerance on."""
    wanted = graph.constant(colours.reshape(1, -1, 3, 1, 1))
    apart = graph.op("Abs", graph.op("Sub", graph.op("Unsqueeze", image, graph.integers(1)), wanted))
    apart = graph.op("ReduceSum", apart, graph.integers(2), keepdims=0)
    return graph.op(
        "Relu", graph.op("Sub", graph.constant(1.0), graph.op("Div", apart, graph.constant(float(tolerance))))
    )


def middle(graph: Graph, matched: str, axis: int, length: int) -> str:
    """[N, K, H, W] -> [N, K]: where along an axis the colour has its middle, in pixels; near 0 where it is nowhere."""
    places = graph.constant(np.arange(length).reshape((1, 1, length, 1) if axis == 2 else (1, 1, 1, length)))
    moment = graph.op("ReduceSum", graph.op("Mul", matched, places), graph.integers(2, 3), keepdims=0)
    mass = graph.op("ReduceSum", matched, graph.integers(2, 3), keepdims=0)
    return graph.op("Div", moment, graph.op("Add", mass, graph.constant(1e-6)))


def histogram(graph: Graph, matched: str, axis: int, length: int, heights: np.ndarray) -> str:
    """[N, K, H, W] -> [N, K, 2 length]: a bell at the middle of the colour, with this height; 0 without it."""
    there = graph.op("Mul", graph.op("ReduceMax", matched, axes=[2, 3], keepdims=0), graph.constant(heights[None]))
    center = graph.op("Unsqueeze", middle(graph, matched, axis, length), graph.integers(2))
    beside = graph.op("Sub", center, graph.constant(np.arange(2 * length)[None, None] / 2))
    beside = graph.op("Div", beside, graph.constant(6.0))
    bell = graph.op("Exp", graph.op("Neg", graph.op("Mul", beside, beside)))
    return graph.op("Mul", bell, graph.op("Unsqueeze", there, graph.integers(2)))


def for_each(graph: Graph, image: str, value: np.ndarray) -> str:
    """A constant (1, ...) of three axes -> [N, ...], once for each of N images."""
    nothing = graph.op("ReduceSum", image, graph.integers(1, 2), keepdims=0)
    nothing = graph.op("Mul", graph.op("ReduceSum", nothing, graph.integers(1), keepdims=1), graph.constant(0.0))
    return graph.op("Add", graph.constant(value), graph.op("Unsqueeze", nothing, graph.integers(2)))


def simcc(
    path: Path,
    n_keypoints: int = 17,
    size: tuple[int, int] = (192, 256),
    heights: float | np.ndarray = 0.9,
    batch: int | str = "batch",
    depth_bins: np.ndarray | None = None,
    names: Sequence[str] = ("input", "simcc_x", "simcc_y", "simcc_z"),
) -> Path:
    """RTMPose: finds the discs of JOINT_COLOURS; or, with a bin of depth for each keypoint, RTMW3D."""
    graph, (width, height), n_colours = Graph(), size, min(n_keypoints, 17 if depth_bins is not None else 26)
    # What mmpose's configuration says.
    mean, deviation = np.array([123.675, 116.28, 103.53]), np.array([58.395, 57.12, 57.375])
    normalised = (JOINT_COLOURS[:n_colours] - mean) / deviation
    matched = match(graph, names[0], normalised, 0.2)
    peaks = np.broadcast_to(heights, n_colours).astype(np.float32)
    for name, axis, length in ((names[1], 3, width), (names[2], 2, height)):
        rest = for_each(graph, names[0], np.zeros((1, n_keypoints - n_colours, 2 * length)))
        graph.op("Concat", histogram(graph, matched, axis, length, peaks), rest, axis=1, output=name)
    lengths = zip(names[1:3], (2 * width, 2 * height), strict=True)
    outputs = [(name, FLOAT, [batch, n_keypoints, n]) for name, n in lengths]
    if depth_bins is not None:
        graph.op("Identity", for_each(graph, names[0], np.eye(576)[None, depth_bins]), output=names[3])
        outputs.append((names[3], FLOAT, [batch, n_keypoints, 576]))
    return graph.save(path, [(names[0], FLOAT, [batch, 3, height, width])], outputs)


def yolox(
    path: Path,
    colours: np.ndarray = PERSON_COLOURS,
    confidence: Sequence[float] = (0.8, 0.9),
    labels: Sequence[int] = (0, 0),
    side: int | str = 640,
) -> Path:
    """YOLOX as mmdeploy exports it: the box of each rectangle of these colours, which are RGB."""
    graph = Graph()
    matched = match(graph, "input", colours[:, ::-1], 40.0)
    edges = []
    for axis in (2, 3):
        inside = graph.op("Greater", graph.op("ReduceMax", matched, axes=[axis], keepdims=0), graph.constant(0.4))
        inside = graph.op("Cast", inside, to=FLOAT)
        first, last = (graph.op("ArgMax", inside, axis=2, keepdims=1, select_last_index=at) for at in (0, 1))
        edges.append([graph.op("Cast", each, to=FLOAT) for each in (first, last)])
    (left, right), (top, bottom) = edges
    right, bottom = (graph.op("Add", edge, graph.constant(1.0)) for edge in (right, bottom))
    there = graph.op("ReduceMax", matched, axes=[2, 3], keepdims=0)
    score = graph.op("Mul", there, graph.constant([confidence]))
    score = graph.op("Unsqueeze", score, graph.integers(2))
    graph.op("Concat", left, top, right, bottom, score, axis=2, output="dets")
    graph.op("Identity", graph.constant([labels], np.int64), output="labels")
    outputs = [("dets", FLOAT, ["batch", "n", 5]), ("labels", INT64, ["batch", "n"])]
    return graph.save(path, [("input", FLOAT, ["batch", 3, side, side])], outputs)


def nothing(path: Path, inputs: Sequence[tuple[str, Any]], outputs: Sequence[tuple[str, Any]]) -> Path:
    """A network of zeros with these inputs and outputs: name and shape."""
    graph = Graph()
    for name, _ in inputs:
        graph.op("Identity", name)
    for name, shape in outputs:
        graph.op("Identity", graph.constant(np.zeros(shape)), output=name)
    return graph.save(path, [(n, FLOAT, s) for n, s in inputs], [(n, FLOAT, s) for n, s in outputs])


def camera(size_px: tuple[int, int] = (960, 720), distortion: Sequence[float] = (-0.2, 0.06, 0.001, -0.002)) -> Camera:
    """With a lens, a little off its middle; its frame is the world's."""
    K = np.array([[900.0, 0, size_px[0] / 2 + 6], [0, 910.0, size_px[1] / 2 - 4], [0, 0, 1]])
    return Camera("cam_1", size_px, K, np.eye(4), np.array(distortion))


def discs(image: np.ndarray, points_px: np.ndarray, colours: np.ndarray, radius_px: float) -> None:
    """Draw a disc of each colour, its centre where it belongs to a sixteenth of a pixel."""
    for (x, y), colour in zip(points_px, colours.tolist(), strict=True):
        if np.isfinite((x, y)).all():
            center = round(x * 16), round(y * 16)
            cv2.circle(image, center, round(radius_px * 16), colour, -1, cv2.LINE_AA, shift=4)


class Boxes:
    """A person detector that knows the boxes of each image, and counts how often it is asked."""

    name = "known boxes"

    def __init__(self, *boxes: Sequence[Sequence[float]]) -> None:
        self._boxes, self.n_asked = boxes, 0

    def boxes(self, image: np.ndarray) -> np.ndarray:
        found = self._boxes[min(self.n_asked, len(self._boxes) - 1)]
        self.n_asked += 1
        return np.array(found, dtype=float).reshape(-1, 5)
