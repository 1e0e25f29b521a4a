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


class File(Sink):
    """Writes two frames at a time."""

    def __init__(self) -> None:
        super().__init__()
        self.n_held, self.noted = 0, list[int]()

    def send(self, frame: LiveFrame) -> None:
        super().send(frame)
        self.n_held = (self.n_held + 1) % 2

    def note_lost(self, n_frames: int) -> None:
        self.noted.append(n_frames)

    def close(self) -> None:
        super().close()
        if self.error is not None:
            raise self.error
        self.n_held = 0


def test_what_a_file_lacks_is_counted_and_written_into_it() -> None:
    file = File()
    with opened(file, n_waiting=3, first_retry_s=0.001, longest_retry_s=0.001) as output:
        for sequence in range(3):
            output.publish(frame(sequence))
        wait_until(lambda: output.state.n_published == 3)
        file.error = OSError("full")
        output.publish(frame(3))
        wait_until(lambda: file.n_closed == 1 and output._sink is None)
        # That one, and the one that was held.
        assert (output.state.n_published, output.state.n_lost) == (2, 2)
        assert output.state.is_incomplete
        assert output.state.fault == "OSError: full; 2 frames or records are missing in it"
        file.error, file.n_held = None, 0
        output.publish(frame(4))
        wait_until(lambda: output.state.n_published == 3)
        assert file.noted == [2]
        file.free.clear()
        output.publish(frame(5))
        wait_until(lambda: not output._waiting)
        for sequence in range(6, 10):
            output.publish(frame(sequence))
        assert output.state.n_lost == 3
        file.free.set()
    # Where it was the last file too, it says so before it is closed.
    assert file.noted[-1] == 3
    assert (output.state.n_published, output.state.n_skipped) == (7, 3)
    assert output.state.is_incomplete
    assert output.state.fault == "3 frames or records are missing in it"


def test_frames_that_wait_at_the_end_of_a_full_disk_are_missing() -> None:
    file = File()
    with opened(file, n_waiting=5, first_retry_s=1000.0) as output:
        file.error = OSError("full")
        output.publish(frame(0))
        wait_until(lambda: not output.state.is_working)
        for sequence in range(1, 4):
            output.publish(frame(sequence))
    assert output.state.n_lost == output.state.n_skipped == 4


def test_a_file_that_cannot_be_closed_is_incomplete() -> None:
    file = File()
    with opened(file, n_waiting=5) as output:
        output.publish(frame(0))
        wait_until(lambda: output.state.n_published == 1)
        file.error = OSError("full")
    state = output.state
    assert (state.n_published, state.n_lost, state.is_working, state.last_error) == (0, 1, False, "OSError: full")


def test_a_file_that_hangs_at_the_end_is_incomplete() -> None:
    file = File()
    with opened(file, n_waiting=5, close_s=0.05) as output:
        file.free.clear()
        for sequence in range(3):
            output.publish(frame(sequence))
        wait_until(lambda: len(output._waiting) == 2)
        output.close()
        assert output.state.n_lost == 3
        assert "not taken the rest" in output.state.fault
    output._worker.close()


def test_a_consumer_that_skips_lacks_nothing() -> None:
    sink = Sink()
    with opened(sink, n_waiting=1) as output:
        sink.error = OSError("away")
        output.publish(frame(0))
        wait_until(lambda: not output.state.is_working)
        assert not output.state.is_incomplete
    assert output.state.n_lost == 0


def test_a_view_lacks_what_is_skipped_while_it_does_not_work() -> None:
    file = File()
    with opened(file, n_waiting=1, first_retry_s=1000.0) as output:
        file.free.clear()
        output.publish(frame(0))
        wait_until(lambda: not output._waiting)
        for sequence in range(1, 4):
            output.publish(frame(sequence))
        assert (output.state.n_skipped, output.state.n_lost) == (2, 0)
        file.error = OSError("full")
        file.free.set()
        wait_until(lambda: not output.state.is_working)
        for sequence in range(4, 6):
            output.publish(frame(sequence))
        assert output.state.n_lost == 3
    assert output.state.n_lost == 4
