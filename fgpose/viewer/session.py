"""What every recording has, of one person or of several: pictures, viewers, an end. Does not import Rerun."""

from __future__ import annotations

from types import TracebackType
from typing import Literal, TypeVar

import numpy as np
from jaxtyping import UInt8

UpAxis = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
# typing.Self is refused by the checks of the tests.
_Opened = TypeVar("_Opened", bound="Session")


class Session:
    """An open recording; this one shows nothing."""

    viewer_url: str | None = None
    """Where a viewer connects (``rerun URL``) while a live recording is open."""

    def wants_image(self, camera: str, frame: int) -> bool:
        """Whether log_image would show the picture of a frame: ask before reading or converting one.

        Raises:
            ValueError: the camera is unknown.
        """
        return False

    def log_image(self, camera: str, frame: int, time_s: float, image: UInt8[np.ndarray, "height width 3"]) -> None:
        """Show one camera's picture, undistorted as its points are, shrunk and compressed; see open_recording.

        A picture beyond the limit of the recording is left out. The limit is divided among the cameras.

        Args:
            camera: its name in the rig.
            frame: number of the frame, counted from 0.
            time_s: its time.
            image: RGB, as the camera took it.

        Raises:
            ValueError: the camera is unknown, or the size of the picture differs from that of the calibration.
            OSError: the disk is full, or so slow that pictures would pile up in memory.
        """

    def flush(self) -> None:
        """Bring what was logged into the file. Raises OSError if that is not possible."""

    def close(self) -> None:
        """Write the rest and give the file its name. Closing again does nothing.

        Raises:
            OSError: the file could not be written to its end. None is left; of an endless recording, what could be
                written, as NAME_incomplete.rrd.
        """

    def discard(self) -> None:
        """Close without leaving a file; an older one of the same name stays as it was."""

    def __enter__(self: _Opened) -> _Opened:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        # Ctrl-C is how a live session ends: its file is kept.
        if kind is None or issubclass(kind, KeyboardInterrupt):
            self.close()
        else:
            self.discard()
