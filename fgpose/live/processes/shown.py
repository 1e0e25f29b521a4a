"""Pictures to look at: small, and a few each second."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from jaxtyping import UInt8

# As large as a page or a viewer shows them; the longer side.
_SIZE_PX = 480
_INTERVAL_S = 0.3


class ShownPictures:
    """Scales some of the pictures of every camera down, and gives them on.

    Args:
        show: takes the name of the camera and the small picture, RGB.
    """

    def __init__(self, show: Callable[[str, np.ndarray], None]) -> None:
        self._show = show
        self._shown_s: dict[str, float] = {}

    def __call__(self, camera: str, picture_rgb: UInt8[np.ndarray, "height width 3"]) -> None:
        """A picture of a camera. Those of one camera come from one thread at a time."""
        now_s = time.monotonic()
        if now_s < self._shown_s.get(camera, -np.inf) + _INTERVAL_S:
            return
        self._shown_s[camera] = now_s
        import cv2

        height, width = picture_rgb.shape[:2]
        scale = min(1.0, _SIZE_PX / max(height, width))
        size_px = max(1, round(scale * width)), max(1, round(scale * height))
        self._show(camera, cv2.resize(picture_rgb, size_px, interpolation=cv2.INTER_AREA))
