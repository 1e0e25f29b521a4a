"""Small videos of a noisy scene with something that moves."""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np

SIZE_PX = (160, 120)
# H.264 without B-frames and with a key frame a second, as cameras send it.
_CODEC_OPTIONS = {"libx264": {"tune": "zerolatency", "preset": "ultrafast", "g": "30"}}
SMOOTHED = {"preset": "fast"}
"""Options with which the edges of blocks are smoothed, as most cameras do."""


def room(size_px: tuple[int, int] = SIZE_PX, seed: int = 0) -> np.ndarray:
    """(H, W, 3) RGB: rectangles of all brightnesses, which have places."""
    rng = np.random.default_rng(seed)
    picture = np.full((size_px[1], size_px[0], 3), 90, np.uint8)
    for _ in range(60):
        x, y = rng.integers(0, size_px)
        width, height = rng.integers(4, size_px[0] // 4, 2)
        picture[y : y + height, x : x + width] = rng.integers(20, 236)
    return picture


@cache
def _noise(shape: tuple[int, int], sigma: float) -> np.ndarray:
    """More rows than a picture: a part of it at random is new noise, for less time than drawing it."""
    return np.random.default_rng(99).normal(0, sigma, (shape[0] + 500, shape[1])).round().astype(np.int16)


def noisy(picture: np.ndarray, rng: np.random.Generator, sigma: float = 3.0) -> np.ndarray:
    """The picture with the noise of a sensor."""
    first = int(rng.integers(500))
    noise = _noise((picture.shape[0], picture.shape[1]), sigma)[first : first + picture.shape[0], :, None]
    return np.clip(picture + noise, 0, 255).astype(np.uint8)


def pictures(n: int, size_px: tuple[int, int] = SIZE_PX, seed: int = 0) -> list[np.ndarray]:
    """A room through which somebody walks; the brightness of the lower left corner, times 10, counts the images."""
    rng = np.random.default_rng(seed)
    scene = room(size_px, seed)
    frames = []
    for k in range(n):
        frame = noisy(scene, rng)
        x = 40 + 2 * k % (size_px[0] - 60)
        frame[30:100, x : x + 12] = 200
        frame[-16:, :16] = 10 * (k % 25)
        frames.append(frame)
    return frames


def counted(picture: np.ndarray) -> int:
    """Which image this is, see pictures."""
    return round(float(picture[-12:-4, 4:12].mean()) / 10)


def write_video(
    path: Path, frames: list[np.ndarray], fps: int = 30, codec: str = "libx264", options: dict[str, str] | None = None
) -> Path:
    """Write a video with PyAV."""
    import av

    height, width = frames[0].shape[:2]
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=fps, options=_CODEC_OPTIONS.get(codec, {}) | (options or {}))
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height = width, height
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.time_base = Fraction(1, fps)
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())
    return path
