"""What every source of images has."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol, runtime_checkable

from fgpose.live.cameras.image import SourceImage


class SourceError(Exception):
    """A source cannot be opened or read. The message names the camera and the source, without password.

    Args:
        camera: its name.
        source: as it may be shown.
        problem: in words.
    """

    def __init__(self, camera: str, source: str, problem: str) -> None:
        super().__init__(f"camera {camera}: {source}: {problem}")
        self.reason = f"{source}: {problem}"
        """The message without the name of the camera."""


@runtime_checkable
class ImageSource(Protocol):
    """Images of one camera. It is read and closed by one thread."""

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of its images."""
        ...

    @property
    def is_recording(self) -> bool:
        """It ends by itself; nothing is wrong then."""
        ...

    def images(self) -> Iterator[SourceImage]:
        """The images as they come. Raises SourceError if it cannot go on."""
        ...

    def hurry(self, late_s: float) -> None:
        """The image before was so late: if that lasts, leave some out."""
        ...

    def close(self) -> None:
        """Let go of the device or the connection."""
        ...
