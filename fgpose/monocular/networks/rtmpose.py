"""RTMPose: 2D joints of people in the boxes of a detector (Jiang et al. 2023, "RTMPose"), and networks like it, which
answer with one histogram per joint and axis (Li et al. 2022, "SimCC").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32, UInt8

from fgpose.geometry.camera import Camera
from fgpose.geometry.per_view.absolute_pose import AbsolutePose
from fgpose.io.skeletons import load_skeleton
from fgpose.monocular.network import Image, People
from fgpose.monocular.networks.batches import Batches
from fgpose.monocular.networks.devices import Device
from fgpose.monocular.networks.sessions import Shape, check_signature, identity, open_session
from fgpose.monocular.networks.topdown import Box, Boxes, PersonDetector, TopDown, TopDownTracker, by_order
from fgpose.monocular.networks.yolox import person_detector

# As mmpose trains these networks: bins of the histograms, size of the crop over that of the box, and mean and standard
# deviation of ImageNet, RGB.
_BINS_PER_PIXEL = 2
_PADDING = 1.25
_MEAN = np.array([123.675, 116.28, 103.53], dtype=np.float32)
_STANDARD_DEVIATION = np.array([58.395, 57.12, 57.375], dtype=np.float32)
_SKELETONS = {17: "coco_17", 26: "halpe_26"}  # by the number of keypoints


@dataclass(frozen=True)
class BoxCrop:
    """An upright rectangle of an image with the proportions of a network's input. It may reach beyond the image."""

    center_px: tuple[float, float]
    scale: float
    """Pixels of the image per pixel of the crop."""
    size: tuple[int, int]
    """Width and height of the crop."""

    @staticmethod
    def around(box: Box, size: tuple[int, int]) -> BoxCrop:
        """The rectangle that holds a box (left, top, width, height, ...) enlarged by a quarter."""
        left, top, width, height = box[:4].tolist()
        scale = _PADDING * max(width / size[0], height / size[1])
        return BoxCrop((left + width / 2, top + height / 2), scale, size)

    def of(self, image: Image) -> UInt8[np.ndarray, "crop_height crop_width 3"]:
        """What the rectangle shows, bilinear, black beyond the image."""
        import cv2

        offset = np.divide(self.size, 2) - np.divide(self.center_px, self.scale)
        crop_T_image = np.column_stack([np.eye(2) / self.scale, offset])
        return cv2.warpAffine(image, crop_T_image, self.size, flags=cv2.INTER_LINEAR)

    def to_image(self, points_crop: Float[np.ndarray, "*points 2"]) -> Float[np.ndarray, "*points 2"]:
        """Pixels of the image of points in the crop."""
        return (points_crop - np.divide(self.size, 2)) * self.scale + self.center_px


@dataclass(frozen=True, eq=False)
class SimccPose:
    """The keypoints of one person."""

    points2d_px: Float[np.ndarray, "keypoint 2"]
    """Pixels of the original image; NaN where no bin is above 0."""
    confidence: Float[np.ndarray, " keypoint"]
    """The lower of the peaks of x and y, in [0, 1]. A network is trained to put a peak of 1 where it is certain, and
    may answer a little more."""
    depth: Float[np.ndarray, " keypoint"]
    """Of a third axis, from -1 (near) to 1 (far) in units of its range; NaN without one or where points2d_px is."""


class SimccNetwork:
    """A network from crops to keypoints: [1, 3, H, W] -> [1, K, 2 W], [1, K, 2 H] and perhaps [1, K, D].

    Raises:
        OSError: there is no such file.
        ValueError: the file has other inputs or outputs; the message names it, what is expected and what is there.
    """

    def __init__(self, path: Path, axes: tuple[str, ...], threads: int = 1, device: Device = "auto") -> None:
        """axes: the outputs in their order; the names that the file gives them do not matter."""
        self._session = open_session(path, threads, device)
        self._path, self._axes = path, axes
        self.size = self._checked_size()
        self._input = self._session.get_inputs()[0].name
        self.n_keypoints = self._checked_answer()
        self._batches = Batches(self._session, {self._input: self._noise()})
        self.name = identity(path, self._session)

    def poses(self, image: Image, boxes: Boxes) -> list[SimccPose]:
        """The people in the boxes of an image, one box at least."""
        crops = [BoxCrop.around(box, self.size) for box in boxes]
        shown = np.stack([((crop.of(image) - _MEAN) / _STANDARD_DEVIATION).transpose(2, 0, 1) for crop in crops])
        answers = zip(*self._batches.run({self._input: shown}), strict=True)
        return [self._pose(crop, histograms) for crop, histograms in zip(crops, answers, strict=True)]

    def _pose(self, crop: BoxCrop, histograms: Sequence[Float32[np.ndarray, "keypoint _"]]) -> SimccPose:
        """histograms: of each axis."""
        peaks = [_peak(histogram.astype(float)) for histogram in histograms]
        (x, height_x), (y, height_y) = peaks[:2]
        lower = np.minimum(height_x, height_y)
        confidence = np.where(lower > 0, np.minimum(lower, 1.0), 0.0)
        points2d_px = crop.to_image(np.stack([x, y], axis=-1) * self.size)
        depth = 2 * peaks[2][0] - 1 if len(peaks) > 2 else np.full(len(x), np.nan)
        known = confidence > 0
        return SimccPose(np.where(known[:, None], points2d_px, np.nan), confidence, np.where(known, depth, np.nan))

    def _noise(self) -> Float32[np.ndarray, "2 3 crop_height crop_width"]:
        width, height = self.size
        return np.random.default_rng(0).standard_normal((2, 3, height, width), dtype=np.float32)

    def _checked_size(self) -> tuple[int, int]:
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        shape = inputs[0].shape if inputs and len(inputs[0].shape) == 4 else [None] * 4
        expected: dict[str, Shape] = {"input": (1, 3, *shape[2:])}
        histograms: dict[str, Shape] = dict.fromkeys(self._axes, (1, None, None))
        check_signature(self._session, self._path, by_order(inputs, expected), by_order(outputs, histograms))
        names = [node.name for node in outputs]
        if names[0].casefold().endswith("y") and names[1].casefold().endswith("x"):
            # Of square crops nothing else would show it.
            raise ValueError(f"{self._path} gives {', '.join(names)} in this order: export it with x before y")
        height, width = shape[2:]
        if not isinstance(width, int) or not isinstance(height, int):
            raise ValueError(f"{self._path}: the size of the input is not in the file; export it with a fixed one")
        return width, height

    def _checked_answer(self) -> int:
        """Number of keypoints. An exporter need not write the lengths into the file, so the network is asked."""
        width, height = self.size
        found = [np.asarray(output).shape for output in self._session.run(None, {self._input: self._noise()[:1]})]
        n_keypoints = found[0][1]
        bins = (_BINS_PER_PIXEL * width, _BINS_PER_PIXEL * height)
        right = all(shape[1] == n_keypoints for shape in found) and (found[0][2], found[1][2]) == bins
        if len(found) != len(self._axes) or not right:
            expected = ", ".join(f"{axis} [1, K, {n}]" for axis, n in zip(self._axes, (*bins, "any"), strict=False))
            answers = ", ".join(str(list(shape)) for shape in found)
            raise ValueError(f"{self._path} is another network: expected {expected}, it answers {answers}")
        return n_keypoints


def _peak(
    histogram: Float[np.ndarray, "keypoint bin"],
) -> tuple[Float[np.ndarray, " keypoint"], Float[np.ndarray, " keypoint"]]:
    """Place of the highest bin as a share of the axis, and its height."""
    return histogram.argmax(axis=1) / histogram.shape[1], histogram.max(axis=1)


class RTMPose:
    """A Network that gives 2D joints only; its skeleton is coco_17 or halpe_26, by the number of its keypoints.

    Raises:
        OSError: there is no such file.
        ValueError: a file has other inputs or outputs, or another number of keypoints; the message names it.
    """

    def __init__(
        self,
        landmarks: Path,
        detector: Path | PersonDetector,
        *,
        threads: int = 1,
        device: Device = "auto",
        max_people: int = 4,
        detect_every_frame: bool = True,
    ) -> None:
        """
        Args:
            landmarks: an ONNX file as mmdeploy exports it: [1, 3, 256, 192] (or any other size) -> simcc_x [1, K, 384],
                simcc_y [1, K, 512], two bins per pixel.
            detector: an ONNX file of YOLOX, or a detector of your own.
            threads: how many threads one run may use.
            device: where the networks run.
            max_people: how many people are looked at in an image, the most confident first.
            detect_every_frame: False follows the joints from image to image, see TopDownTracker.
        """
        self._simcc = SimccNetwork(landmarks, ("simcc_x", "simcc_y"), threads, device)
        count = self._simcc.n_keypoints
        if count not in _SKELETONS:
            known = " or ".join(f"{n} ({name})" for n, name in _SKELETONS.items())
            raise ValueError(f"{landmarks} gives {count} keypoints; known are {known}")
        self.skeleton = load_skeleton(_SKELETONS[count])
        self._top_down = TopDown(person_detector(detector, threads, device), max_people, detect_every_frame)
        self.name = f"rtmpose {self._simcc.name}, {self._top_down.name}"

    def tracker(self, camera: Camera) -> TopDownTracker:
        """For the images of one camera, of which 2D joints need nothing but the image size."""
        return TopDownTracker(self._top_down, self._people, camera, self.skeleton.n_joints)

    def _people(self, image: Image, boxes: Boxes) -> People:
        poses = self._simcc.poses(image, boxes)
        in_3d = [AbsolutePose.missing(self.skeleton.n_joints, "")] * len(poses)
        return People.stacked(boxes, [pose.points2d_px for pose in poses], [pose.confidence for pose in poses], in_3d)
