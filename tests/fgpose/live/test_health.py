"""Faults in when images come, in simulated time."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Literal

import numpy as np
import pytest

from fgpose.live.cameras.camera import CameraEvent, LiveCamera
from fgpose.live.cameras.clock_model import Stamp
from fgpose.live.cameras.image import SourceImage
from fgpose.live.clock import SimulatedClock
from fgpose.live.frame import CameraState
from fgpose.live.sources import CameraSource

FPS = 30.0
LATE_S = 0.5


class Simulation:
    """A camera whose images come with jitter, looked at five times a second."""

    def __init__(self, settings: CameraSource | None = None) -> None:
        self.clock = SimulatedClock(1.7e9)
        self.events: list[CameraEvent] = []
        self.camera = LiveCamera(
            "cam01", settings or CameraSource(source="rtsp://x"), self.clock, LATE_S, on_event=self.events.append
        )
        self._rng = np.random.default_rng(0)
        self._looked_s = self.clock.now_s()
        self.camera.connected()

    def run(
        self,
        duration_s: float,
        fps: float = FPS,
        image: Callable[[float], SourceImage] = lambda now_s: SourceImage(stamp=Stamp(now_s - 1e9)),
    ) -> None:
        """Images come for a while; image makes one from the time at which it is taken."""
        for _ in range(round(duration_s * fps)):
            taken_s = self.clock.now_s()
            self._wait(float(self._rng.uniform(0, 0.5)) / fps)
            self.camera.receive(image(taken_s))
            self._wait(max(taken_s + 1 / fps - self.clock.now_s(), 0.0))

    def nothing(self, duration_s: float) -> None:
        self._wait(duration_s)

    def _wait(self, duration_s: float) -> None:
        end_s = self.clock.now_s() + duration_s
        while self._looked_s + 0.2 < end_s:
            self._looked_s += 0.2
            self.clock.advance(max(self._looked_s - self.clock.now_s(), 0.0))
            self.camera.look()
        self.clock.advance(max(end_s - self.clock.now_s(), 0.0))

    def said(self) -> list[CameraState]:
        return [event.state for event in self.events]

    def state(self) -> CameraState:
        return self.camera.status(self.clock.now_s()).state


@pytest.fixture
def simulation() -> Simulation:
    """Which has been ok for a while."""
    simulation = Simulation()
    simulation.run(20)
    assert simulation.said() == [CameraState.OK]
    return simulation


def test_a_pause_of_this_computer_is_no_fault_of_a_camera(simulation: Simulation) -> None:
    simulation.clock.advance(1.9)  # nobody looks, and nothing is read
    assert simulation.state() is CameraState.OK
    simulation.camera.look()
    simulation.run(2)
    assert simulation.said() == [CameraState.OK]
    simulation.clock.advance(3.0)  # whoever should look may hang
    assert simulation.state() is CameraState.LOST


def test_a_camera_is_connecting_until_its_first_image() -> None:
    simulation = Simulation()
    assert simulation.state() is CameraState.RECONNECTING
    simulation.run(1)
    assert simulation.state() is CameraState.OK


def test_what_is_counted(simulation: Simulation) -> None:
    status = simulation.camera.status(simulation.clock.now_s())
    assert status.n_images == 600
    assert status.rate_hz == pytest.approx(FPS, abs=1.5)  # an image more or less in a second
    assert status.image_s == pytest.approx(simulation.clock.now_s(), abs=2 / FPS)
    assert status.clock_offset_s == pytest.approx(1e9, abs=1e-3)  # the least of 600 delays of up to 17 ms


def check_said_once(simulation: Simulation, state: CameraState, reason: str, began_s: float) -> None:
    """Noticed within a second, said once, and over when the camera is well again."""
    assert simulation.said() == [CameraState.OK, state]
    assert simulation.events[-1].time_s - began_s <= 1.0
    assert reason in simulation.events[-1].reason
    assert simulation.state() is state
    simulation.run(5)
    assert simulation.said() == [CameraState.OK, state, CameraState.OK]


def test_a_camera_that_is_unplugged(simulation: Simulation) -> None:
    began_s = simulation.clock.now_s()
    simulation.nothing(30)
    check_said_once(simulation, CameraState.LOST, "no image comes", began_s)


def test_a_camera_whose_messages_are_refused_is_not_called_silent(simulation: Simulation) -> None:
    began_s = simulation.clock.now_s()
    for _ in range(20):
        simulation.camera.refused("its messages are refused: skeleton 'coco'")
        simulation.nothing(0.1)
    check_said_once(simulation, CameraState.LOST, "its messages are refused: skeleton 'coco'", began_s)
    simulation.camera.refused("once, among good ones")
    simulation.run(5)
    assert simulation.state() is CameraState.OK
    simulation.nothing(5.0)
    assert simulation.events[-1].reason == "no image comes"


def test_a_slow_camera_is_not_lost_between_its_images() -> None:
    simulation = Simulation()
    simulation.run(60, fps=2)
    assert simulation.said() == [CameraState.OK]
    simulation.nothing(1.9)  # the newest image came up to half a second before
    assert simulation.state() is CameraState.OK
    simulation.nothing(0.6)
    assert simulation.state() is CameraState.LOST


def test_half_the_rate(simulation: Simulation) -> None:
    began_s = simulation.clock.now_s()
    simulation.run(20, fps=FPS / 2)
    check_said_once(simulation, CameraState.LATE, "images a second instead of 30", began_s)


def test_less_than_the_rate_that_was_asked_for() -> None:
    simulation = Simulation(CameraSource(source="/dev/video0", fps=60.0))
    simulation.run(5)
    assert simulation.state() is CameraState.LATE


def test_images_that_come_late(simulation: Simulation) -> None:
    began_s = simulation.clock.now_s()
    for delay_s in np.append(np.linspace(0, 0.8, 50), np.full(100, 0.8)):
        simulation.run(1 / FPS, image=lambda now_s, d=delay_s: SourceImage(stamp=Stamp(now_s - 1e9 - d)))
    assert simulation.state() is CameraState.LATE
    # Images exceed the limit after a second of the rise, and the median of a second half a second later.
    assert simulation.events[-1].time_s - began_s < 1.0 + 0.5 + 0.3
    assert "after they were taken" in simulation.events[-1].reason


@pytest.mark.parametrize("jump_s", [5.0, -5.0])
def test_a_clock_that_jumps(simulation: Simulation, jump_s: float) -> None:
    began_s = simulation.clock.now_s()
    simulation.run(0.9, image=lambda now_s: SourceImage(stamp=Stamp(now_s - 1e9 + jump_s)))
    assert simulation.said() == [CameraState.OK, CameraState.DOUBTFUL]
    assert simulation.events[-1].time_s - began_s <= 1.0
    assert f"jumped by {jump_s:+.0f}" in simulation.events[-1].reason
    simulation.run(5, image=lambda now_s: SourceImage(stamp=Stamp(now_s - 1e9 + jump_s)))
    assert simulation.state() is CameraState.OK


def test_a_decoder_that_reports_errors(simulation: Simulation) -> None:
    began_s = simulation.clock.now_s()
    simulation.run(10, image=lambda now_s: SourceImage(stamp=Stamp(now_s - 1e9), is_damaged=True))
    assert simulation.camera.receive(SourceImage(is_damaged=True)) is None
    check_said_once(simulation, CameraState.DOUBTFUL, "damaged", began_s)


def test_a_source_that_fails_is_reconnecting_until_an_image_comes(simulation: Simulation) -> None:
    simulation.camera.failed("rtsp://x: nothing answers there")
    assert simulation.events[-1].state is CameraState.RECONNECTING
    assert str(simulation.events[-1]) == "camera cam01: reconnecting: rtsp://x: nothing answers there"
    simulation.camera.failed("rtsp://x: nothing answers there")
    simulation.nothing(5)
    simulation.camera.connected()
    simulation.nothing(0.3)
    assert simulation.said() == [CameraState.OK, CameraState.RECONNECTING]
    simulation.run(3)
    assert simulation.said() == [CameraState.OK, CameraState.RECONNECTING, CameraState.OK]


def test_the_end_of_a_recording_is_said(simulation: Simulation) -> None:
    simulation.camera.ended("the recording has ended")
    simulation.nothing(5)
    assert simulation.said() == [CameraState.OK, CameraState.LOST]


def test_whoever_is_told_may_fail() -> None:
    simulation = Simulation()

    def fail(event: CameraEvent) -> None:
        raise RuntimeError("dead")

    camera = LiveCamera("cam01", CameraSource(source="rtsp://x"), simulation.clock, LATE_S, on_event=fail)
    camera.connected()
    camera.receive(SourceImage())
    camera.look()
    assert camera.status(simulation.clock.now_s()).state is CameraState.OK


def test_no_two_images_have_one_time_whatever_the_stamps_are() -> None:
    clock, rng = SimulatedClock(1.7e9), np.random.default_rng(0)
    camera = LiveCamera("cam01", CameraSource(source="rtsp://x"), clock, LATE_S)
    camera.connected()
    times_s, offset_s = [], 0.0
    for _ in range(2000):
        clock.advance(float(rng.choice([0.0, 1e-9, 0.01, 0.1])))
        offset_s = float(rng.choice([0.0, -1.7e9, 10.0, 0.4])) if rng.uniform() < 0.05 else offset_s
        stamp_s = clock.now_s() + offset_s + float(rng.choice([0.0, -0.05]))
        wall_s = stamp_s if rng.uniform() < 0.5 else None
        image = camera.receive(SourceImage(stamp=Stamp(stamp_s, wall_s=wall_s)))
        times_s += [] if image is None else [image.captured_s]
    assert (np.diff(times_s) > 0).all()
    status = camera.status(clock.now_s())
    assert (len(times_s) + status.n_lost, status.n_images) == (2000, 2000)


@pytest.mark.parametrize("pace", ["real time", "fast"])
def test_an_image_that_is_yet_to_be_taken_is_refused(pace: Literal["real time", "fast"]) -> None:
    """Not the good ones after it; a recording that is played fast is ahead of the clock all the time."""
    clock = SimulatedClock(1.7e9)
    camera = LiveCamera("cam01", CameraSource(source="/dev/video0", pace=pace), clock, LATE_S)
    camera.connected()
    taken = []
    for ahead_s in (0.0, 1.0, 0.0):
        clock.advance(0.1)
        taken.append(camera.receive(SourceImage(stamp=Stamp(clock.now_s() + ahead_s, is_host_time=True))))
    if pace == "fast":
        assert taken[1] is not None
        return
    assert [image is None for image in taken] == [False, True, False]
    status = camera.status(clock.now_s())
    assert status.state is CameraState.DOUBTFUL
    assert "1.00 s ahead of the clock" in status.reason
    assert status.n_lost == 1


@pytest.mark.parametrize("clock", ["auto", "own", "synchronised"])
@pytest.mark.parametrize("fps", [2.0, 30.0])
def test_images_that_had_waited_for_the_connection_are_not_used(
    clock: Literal["auto", "own", "synchronised"], fps: float, caplog: pytest.LogCaptureFixture
) -> None:
    """A detector that ran before: its queue comes at once, with the stamps of when it filled, half a minute ago."""
    caplog.set_level(logging.INFO, "fgpose.live")
    simulation = Simulation(CameraSource(source="zmq", clock=clock))
    began_s = simulation.clock.now_s() - 30.0
    used: list[float] = []

    def image(stamp_s: float) -> SourceImage:
        return SourceImage(stamp=Stamp(stamp_s, wall_s=stamp_s))

    for k in range(40):
        simulation.clock.advance(0.15 if k == 20 else 0.001)  # the reader pauses once
        assert simulation.camera.receive(image(began_s + k / fps)) is None
    simulation.camera.refused("its messages are refused: a stamp that jumps")
    for _ in range(20):
        simulation.nothing(1 / fps)
        received = simulation.camera.receive(image(simulation.clock.now_s() - 0.02))
        if received is not None:
            used.append(received.captured_s - simulation.clock.now_s())
    assert len(used) >= 20 - 5  # intervals
    assert min(used) > -0.05
    simulation.nothing(0.2)
    assert simulation.said()[-1] is CameraState.OK
    assert {event.state for event in simulation.events[:-1]} <= {CameraState.RECONNECTING}
    said = [record.getMessage() for record in caplog.records if "waited, for" in record.getMessage()]
    assert len(said) == 1
    assert said[0].startswith("camera cam01: old images had waited, for up to 30.0 s")


@pytest.mark.parametrize("fps", [5.0, 30.0])
def test_a_camera_whose_images_come_in_bursts_is_used(fps: float) -> None:
    simulation = Simulation()
    used = 0
    for burst in range(20):
        simulation.clock.advance(5 / fps)
        for k in range(5):
            stamp = Stamp(burst * 5 / fps + k / fps)
            used += simulation.camera.receive(SourceImage(stamp=stamp)) is not None
    assert used >= 100 - 2 * fps - 10  # after two seconds, and two bursts at the most
