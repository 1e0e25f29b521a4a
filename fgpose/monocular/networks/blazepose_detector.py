"""The person detector of BlazePose: where a person stands, and how the square around the whole body is turned.

Bazarevsky et al., BlazePose: On-device Real-time Body Pose Tracking, 2020; decoding as in MediaPipe's pose_detection.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Float

from fgpose.monocular.network import Image
from fgpose.monocular.networks.crops import Region
from fgpose.monocular.networks.devices import Device
from fgpose.monocular.networks.sessions import check_signature, identity, open_session

# Of the network: side of its input, and what it gives for each anchor.
_SIZE = 224
_INPUTS = {"input_1": (None, _SIZE, _SIZE, 3)}
_OUTPUTS = {"Identity": (None, 2254, 12), "Identity_1": (None, 2254, 1)}
# Cells of each stride, in crop pixels, and how many anchors lie at the centre of each cell.
_ANCHORS = ((8, 2), (16, 2), (32, 6))
_MIN_SCORE = 0.5  # as in MediaPipe
_MAX_OVERLAP = 0.3
"""Boxes of one person overlap more than this. They span head and upper torso, so even neighbours overlap less."""
_MAX_LOGIT = 100.0  # exp() does not overflow, and the score is 0 or 1 long before
# Rows of a decoded detection: two corners of the box, then four keypoints.
_MID_HIP, _BODY_CIRCLE = 2, 3
BODY_SCALE = 1.25
"""Side of the region of interest over the diameter of the circle around the body, as the network was trained."""


class BlazePoseDetector:
    """Finds people anywhere in an image. Its session may be used from several threads.

    Raises:
        OSError: there is no such file.
        ValueError: it is not the ONNX network of BlazePose's person detector.
    """

    def __init__(self, path: Path, threads: int = 1, device: Device = "auto") -> None:
        self._session = open_session(path, threads, device)
        check_signature(self._session, path, _INPUTS, _OUTPUTS)
        self.name = identity(path, self._session)

    def detect(self, image: Image) -> list[Region]:
        """The square around each person's whole body, upright along the trunk; the most confident first."""
        letterbox = Region.whole((image.shape[1], image.shape[0]))
        pixels = letterbox.crop(image, _SIZE, border="black").astype(np.float32) / 127.5 - 1
        raw, logits = self._session.run(list(_OUTPUTS), {"input_1": pixels[None]})
        found, scores = _decode(np.asarray(raw)[0], np.asarray(logits)[0, :, 0])
        points_px = letterbox.to_image(_merge(found, scores), _SIZE)
        regions = [Region.around(points[_MID_HIP], points[_BODY_CIRCLE], BODY_SCALE) for points in points_px]
        return [region for region in regions if region.side_px >= 1]


@cache
def _anchors() -> Float[np.ndarray, "anchor 2"]:
    """Centres of all anchors in crop pixels, in the order of the outputs: row by row, all of a cell together."""
    centers = []
    for stride, per_cell in _ANCHORS:
        along = stride * (np.arange(_SIZE // stride) + 0.5)
        grid = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
        centers.append(np.repeat(grid, per_cell, axis=0))
    return np.concatenate(centers)


def _decode(
    raw: Float[np.ndarray, "anchor 12"], logits: Float[np.ndarray, " anchor"]
) -> tuple[Float[np.ndarray, "detection 6 2"], Float[np.ndarray, " detection"]]:
    """Corners of the box and keypoints in crop pixels, and scores, of the anchors that see a person; the best first."""
    scores = 1 / (1 + np.exp(-np.clip(logits.astype(float), -_MAX_LOGIT, _MAX_LOGIT)))
    best = np.argsort(-scores, kind="stable")
    kept = best[scores[best] >= _MIN_SCORE]
    center, size, *keypoints = raw[kept].astype(float).reshape(-1, 6, 2).swapaxes(0, 1)
    points = np.stack([center - size / 2, center + size / 2, *keypoints], axis=1)
    return points + _anchors()[kept, None], scores[kept]


def _merge(
    found: Float[np.ndarray, "detection 6 2"], scores: Float[np.ndarray, " detection"]
) -> Float[np.ndarray, "person 6 2"]:
    """One detection per person: the average of those that overlap, weighted by score (weighted NMS)."""
    people = []
    while len(found):
        same = _overlap(found[0], found) > _MAX_OVERLAP
        same[0] = True  # a box without an area overlaps not even itself
        people.append(np.average(found[same], axis=0, weights=scores[same]))
        found, scores = found[~same], scores[~same]
    return np.array(people).reshape(-1, 6, 2)


def _overlap(
    one: Float[np.ndarray, "6 2"], many: Float[np.ndarray, "detection 6 2"]
) -> Float[np.ndarray, " detection"]:
    """Intersection over union of boxes."""
    shared = np.prod(np.clip(np.minimum(one[1], many[:, 1]) - np.maximum(one[0], many[:, 0]), 0, None), axis=1)
    union = np.prod(one[1] - one[0]) + np.prod(many[:, 1] - many[:, 0], axis=1) - shared
    return shared / np.maximum(union, 1e-9)
