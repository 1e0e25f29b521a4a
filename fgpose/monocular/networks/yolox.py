"""YOLOX: boxes of people (Ge et al. 2021, "YOLOX: Exceeding YOLO Series in 2021").

Two forms of file are known: with the suppression of double boxes inside, as mmdeploy exports it, and the bare head, as
the authors' own repository does. Both take raw BGR values, the image in the top left corner of a square of 114.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32

from fgpose.monocular.network import Image
from fgpose.monocular.networks.devices import Device
from fgpose.monocular.networks.sessions import check_signature, identity, open_session
from fgpose.monocular.networks.topdown import Boxes, PersonDetector, by_order, suppress, usable

# Of the published networks: usual side of the input, strides of their outputs, grey value beside the image.
_SIDE = 640
_STRIDES = (8, 16, 32)
_FILL = 114
_PERSON = 0  # of COCO's 80 classes, and the only one of networks trained on people alone


class Yolox:
    """A PersonDetector.

    Raises:
        OSError: there is no such file.
        ValueError: it is not a YOLOX network; the message says what is expected and what is there.
    """

    def __init__(
        self,
        path: Path,
        *,
        threads: int = 1,
        device: Device = "auto",
        min_confidence: float = 0.3,
        max_overlap: float = 0.45,
    ) -> None:
        """
        Args:
            path: an ONNX file: ``input`` [1, 3, 640, 640] -> ``dets`` [1, N, 5] (left, top, right, bottom, confidence)
                and ``labels`` [1, N], or ``images`` -> ``output`` [1, 8400, 5 + classes] without decoding. The names
                do not matter, and the side may be any multiple of 32.
            threads: how many threads one run may use.
            device: where it runs.
            min_confidence: less certain boxes are left out. The authors show boxes from 0.3 on.
            max_overlap: intersection over union of two boxes from which the less certain one is left out. Has no
                effect on a network that does so itself.
        """
        self._session = open_session(path, threads, device)
        self._min_confidence, self._max_overlap = min_confidence, max_overlap
        self._decodes = len(self._session.get_outputs()) > 1
        self._side = self._checked_side(path)
        self._input = self._session.get_inputs()[0].name
        self._check_answer(path)
        self.name = f"yolox {identity(path, self._session)} from {min_confidence:g} overlap {max_overlap:g}"

    def boxes(self, image: np.ndarray) -> Boxes:
        """The people in an image, the most confident first. Raises ValueError: not (height, width, 3) uint8."""
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or not image.size:
            raise ValueError(f"an image must be (height, width, 3) uint8, got {image.shape} {image.dtype}")
        squared, scale = letterbox(image, self._side)
        answer = self._run(squared)
        corners, confidence = _people(*answer) if self._decodes else _decoded(answer[0], self._side)
        low = corners[:, :2] / scale
        found = np.column_stack([low, corners[:, 2:] / scale - low, np.clip(confidence, 0, 1)])
        found = usable(found[confidence >= self._min_confidence])
        return found if self._decodes else found[suppress(found, self._max_overlap)]

    def _run(self, squared: Float32[np.ndarray, "1 3 side side"]) -> list[np.ndarray]:
        return [np.asarray(output) for output in self._session.run(None, {self._input: squared})]

    def _checked_side(self, path: Path) -> int:
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        side = inputs[0].shape[-1] if inputs and inputs[0].shape else None
        side = side if isinstance(side, int) and side % _STRIDES[-1] == 0 else _SIDE
        expected = {"dets": (1, None, 5)} if self._decodes else {"output": (1, _n_cells(side), None)}
        # The labels of dets are integers, which check_signature does not take; _check_answer checks them.
        named = by_order(outputs[:1], expected)
        check_signature(self._session, path, by_order(inputs, {"input": (1, 3, side, side)}), named)
        return side

    def _check_answer(self, path: Path) -> None:
        # An exporter need not write the lengths of the outputs into the file, so the network itself is asked.
        answer = self._run(np.full((1, 3, self._side, self._side), _FILL, dtype=np.float32))
        shapes = [output.shape for output in answer]
        if self._decodes:
            expected = "dets [1, N, 5] and labels [1, N]"
            right = len(shapes) == 2 and shapes[0] == (*shapes[1], 5)
        else:
            expected = f"[1, {_n_cells(self._side)}, 5 + classes]"
            right = len(shapes[0]) == 3 and shapes[0][1] == _n_cells(self._side) and shapes[0][2] > 5
        if not right:
            found = " and ".join(str(list(shape)) for shape in shapes)
            raise ValueError(f"{path} is another network: YOLOX answers {expected}, this one {found}")


def person_detector(detector: Path | PersonDetector, threads: int, device: Device) -> PersonDetector:
    """The YOLOX network of a file, or a detector of one's own."""
    return Yolox(detector, threads=threads, device=device) if isinstance(detector, Path) else detector


def letterbox(image: Image, side: int) -> tuple[Float32[np.ndarray, "1 3 side side"], Float[np.ndarray, " 2"]]:
    """The image in the top left corner of a square, BGR, and its pixels there per pixel of its own, x and y."""
    import cv2

    height, width = image.shape[:2]
    ratio = side / max(height, width)
    size = max(int(width * ratio), 1), max(int(height * ratio), 1)
    square = np.full((side, side, 3), _FILL, dtype=np.uint8)
    square[: size[1], : size[0]] = cv2.resize(image, size, interpolation=cv2.INTER_LINEAR)[..., ::-1]
    return square.transpose(2, 0, 1)[None].astype(np.float32), np.divide(size, (width, height))


def _people(dets: np.ndarray, labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    found = dets[0][labels[0] == _PERSON].astype(float)
    return found[:, :4], found[:, 4]


def _decoded(
    raw: Float[np.ndarray, "1 cell values"], side: int
) -> tuple[Float[np.ndarray, "cell 4"], Float[np.ndarray, " cell"]]:
    """Corners and confidence of the person in each cell, in pixels of the square.

    A cell's box has its centre at (x, y) + offset and the size exp(w, h), both in strides.
    """
    cells, strides = _grid(side)
    values = raw[0].astype(float)
    center = (values[:, :2] + cells) * strides
    with np.errstate(over="ignore"):  # the numbers of an empty cell mean nothing and may overflow
        half = np.exp(values[:, 2:4]) * strides / 2
    return np.concatenate([center - half, center + half], axis=1), values[:, 4] * values[:, 5 + _PERSON]


def _n_cells(side: int) -> int:
    return sum((side // stride) ** 2 for stride in _STRIDES)


def _grid(side: int) -> tuple[Float[np.ndarray, "cell 2"], Float[np.ndarray, "cell 1"]]:
    """Column and row of every cell, the finest stride first, and its stride."""
    cells, strides = [], []
    for stride in _STRIDES:
        n = side // stride
        rows, columns = np.mgrid[:n, :n].astype(float)
        cells.append(np.stack([columns, rows], axis=-1).reshape(-1, 2))
        strides.append(np.full((n * n, 1), float(stride)))
    return np.concatenate(cells), np.concatenate(strides)
