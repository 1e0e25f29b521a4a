"""A consumer of frames that dies or hangs when it is told to, behind an output of the live system."""

from __future__ import annotations

import threading
import time
from typing import Literal

from fgpose.live.frame import LiveFrame
from fgpose.live.outputs import BackgroundOutput
from fgpose.live.outputs.frame_messages import encode_frame

ConsumerFault = Literal["consumer dies", "consumer hangs"]


class SimulatedConsumer:
    """Takes frames as messages. Outputs work in real time: a fault lasts until the output says so."""

    def __init__(self) -> None:
        self._fault: ConsumerFault | None = None
        self._well = threading.Event()
        self._well.set()
        self._since_s = 0.0
        self.output = BackgroundOutput("consumer", lambda: self)

    def send(self, frame: LiveFrame) -> None:
        """See Sink."""
        encode_frame(frame)
        if self._fault == "consumer dies":
            raise BrokenPipeError("dead")
        self._well.wait()

    def close(self) -> None:
        """See Sink."""

    def begin(self, fault: ConsumerFault) -> None:
        self._fault, self._since_s = fault, time.monotonic()
        if fault == "consumer hangs":
            self._well.clear()

    def end(self) -> None:
        self._fault, self._since_s = None, time.monotonic()
        self._well.set()

    @property
    def real_s(self) -> float:
        """Since the fault began or ended."""
        return time.monotonic() - self._since_s
