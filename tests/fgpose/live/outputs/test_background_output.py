"""An output never holds the others up, whatever its sink does."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from fgpose.live.frame import LiveFrame
from fgpose.live.outputs import BackgroundOutput
from tests.fgpose.live.output_frames import frame, wait_until


class Sink:
    """Keeps the numbers of frames; waits or raises on demand."""

    def __init__(self) -> None:
        self.sent: list[int] = []
        self.free = threading.Event()
        self.free.set()
        self.n_open = self.n_closed = 0
        self.error: Exception | None = None

    def open(self) -> Sink:
        self.n_open += 1
        return self

    def send(self, frame: LiveFrame) -> None:
        self.free.wait()
        if self.error is not None:
            raise self.error
        self.sent.append(frame.sequence)

    def close(self) -> None:
        self.n_closed += 1


@contextmanager
def opened(sink: Sink, **options) -> Iterator[BackgroundOutput]:
    output = BackgroundOutput("test", sink.open, **options)
    try:
        yield output
    finally:
        sink.free.set()
        output.close()


def test_every_frame_is_passed_on_while_the_sink_keeps_up() -> None:
    sink = Sink()
    with opened(sink) as output:
        for sequence in range(5):
            output.publish(frame(sequence))
            wait_until(lambda n=sequence: output.state.n_published > n)
    assert sink.sent == [0, 1, 2, 3, 4]
    assert (output.state.is_working, output.state.n_skipped, output.state.last_error) == (True, 0, "")
    assert sink.n_closed == 1


def test_a_slow_sink_gets_the_newest_and_publishing_does_not_wait() -> None:
    sink = Sink()
    sink.free.clear()
    with opened(sink) as output:
        output.publish(frame(0))
        wait_until(lambda: not output._waiting)
        # Would publishing wait, the sink, which is let go only afterwards, would never take these.
        for sequence in range(1, 1000):
            output.publish(frame(sequence))
        sink.free.set()
        wait_until(lambda: output.state.n_published == 2)
    assert sink.sent == [0, 999]
    assert output.state.n_skipped == 998


def test_a_few_frames_may_wait_and_the_oldest_of_more_are_skipped() -> None:
    sink = Sink()
    sink.free.clear()
    with opened(sink, n_waiting=3) as output:
        output.publish(frame(0))
        wait_until(lambda: not output._waiting)
        for sequence in range(1, 10):
            output.publish(frame(sequence))
    assert sink.sent == [0, 7, 8, 9]
    assert (output.state.n_published, output.state.n_skipped) == (4, 6)


def test_a_sink_that_hangs_is_said_not_to_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fgpose.live.outputs.output._HUNG_S", 0.05)
    sink = Sink()
    sink.free.clear()
    with opened(sink) as output:
        output.publish(frame(0))
        wait_until(lambda: not output.state.is_working)
        assert "has not taken a frame" in output.state.last_error
        sink.free.set()
        wait_until(lambda: output.state.is_working)


def test_a_sink_that_fails_is_opened_again_and_that_is_told_once() -> None:
    sink, told = Sink(), []
    with opened(sink, tell=told.append, first_retry_s=0.001, longest_retry_s=0.002) as output:
        sink.error = OSError("no space left")
        sequence = 0
        while sink.n_open < 4:
            output.publish(frame(sequence := sequence + 1))
        assert not output.state.is_working
        assert output.state.last_error == "OSError: no space left"
        sink.error = None
        while not output.state.is_working:
            output.publish(frame(sequence := sequence + 1))
        wait_until(lambda: not output._waiting and output._sending_since_s is None)
    assert told == ["test does not work (OSError: no space left); it is tried again", "test works again"]
    assert sink.n_closed == sink.n_open
    assert output.state.n_published + output.state.n_skipped == sequence


def test_an_output_that_cannot_be_opened_says_so_at_once() -> None:
    def taken() -> Sink:
        raise OSError("port 5556 is taken")

    with pytest.raises(OSError, match="5556"):
        BackgroundOutput("test", taken)


def test_closing_does_not_wait_for_a_sink_that_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fgpose.live.outputs.output._CLOSE_S", 0.05)
    sink = Sink()
    sink.free.clear()
    output = BackgroundOutput("test", sink.open)
    output.publish(frame(0))
    wait_until(lambda: output._sending_since_s is not None)
    output.close()
    output.close()
    output.publish(frame(1))
    sink.free.set()
    output._worker.close(20)
    assert sink.sent == [0]
