"""Tiny ONNX networks with BlazePose's published signatures and known answers: a person is a red square.

The detector finds red squares that fill a cell of its finest grid, the landmark network the middle of what is red.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from topdown_networks import FLOAT, Graph

from fgpose.monocular.networks.crops import Region

SIZE_PX = (336, 448)
"""Of the image: the detector sees every second pixel of it, between bars of 56 pixels of the image left and right."""
CELL_PX = 16
BAR_PX = 56
FULL, PALE = (255, 0, 0), (251, 0, 0)
LEAN_RAD = 0.4
"""Of every person found by the detector, clockwise."""
SIDE_PX = 150.0
"""Of the region around every person."""
SIDE_BOX_CROP_PX = 20.0
# The region is 1.25 times as wide as the circle, and a crop pixel of the detector is two of the image.
_RADIUS_CROP_PX = SIDE_PX / 1.25 / 2 / 2
HIP_OFFSET_CROP_PX = np.array([1.0, 2.0])

# Which joint is where around the middle of the red square, in pixels of the crop.
OFFSETS_CROP_PX = np.random.default_rng(7).uniform(-40, 40, (33, 2))
WORLD_M = np.random.default_rng(8).uniform(-0.8, 0.8, (33, 3))
VISIBILITY, PRESENCE = 0.9, 0.8
RED_OF_A_PERSON = 1000.0
"""Sum over the crop from which the landmark network is sure."""
SCORE = (CELL_PX * 256 / SIDE_PX) ** 2 / RED_OF_A_PERSON
"""Of a square of full red: 0.75."""


def logit(probability: float) -> float:
    return float(np.log(probability / (1 - probability)))


def cell_middle_px(column: float, row: float) -> np.ndarray:
    """Centre of the detector's anchor in the image: of a cell that begins at CELL_PX * column - BAR_PX."""
    return CELL_PX * (np.array([column, row]) + 0.5) - (BAR_PX, 0)


def scene(*people: tuple[float, float], colour: tuple[int, int, int] = FULL) -> np.ndarray:
    """An image with a red square in each of these cells (column, row). Between the cells no detector sees one."""
    image = np.zeros((SIZE_PX[1], SIZE_PX[0], 3), dtype=np.uint8)
    for column, row in people:
        left, top = round(CELL_PX * column) - BAR_PX, round(CELL_PX * row)
        image[top : top + CELL_PX, left : left + CELL_PX] = colour
    return image


def detector(path: Path, n_anchors: int = 2254) -> Path:
    """Logit 10 where a cell is red, 2.2 where it is pale red. Only the first of the two anchors of a cell answers."""
    graph = Graph()
    red = graph.op("Gather", "input_1", graph.constant(0, np.int64), axis=3)
    cells = graph.op("AveragePool", graph.op("Unsqueeze", red, graph.integers(1)), kernel_shape=[8, 8], strides=[8, 8])
    logits = graph.op("Mul", graph.op("Sub", cells, graph.constant(0.96)), graph.constant(250.0))
    first = graph.op("Reshape", logits, graph.integers(1, 784, 1))
    silent = graph.constant(np.full((1, 784, 1), -200.0))
    finest = graph.op("Reshape", graph.op("Concat", first, silent, axis=2), graph.integers(1, 1568, 1))
    rest = graph.constant(np.full((1, n_anchors - 1568, 1), -200.0))
    graph.op("Concat", finest, rest, axis=1, output="Identity_1")
    top = HIP_OFFSET_CROP_PX + _RADIUS_CROP_PX * np.array([np.sin(LEAN_RAD), -np.cos(LEAN_RAD)])
    box = [0.0, 0.0, SIDE_BOX_CROP_PX, SIDE_BOX_CROP_PX]
    row = [*box, *HIP_OFFSET_CROP_PX, *top, 0.0, 0.0, 0.0, 0.0]
    graph.op("Identity", graph.constant(np.tile(row, (1, n_anchors, 1))), output="Identity")
    outputs = [("Identity", FLOAT, [1, n_anchors, 12]), ("Identity_1", FLOAT, [1, n_anchors, 1])]
    return graph.save(path, [("input_1", FLOAT, [1, 224, 224, 3])], outputs)


def landmarks(
    path: Path,
    offsets_crop_px: np.ndarray = OFFSETS_CROP_PX,
    world_m: np.ndarray = WORLD_M,
    heatmaps: np.ndarray | None = None,
) -> Path:
    """Landmarks at fixed offsets from the middle of the red; the next region is centred there, its size the same.

    heatmaps: logits (64, 64, 39); by default they say nothing, so that the landmarks stay.
    """
    graph = Graph()
    red = graph.op("Gather", "input_1", graph.constant(0, np.int64), axis=3)
    total = graph.op("ReduceSum", red, graph.integers(1, 2), keepdims=0)
    moments = []
    for places in (np.arange(256).reshape(1, 1, 256), np.arange(256).reshape(1, 256, 1)):
        moment = graph.op("ReduceSum", graph.op("Mul", red, graph.constant(places)), graph.integers(1, 2), keepdims=0)
        mean = graph.op("Div", moment, graph.op("Add", total, graph.constant(1e-6)))
        moments.append(graph.op("Unsqueeze", mean, graph.integers(1)))
    which = np.zeros((2, 39, 5))
    which[0, :, 0] = which[1, :, 1] = 1.0
    moved = graph.op("MatMul", graph.op("Concat", *moments, axis=1), graph.constant(which.reshape(2, 195)))
    fixed = np.zeros((39, 5))
    fixed[:33, :2] = offsets_crop_px
    fixed[34, :2] = 0.0, -256 / 1.25 / 2
    fixed[:, 3], fixed[:, 4] = logit(VISIBILITY), logit(PRESENCE)
    graph.op("Add", moved, graph.constant(fixed.reshape(1, 195)), output="Identity")
    score = graph.op("Mul", total, graph.constant(1 / RED_OF_A_PERSON))
    score = graph.op("Clip", score, graph.constant(0.0), graph.constant(1.0))
    graph.op("Unsqueeze", score, graph.integers(1), output="Identity_1")
    silent = np.full((64, 64, 39), -20.0)
    graph.op("Identity", graph.constant((silent if heatmaps is None else heatmaps)[None]), output="Identity_3")
    world = np.zeros((39, 3))
    world[:33] = world_m
    graph.op("Identity", graph.constant(world.reshape(1, 117)), output="Identity_4")
    shapes = {"Identity": [1, 195], "Identity_1": [1, 1], "Identity_3": [1, 64, 64, 39], "Identity_4": [1, 117]}
    outputs = [(name, FLOAT, shape) for name, shape in shapes.items()]
    return graph.save(path, [("input_1", FLOAT, [1, 256, 256, 3])], outputs)


def detected_region(column: float, row: float) -> Region:
    """What the detector is to make of a square in this cell."""
    x, y = cell_middle_px(column, row) + 2 * HIP_OFFSET_CROP_PX
    return Region((float(x), float(y)), SIDE_PX, LEAN_RAD)


def square_middle_px(column: float, row: float) -> np.ndarray:
    """Middle of the pixels of a square, whose coordinates are those of their centres."""
    return cell_middle_px(column, row) - 0.5


def joints_px(column: float, row: float) -> np.ndarray:
    """Where the landmark network is to see the joints of a person in this cell."""
    return square_middle_px(column, row) + turned(OFFSETS_CROP_PX, LEAN_RAD) * SIDE_PX / 256


def turned(directions: np.ndarray, angle_rad: float) -> np.ndarray:
    """Directions (x right, y down) turned clockwise as one sees it; a third coordinate stays."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    x, y = directions[:, 0], directions[:, 1]
    return np.column_stack([cos * x - sin * y, sin * x + cos * y, directions[:, 2:]])
