"""What of a file is missing is said on the page, at the end and by the exit code."""

from __future__ import annotations

import pytest

from fgpose.cli.live_consumers import Consumers
from fgpose.live.clock import SimulatedClock
from fgpose.live.frame import LiveFrame
from fgpose.live.outputs import OutputState


class Named:
    def __init__(self, state: OutputState) -> None:
        self.state = state

    def publish(self, frame: LiveFrame) -> None: ...

    def close(self) -> None: ...


WHOLE = OutputState("recording a", True, 9, 0, is_file=True)
LOST = OutputState("recording a", True, 9, 3, "OSError: full", n_lost=3, is_file=True)
WITHOUT_END = OutputState("recording a", False, 9, 0, "OSError: full", is_file=True)
CONSUMER_AWAY = OutputState("ZeroMQ", False, 9, 3, "OSError: away")


@pytest.mark.parametrize(
    ("state", "code", "fault"),
    [
        (WHOLE, 0, ""),
        (LOST, 1, "3 frames or records are missing in it"),
        (WITHOUT_END, 1, "OSError: full"),
        (CONSUMER_AWAY, 0, "OSError: away"),
    ],
)
def test_a_file_that_lacks_something_is_said_on_the_page_and_at_the_end(
    state: OutputState, code: int, fault: str, capsys: pytest.CaptureFixture[str]
) -> None:
    consumers = Consumers(SimulatedClock(0.0), [Named(state)])
    assert consumers._faults() == {state.name: fault}
    assert consumers.say_states() == code
    assert ("3 MISSING" in capsys.readouterr().out) == (state is LOST)
