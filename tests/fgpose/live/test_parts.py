"""Whatever ends is noticed, said, counted, and begun again."""

from __future__ import annotations

import itertools
import queue
import threading
from collections.abc import Callable, Collection, Sequence
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import zmq
from live_frames import live_frame
from output_frames import wait_until
from test_live_tracking import CONFIG, scene, statuses

from fgpose.association.track import TrackState
from fgpose.io.live.recordings import RecordedImage
from fgpose.live.cameras.camera import LiveCamera
from fgpose.live.cameras.image import Image, SourceImage
from fgpose.live.clock import Clock, SimulatedClock
from fgpose.live.frame import CameraState, CameraStatus, LiveFrame
from fgpose.live.outputs.frame_messages import decode_frame, encode_frame
from fgpose.live.processes.parts import Parts
from fgpose.live.processes.worker import Worker
from fgpose.live.reception.keypoint_messages import encode_keypoints
from fgpose.live.reception.keypoint_socket import KeypointSocket
from fgpose.live.reception.received import KeypointReceiver
from fgpose.live.reception.rejections import MessageError
from fgpose.live.sources import CameraSource
from fgpose.live.system import Feed, LiveSystem
from fgpose.live.tracking.live_tracking import LiveTracking, Update
from fgpose.live.tracking.observed import volume_points_m
from fgpose.skeleton import Skeleton

# A long time: nothing here waits for it unless something is wrong.
LONG_S = 120.0


@pytest.mark.parametrize("ends", [ValueError("of a message"), SystemExit(3), MemoryError(), None])
def test_work_that_ends_is_begun_again_and_counted(
    ends: BaseException | None, caplog: pytest.LogCaptureFixture
) -> None:
    notes: list[str] = []
    parts, times, works = Parts(lambda: 5.0, notes.append), [], threading.Event()

    def work() -> None:
        times.append(1)
        if len(times) == 3:
            works.set()
            worker.stopped.wait()
        elif ends is not None:
            raise ends

    worker = Worker("reading", work, parts)
    worker.start()
    assert works.wait(LONG_S)
    (restarts,) = parts.so_far()
    assert (restarts.part, restarts.n, restarts.last_s) == ("reading", 2, 5.0)
    assert restarts.reason == ("its work returned" if ends is None else f"{type(ends).__name__}: {ends}")
    # The same again is said once, but counted.
    assert notes == [f"reading ended ({restarts.reason}) and is begun again; 1 times so far"]
    assert notes[0] in caplog.text
    worker.close(LONG_S)
    assert not worker.is_alive


def test_what_ends_again_and_again_says_how_long_it_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    notes: list[str] = []
    monkeypatch.setattr("fgpose.live.processes.worker._FIRST_WAIT_S", 0.2)
    monkeypatch.setattr("fgpose.live.processes.worker._LAST_WAIT_S", 0.2)
    ended = threading.Event()

    def note(line: str) -> None:
        notes.append(line)
        ended.set()

    worker = Worker("reading", lambda: None, Parts(note=note))
    worker.start()
    assert ended.wait(LONG_S)
    assert notes == ["reading ended (its work returned) and is begun again in 0.2 s; 1 times so far"]
    worker.close(LONG_S)


@pytest.mark.parametrize("is_replaced", [False, True])
def test_work_that_hangs_is_said_and_replaced_where_it_can_be(*, is_replaced: bool) -> None:
    notes, hangs, threads = list[str](), threading.Event(), list[threading.Thread]()

    def work() -> None:
        threads.append(threading.current_thread())
        if len(threads) == 1:
            hangs.wait()
        while not worker.stopped.is_set():
            worker.stopped.wait(0.001)

    parts = Parts(note=notes.append)
    worker = Worker("reading", work, parts, hangs_after_s=0.4, is_replaced=is_replaced)
    worker.start()
    wait_until(lambda: bool(threads))
    worker.look(0.1)
    worker.look(60.0)  # nobody has looked: this process was stopped
    assert notes == []
    worker.look(0.3)
    worker.look(0.3)
    said = "ended (it hangs: nothing for 0.4 s) and is begun again; 1 times so far"
    assert notes == [f"reading {said}" if is_replaced else "reading is not well (it hangs: nothing for 0.4 s)"]
    assert len(parts.so_far()) == is_replaced
    if is_replaced:
        wait_until(lambda: len(threads) == 2)
    hangs.set()
    if is_replaced:
        threads[0].join(LONG_S)  # it was left behind, and stops
        assert not threads[0].is_alive()
    assert worker.is_alive
    worker.close(LONG_S)
    assert not worker.is_alive


def test_whoever_hangs_is_looked_at_by_the_system() -> None:
    parts, looked = Parts(), list[float]()

    class Part:
        def look(self, elapsed_s: float) -> None:
            looked.append(elapsed_s)

    part = Part()
    parts.watch(part.look)
    parts.look()
    assert len(looked) == 1
    del part
    parts.look()
    assert len(looked) == 1


def test_who_is_told_may_fail_too() -> None:
    works, times = threading.Event(), []

    def work() -> None:
        times.append(1)
        if len(times) > 1:
            works.set()
            worker.stopped.wait()
        raise RuntimeError("once")

    worker = Worker("reading", work, Parts(note=Mock(side_effect=OSError("stderr is closed"))))
    worker.start()
    assert works.wait(LONG_S)
    worker.close(LONG_S)


def test_keypoints_are_received_after_what_nobody_has_thought_of(monkeypatch: pytest.MonkeyPatch) -> None:
    rig, skeleton = scene().rig, scene().motion.skeleton
    image, parts = scene().observations.images[0], Parts()
    camera = LiveCamera(image.camera, CameraSource(source="zmq"), Clock(), 0.5)
    came, receive, failing = threading.Event(), camera.receive, iter([KeyError("nobody")])

    def fails_once(source: SourceImage) -> Image | None:
        for error in failing:
            raise error
        return receive(source)

    monkeypatch.setattr(camera, "receive", fails_once)
    socket = KeypointSocket(rig, skeleton, port=0)
    receiver = KeypointReceiver(socket, {image.camera: camera}, lambda recorded: came.set(), parts)
    size_px = rig.cameras[rig.names.index(image.camera)].size_px
    with zmq.Context() as context, context.socket(zmq.PUSH) as detector:
        detector.setsockopt(zmq.LINGER, 0)
        detector.connect(socket.address)
        for n in range(200):
            detector.send(
                encode_keypoints(image.camera, n * 0.01, size_px, skeleton.name, image.points2d_px, image.confidence)
            )
            if came.wait(0.05):
                break
    receiver.close()
    assert came.is_set()
    assert [(each.part, each.n) for each in parts.so_far()] == [("the reception of keypoints", 1)]


@pytest.mark.parametrize(
    ("sent_as", "skeleton", "reason"),
    [
        ("ring_0", "coco_17", "its messages are refused: skeleton 'coco_17', not h36m_17 with 17 joints"),
        (
            "cam99",
            "h36m_17",
            "no image comes, and messages whose camera is not known are refused: the rig has no camera",
        ),
    ],
)
def test_why_messages_are_refused_is_told_of_their_camera(sent_as: str, skeleton: str, reason: str) -> None:
    rig, image, clock = scene().rig, scene().observations.images[0], SimulatedClock(1.7e9)
    cameras = {name: LiveCamera(name, CameraSource(source="zmq"), clock, 0.5) for name in ("ring_0", "ring_1")}
    assert cameras["ring_0"].status(clock.now_s()).reason == "connecting"
    socket, size_px = KeypointSocket(rig, scene().motion.skeleton, port=0), rig.cameras[0].size_px
    refused = threading.Event()
    receiver = KeypointReceiver(socket, cameras, lambda recorded: None)
    listened = socket.on_refused

    def listen(error: MessageError) -> None:
        listened(error)
        refused.set()

    socket.on_refused = listen
    with zmq.Context() as context, context.socket(zmq.PUSH) as detector:
        detector.setsockopt(zmq.LINGER, 0)
        detector.connect(socket.address)
        detector.send(encode_keypoints(sent_as, 0.0, size_px, skeleton, image.points2d_px, image.confidence))
        assert refused.wait(LONG_S)
    status = cameras["ring_0"].status(clock.now_s())
    assert (status.state, status.reason[: len(reason)]) == (CameraState.LOST, reason)
    assert cameras["ring_1"].status(clock.now_s()).reason.startswith(reason) == (sent_as == "cam99")
    receiver.close()


class Images(Feed):
    """The images of the scene on a simulated clock."""

    def __init__(self, clock: SimulatedClock) -> None:
        self._clock, self._coming = clock, list(scene().observations.images)
        self.state = CameraState.OK

    def take(self, timeout_s: float) -> list[RecordedImage]:
        self._clock.advance(max(timeout_s, 0.01))
        taken = [image for image in self._coming if image.time_s <= self._clock.now_s()]
        self._coming = self._coming[len(taken) :]
        return [RecordedImage(image, self._clock.now_s()) for image in taken]

    def go_on(self, camera_names: Collection[str]) -> None:
        pass

    def statuses(self) -> tuple[CameraStatus, ...]:
        return statuses(self.state)


class Run:
    """A live system for a second, in which something fails."""

    def __init__(self, step: str = "", output: Mock | None = None, observer: Mock | None = None) -> None:
        self.frames: list[LiveFrame] = []
        self.updates: list[object] = []
        clock, rig, skeleton = SimulatedClock(), scene().rig, scene().motion.skeleton
        feed, parts = Images(clock), Parts(clock.now_s)
        tracking = LiveTracking(rig, skeleton, CONFIG, volume_points_m(rig), parts)
        if step:
            where = tracking if hasattr(tracking, step) else feed
            vars(where)[step] = failing_once(getattr(where, step))
        outputs = [*([] if output is None else [Mock(publish=output)]), self]
        observers = [*([] if observer is None else [observer]), self.updates.append]
        LiveSystem(feed, tracking, outputs, observers, clock, parts).run(1.0)
        tracking.close()

    def publish(self, frame: LiveFrame) -> None:
        self.frames.append(frame)

    @property
    def restarts(self) -> dict[str, int]:
        """As the last frame says."""
        return {each.part: each.n for each in self.frames[-1].restarts}


def failing_once(method: Callable[..., Any]) -> Callable[..., Any]:
    """The third time that it is called."""
    n_calls = itertools.count(1)

    def call(*arguments: object) -> object:
        if next(n_calls) == 3:
            raise KeyError("of a camera")
        return method(*arguments)

    return call


SLOW_STEPS = [pytest.param(step, marks=pytest.mark.slow) for step in ("frame", "statuses", "look", "tidy", "take")]


@pytest.mark.parametrize("step", ["add", *SLOW_STEPS])
def test_the_system_goes_on_when_a_step_fails(step: str, caplog: pytest.LogCaptureFixture) -> None:
    run = Run(step)
    assert run.restarts == {"tracking": 1}
    # No consumer takes it for gone: frames come at least each 0.1 s, one is due when the step has failed.
    assert np.diff([frame.published_s for frame in run.frames]).max() < 0.25
    assert len(run.frames[-1].people) == 2
    assert "tracking ended (KeyError: 'of a camera') and is begun again" in caplog.text


def test_while_the_tracker_hangs_frames_say_what_was_known() -> None:
    frames, hung, notes = queue.Queue[LiveFrame](), list[LiveFrame](), list[str]()
    clock, rig = SimulatedClock(), scene().rig
    feed, parts = Images(clock), Parts(clock.now_s, notes.append)
    tracking = LiveTracking(rig, scene().motion.skeleton, CONFIG, volume_points_m(rig), parts)
    track, n_calls = tracking.track, itertools.count()

    def hangs(images: Sequence[RecordedImage]) -> Update:
        if next(n_calls) == 40:
            feed.state = CameraState.LOST
            while not frames.empty():
                frames.get()
            for _ in range(11):
                clock.advance(0.2)
                hung.append(frames.get(timeout=LONG_S))
        return track(images)

    vars(tracking)["track"] = hangs
    system = LiveSystem(feed, tracking, [Mock(publish=frames.put)], [], clock, parts)
    with system.never_silent():
        system.run(3.5)
    tracking.close()
    assert np.diff([frame.published_s for frame in hung]) == pytest.approx(0.2)
    assert {frame.time_s for frame in hung} == {hung[0].time_s}
    assert [frame.age_s for frame in hung] == sorted(frame.age_s for frame in hung)
    assert {camera.state for frame in hung for camera in frame.cameras} == {CameraState.LOST}
    assert {person.state for frame in hung[1:] for person in frame.people} == {TrackState.COASTING}
    first, last = hung[1], hung[-1]
    assert len(last.people) == 2
    assert np.all(last.people[0].covariance_m2[:, 0, 0] > first.people[0].covariance_m2[:, 0, 0])
    (note,) = notes
    assert note.startswith("tracking is not well (it hangs: nothing for 2.")
    later = [frames.get() for _ in range(frames.qsize())]
    assert [frame.sequence for frame in later] == [hung[-1].sequence + n for n in range(1, len(later) + 1)]
    assert later[-1].time_s > hung[-1].time_s or not later[-1].people


@pytest.mark.slow
def test_outputs_and_observers_that_fail_keep_nobody_from_what_is_said() -> None:
    run = Run(output=Mock(side_effect=OSError("disk")), observer=Mock(side_effect=ValueError("strange")))
    assert run.restarts.keys() == {"an output", "an observer"}
    assert len(run.frames) > 9
    assert len(run.updates) > 9


def test_restarts_are_sent_with_frames(skeleton: Skeleton) -> None:
    parts = Parts(lambda: 1.7e9)
    parts.count("the tracker", "RuntimeError: indeterminate")
    frame = live_frame(skeleton)
    vars(frame)["restarts"] = parts.so_far()
    assert decode_frame(encode_frame(frame), skeleton).restarts == parts.so_far()
