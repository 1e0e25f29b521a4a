"""A live system that runs until a test has seen enough, however long a busy computer takes."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from fgpose.live.frame import LiveFrame
from fgpose.live.system import LiveSystem

# Then something else is wrong, and the test says what it has not seen. A twentieth of a core is enough for it.
_LONGEST_S = 600.0


class _Watch:
    def __init__(self, is_enough: Callable[[LiveFrame], bool], stop: Callable[[], None]) -> None:
        self._is_enough, self._stop = is_enough, stop

    def publish(self, frame: LiveFrame) -> None:
        if self._is_enough(frame):
            self._stop()


def stop_when(monkeypatch: pytest.MonkeyPatch, is_enough: Callable[[LiveFrame], bool]) -> None:
    """End the systems that are run from now on when this is true; it is asked at every frame that is published."""
    run = LiveSystem.run

    def run_until(system: LiveSystem, until_s: float = float("inf")) -> None:
        system._outputs = (*system._outputs, _Watch(is_enough, system.stop))
        run(system, min(until_s, system._clock.now_s() + _LONGEST_S))

    monkeypatch.setattr(LiveSystem, "run", run_until)
