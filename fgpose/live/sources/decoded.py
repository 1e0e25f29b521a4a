"""Frames of PyAV as pictures and as times."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import av

# 8-bit formats whose first plane is the brightness of each pixel.
_WITH_LUMA = ("yuv420p", "yuvj420p", "yuv422p", "yuvj422p", "yuv444p", "yuvj444p", "nv12", "nv21", "gray")


@dataclass(frozen=True, eq=False)
class DecodedPicture:
    """A frame as it left the decoder."""

    frame: av.VideoFrame

    @property
    def size_px(self) -> tuple[int, int]:
        width, height = self.frame.width, self.frame.height
        return (height, width) if self.frame.rotation % 180 else (width, height)

    def rgb(self) -> np.ndarray:
        picture = self.frame.to_ndarray(format="rgb24")
        turns = round(self.frame.rotation / 90)
        return np.ascontiguousarray(np.rot90(picture, turns)) if turns else picture

    def luma(self) -> np.ndarray:
        if self.frame.format.name not in _WITH_LUMA:
            return self.frame.to_ndarray(format="gray")
        plane = self.frame.planes[0]
        return np.frombuffer(memoryview(plane), np.uint8).reshape(plane.height, plane.line_size)[:, : plane.width]


def sender_s(packet: av.Packet) -> float | None:
    """Unix time of a packet by the clock of its sender (RTCP); None if it does not say."""
    if not packet.has_sidedata("prft"):
        return None
    # AVProducerReferenceTime begins with microseconds since 1970.
    return struct.unpack_from("=q", bytes(packet.get_sidedata("prft")))[0] / 1e6
