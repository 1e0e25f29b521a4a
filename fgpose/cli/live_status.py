"""How a live system is doing, in a line of the terminal."""

from __future__ import annotations

import logging
from collections import Counter
from types import TracebackType
from typing import TYPE_CHECKING

from fgpose.live.frame import CameraState, LiveFrame

if TYPE_CHECKING:
    from rich.console import Console

_EVERY_S = 0.5


class StatusLine:
    """A consumer of frames, while it is open. There is no line where the console is no terminal."""

    def __init__(self, console: Console) -> None:
        self._status = console.status("", refresh_per_second=2 / _EVERY_S)
        self._said_s = 0.0
        self._n_frames = 0

    def publish(self, frame: LiveFrame) -> None:
        """Count the frame, and say from time to time what frames say."""
        self._n_frames += 1
        elapsed_s = frame.published_s - self._said_s
        if elapsed_s >= _EVERY_S:
            self._status.update(in_words(frame, self._n_frames / elapsed_s))
            self._said_s, self._n_frames = frame.published_s, 0

    def __enter__(self) -> StatusLine:
        self._status.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._status.stop()


class ConsoleLog(logging.Handler):
    """Prints what is logged above the line."""

    def __init__(self, console: Console) -> None:
        super().__init__()
        self._console = console

    def emit(self, record: logging.LogRecord) -> None:
        self._console.print(self.format(record), soft_wrap=True)


def in_words(frame: LiveFrame, rate_hz: float) -> str:
    """A line on people, cameras, frames and their age."""
    n_people, n_cameras = len(frame.people), len(frame.cameras)
    states = Counter(camera.state for camera in frame.cameras)
    cameras = f"{states[CameraState.OK]} of {n_cameras} cameras ok"
    others = [f"{camera.name} {camera.state.value}" for camera in frame.cameras if camera.state is not CameraState.OK]
    age = f", {1e3 * frame.age_s:.0f} ms old" if any(camera.n_used for camera in frame.cameras) else ""
    return " · ".join(
        [
            "1 person" if n_people == 1 else f"{n_people} people",
            f"{cameras} ({', '.join(others)})" if others else cameras,
            f"{rate_hz:.0f} frames/s{age}",
            f"{frame.observed_share:.0%} of the volume observed",
        ]
    )
