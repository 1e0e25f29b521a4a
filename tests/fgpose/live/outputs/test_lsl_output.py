"""Frames over the Lab Streaming Layer, with its real library and streams of this computer only."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pylsl
import pytest

from fgpose.live.frame import LiveFrame
from fgpose.live.outputs import open_lsl_output
from fgpose.live.outputs.lsl_output import PersonSlots
from fgpose.live.outputs.output import BackgroundOutput
from tests.fgpose.live.output_frames import SKELETON, frame, person, wait_until

# Of streams: other tests may run at the same time.
NAME = f"fgpose test {os.getpid()}"
TIMEOUT_S = 120.0


@contextmanager
def published(n_slots: int = 2, now_s: Callable[[], float] = time.time) -> Iterator[BackgroundOutput]:
    output = open_lsl_output(SKELETON, now_s=now_s, n_slots=n_slots, name=NAME)
    try:
        yield output
    finally:
        output.close()


def inlet(slot: int) -> pylsl.StreamInlet:
    (info,) = pylsl.resolve_byprop("name", f"{NAME} {slot}", 1, TIMEOUT_S)
    stream = pylsl.StreamInlet(info, max_buflen=1)
    stream.open_stream(TIMEOUT_S)
    return stream


def channels(info: pylsl.StreamInfo) -> list[dict[str, str]]:
    found, channel = [], info.desc().child("channels").child("channel")
    while not channel.empty():
        found.append({key: channel.child_value(key) for key in ("label", "marker", "type", "unit")})
        channel = channel.next_sibling("channel")
    return found


def sample_of(output: BackgroundOutput, stream: pylsl.StreamInlet, published: LiveFrame) -> tuple[np.ndarray, float]:
    """What a consumer gets of a frame, and its stamp by the clock of LSL."""
    output.publish(published)
    values, stamp_s = stream.pull_sample(TIMEOUT_S)
    assert values is not None
    assert stamp_s is not None
    return np.array(values).reshape(SKELETON.n_joints, 4), stamp_s


def test_streams_say_what_they_hold_as_the_convention_wants() -> None:
    with published():
        info = inlet(1).info(TIMEOUT_S)
    assert (info.type(), info.channel_count()) == ("MoCap", 4 * SKELETON.n_joints)
    assert channels(info)[4:8] == [
        {"label": "left_knee_X", "marker": "left_knee", "type": "PositionX", "unit": "meters"},
        {"label": "left_knee_Y", "marker": "left_knee", "type": "PositionY", "unit": "meters"},
        {"label": "left_knee_Z", "marker": "left_knee", "type": "PositionZ", "unit": "meters"},
        {"label": "left_knee_Confidence", "marker": "left_knee", "type": "Confidence", "unit": "normalized"},
    ]
    assert info.desc().child("setup").child("markers").child("marker").child_value("label") == "pelvis"


def test_a_sample_is_the_pose_of_the_slot_at_the_time_of_its_image() -> None:
    with published() as output:
        first, second = inlet(0), inlet(1)
        before_s, now_s = pylsl.local_clock(), time.time()
        shown = replace(frame(3, (7,)), time_s=now_s - 0.5, published_s=now_s)
        values, stamp_s = sample_of(output, first, shown)
        after_s = pylsl.local_clock()
        expected = person(7, 3)
        # Single precision.
        np.testing.assert_allclose(values[:, :3], expected.positions_m, rtol=1e-6)
        np.testing.assert_allclose(values[:, 3], expected.probability, rtol=1e-6)
        # Taken half a second before it was published; sent a moment later.
        assert before_s - 0.5 - 0.01 <= stamp_s <= after_s - 0.5 + 0.01
        nobody, _ = second.pull_sample(TIMEOUT_S)
        nobody = np.array(nobody).reshape(-1, 4)
        assert np.isnan(nobody[:, :3]).all()
        assert (nobody[:, 3] == 0).all()


def test_stamps_are_told_by_the_clock_of_the_frames() -> None:
    """Which does not follow the clock of the computer when that is set."""

    def now_s() -> float:
        return time.time() + 3600.0

    with published(1, now_s) as output:
        stream = inlet(0)
        before_s, taken_s = pylsl.local_clock(), now_s()
        _, stamp_s = sample_of(output, stream, replace(frame(3, (7,)), time_s=taken_s, published_s=taken_s))
        # The same moment by two clocks that are read one after the other; rounding.
        assert before_s - 0.01 <= stamp_s <= pylsl.local_clock() + 0.01


def test_a_consumer_that_stops_reading_costs_the_others_nothing() -> None:
    with published(1) as output:
        stuck, alive = inlet(0), inlet(0)
        sample_of(output, alive, frame(0))
        for sequence in range(1, 300):
            values, _ = sample_of(output, alive, frame(sequence, (4,)))
            assert values[0, 1] == pytest.approx(0.01 * sequence)
        assert (output.state.n_skipped, output.state.is_working) == (0, True)
        stuck.close_stream()


def test_a_consumer_that_comes_late_or_leaves_is_served_or_forgotten() -> None:
    with published(1) as output:
        inlet(0).close_stream()
        output.publish(frame(0))
        wait_until(lambda: output.state.n_published == 1)
        values, _ = sample_of(output, inlet(0), frame(1, (4,)))
        assert values[0, 0] == 4.0
    assert output.state.is_working


def test_people_keep_their_slots() -> None:
    slots = PersonSlots(2)

    def taken(*people: int) -> list[int | None]:
        return [None if each is None else each.person for each in slots.assign(frame(0, people).people)]

    assert taken(4, 7) == [4, 7]
    assert taken(7, 4) == [4, 7]
    assert taken(7, 9) == [None, 7]  # empty for a frame, so that the change is seen
    assert taken(9, 7) == [9, 7]
    assert taken(9, 7, 11) == [9, 7]
    assert taken(11) == [None, None]
    assert taken(11) == [11, None]
    assert taken(11, 2) == [11, 2]
    assert taken(7, 11) == [11, 7]  # who was called 2
    assert taken() == [None, None]


def test_without_the_library_it_is_said_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pylsl", None)
    with pytest.raises(ImportError, match=r"fgpose\[live\]"):
        open_lsl_output(SKELETON, now_s=time.time)


def test_no_slots_are_refused() -> None:
    with pytest.raises(ValueError, match="positive, got 0"):
        open_lsl_output(SKELETON, now_s=time.time, n_slots=0)


def test_closing_ends_the_threads_of_the_output() -> None:
    with published():
        pass
    assert not [thread for thread in threading.enumerate() if NAME in thread.name]
