"""Keypoints that stand still: a detector that sends what it found last, or whose images have stopped."""

from __future__ import annotations

import numpy as np

from fgpose.finding import Code
from fgpose.people_observations import Detections

# Somebody who stands still moves by fractions of a pixel, and so does noise: no network gives the same numbers twice.
# One that looks at every second or third image only may send them again.
_LASTS_S, _LASTS_IMAGES = 1.0, 5
REASON = f"the same keypoints again and again [{Code.FROZEN_CAMERA}]"


class FrozenKeypoints:
    """Follows the detections of one camera. Nobody, image after image, is nothing that is frozen."""

    def __init__(self) -> None:
        self._last: Detections | None = None
        self._since_s = -np.inf
        self._n_same = 0

    def add(self, detections: Detections, arrived_s: float) -> bool:
        """Whether they have been the same for long."""
        last, self._last = self._last, detections
        if last is None or not are_same(last, detections):
            self._since_s, self._n_same = arrived_s, 0
            return False
        self._n_same += 1
        return self._n_same >= _LASTS_IMAGES and arrived_s - self._since_s > _LASTS_S


def are_same(a: Detections, b: Detections) -> bool:
    """Whether two images show the same people at the same pixels: the later one tells nothing new of them."""
    # Of bytes, as there is one NaN only: this is asked for every image.
    return a.points2d_px.tobytes() == b.points2d_px.tobytes() and bool(np.isfinite(a.points2d_px).any())
