"""fgpose live, with keypoints that are sent to it in real time."""

from __future__ import annotations

import itertools
import re
import signal
import socket
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zmq
from live_frames import live_frame
from stopped import stop_when
from test_live_tracking import scene

from fgpose.cli import main
from fgpose.cli.commands.live import _on_signals, _table
from fgpose.config import Config
from fgpose.io.calibration import save_rig
from fgpose.io.live.tracker_memory import load_memory
from fgpose.live.cameras.rig_file import load_live_rig
from fgpose.live.frame import CameraState, CameraStatus, LiveFrame
from fgpose.live.link_distance import DistanceFault, LinkDistance
from fgpose.live.outputs.frame_messages import decode_frame
from fgpose.live.reception.keypoint_messages import encode_keypoints
from fgpose.live.recording.live_recording import load_live_recording
from fgpose.live.statistics import LiveStatistics
from fgpose.live.system import LiveSystem
from fgpose.live.tracking.live_tracking import LiveTracking
from fgpose.live.tracking.observed import volume_points_m
from fgpose.robot.distance_messages import decode_distances, encode_robot
from tests.fgpose.live.output_frames import PATIENCE_S

SCENE_S = 2.0


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


def rig_file(folder: Path) -> Path:
    save_rig(scene().rig, folder / "calibration.toml")
    path = folder / "rig.toml"
    tables = "".join(f'[cameras.{name}]\nsource = "zmq"\n' for name in scene().rig.names)
    path.write_text(f'[live]\ncalibration = "calibration.toml"\n{tables}')
    return path


def send(port: int, published: threading.Event, enough: threading.Event) -> None:
    """As four detectors, from when something is published until it is enough: every image when it is taken, of the
    scene forth and back. Where the computer is too busy for that, the people are slower."""
    assert published.wait(PATIENCE_S)
    with zmq.Context() as context, context.socket(zmq.PUSH) as detector:
        detector.setsockopt(zmq.LINGER, 0)
        detector.connect(f"tcp://127.0.0.1:{port}")
        skeleton, images = scene().motion.skeleton, scene().observations.images
        begin_s = time.time() + 0.5
        for turn in itertools.count():
            for image in images[::-1] if turn % 2 else images:
                if enough.is_set():
                    return
                in_turn_s = SCENE_S - image.time_s if turn % 2 else image.time_s
                begin_s += max(time.time() - 0.1 - (begin_s + turn * SCENE_S + in_turn_s), 0.0)
                time_s = begin_s + turn * SCENE_S + in_turn_s
                time.sleep(max(time_s - time.time(), 0.0))
                size_px = scene().rig.cameras[scene().rig.names.index(image.camera)].size_px
                seen = image.points2d_px, image.confidence
                detector.send(encode_keypoints(image.camera, time_s, size_px, skeleton.name, *seen))


def receive(port: int, frames: list[LiveFrame], published: threading.Event, stop: threading.Event) -> None:
    with zmq.Context() as context, context.socket(zmq.SUB) as consumer:
        consumer.setsockopt(zmq.LINGER, 0)
        consumer.subscribe(b"")
        consumer.connect(f"tcp://127.0.0.1:{port}")
        while not stop.is_set():
            if consumer.poll(50):
                frames.append(decode_frame(consumer.recv(), scene().motion.skeleton))
                published.set()


@pytest.mark.parametrize("where", ["option", "configuration"])
def test_a_device_that_is_not_there_is_said_before_cameras_are_opened(
    where: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("onnxruntime.get_available_providers", lambda: ["CPUExecutionProvider"])
    rig = rig_file(tmp_path)
    rig.write_text(rig.read_text().replace('"zmq"', '"rtsp://127.0.0.1:9/nobody"'))
    config = tmp_path / "mine.toml"
    config.write_text('[monocular]\ndevice = "openvino"\n')
    options = ["--device", "openvino"] if where == "option" else ["--config", str(config)]
    assert main(["live", str(rig), *options]) == 2
    printed = capsys.readouterr().err
    assert "OpenVINOExecutionProvider comes with the wheel onnxruntime-openvino" in printed
    assert "nobody" not in printed


def are_all(frame: LiveFrame, state: CameraState) -> bool:
    return all(camera.state is state for camera in frame.cameras)


@pytest.mark.slow
def test_from_keypoints_to_frames_and_a_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    keypoints_port, frames_port = free_port(), free_port()
    record, frames, lost = tmp_path / "session.fgpose", list[LiveFrame](), list[LiveFrame]()
    published, enough, stop = threading.Event(), threading.Event(), threading.Event()

    def is_over(_: LiveFrame) -> bool:
        """Both people were received, and then that nothing comes any more."""
        if any(len(frame.people) == 2 and are_all(frame, CameraState.OK) for frame in frames):
            enough.set()
            lost.extend(frame for frame in frames[-1:] if are_all(frame, CameraState.LOST))
        return bool(lost)

    stop_when(monkeypatch, is_over)
    threads = [
        threading.Thread(target=send, args=(keypoints_port, published, enough)),
        threading.Thread(target=receive, args=(frames_port, frames, published, stop)),
    ]
    for thread in threads:
        thread.start()
    arguments = ["live", str(rig_file(tmp_path)), "--skeleton", "h36m_17"]
    arguments += ["--keypoints-port", str(keypoints_port), "--zmq", str(frames_port), "--record", str(record)]
    arguments += ["--resume", str(tmp_path / "people.json")]
    try:
        assert main(arguments) == 0
    finally:
        enough.set()
        stop.set()
        for thread in threads:
            thread.join()
    report = capsys.readouterr().out
    # Frames come at all times, also before the first image and after the last. Of those that are skipped it says so.
    n_missing = np.diff([frame.sequence for frame in frames]) - 1
    assert (n_missing >= 0).all()
    skipped = re.search(r"ZeroMQ at \S+: \d+ published, (\d+) skipped", report)
    assert skipped
    assert n_missing.sum() <= int(skipped[1])
    assert frames[0].people == ()
    assert enough.is_set(), "two people were not found"
    assert lost, "that no image comes any more was not said"
    assert lost[0].observed_share == 0.0
    assert "from image to frame: median" in report
    assert all(name in report for name in scene().rig.names)

    rig = load_live_rig(tmp_path / "rig.toml").rig
    memory = load_memory(tmp_path / "people.json", rig, scene().motion.skeleton, Config())
    assert len(memory.people) >= 2

    recording = load_live_recording(record)
    assert recording.skeleton == scene().motion.skeleton
    tracking = LiveTracking(recording.rig, recording.skeleton, recording.config, volume_points_m(recording.rig))
    again = []
    for images in recording.updates():
        again.append(tracking.track(images).people)
        tracking.tidy()
    tracking.close()
    newest = [tracked.estimate.positions_m for tracked in next(people for people in reversed(again) if people)]
    published = [frame for frame in recording.frames() if frame.people]
    by_time = {frame.time_s: frame for frame in published}
    last = by_time[max(by_time)]
    # Positions are recorded in single precision.
    for positions_m, person in zip(newest, last.people, strict=True):
        np.testing.assert_allclose(positions_m, person.positions_m, atol=1e-5)


def test_the_table_counts_what_was_left_out() -> None:
    """Of 172 images 49 entered the estimate, 3 came too late, and nobody looked at the others."""
    report = LiveStatistics(["door"])
    door = CameraStatus("door", CameraState.OK, n_images=172, n_used=49, n_lost=3)
    report.add(replace(live_frame(scene().motion.skeleton), cameras=(door,)))
    table = _table(report)
    assert [next(iter(column.cells)) for column in table.columns][:4] == ["door", "172", "49", "123"]


SLOW_SIGNALS = [pytest.param(name, marks=pytest.mark.slow) for name in ("SIGHUP", "SIGQUIT")]


@pytest.fixture
def hangup_ends() -> Iterator[None]:
    """Where the tests were begun with nohup, it does not, and live leaves it so."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.usefixtures("hangup_ends")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", *SLOW_SIGNALS])
def test_a_signal_ends_it_with_the_recording_closed(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    def raised_while_it_runs(system: LiveSystem) -> None:
        signal.raise_signal(signal.Signals[name])
        assert system._stopped.is_set()

    monkeypatch.setattr(LiveSystem, "run", lambda system, until_s: raised_while_it_runs(system))
    before, record = signal.getsignal(signal.Signals[name]), tmp_path / "session.fgpose"
    arguments = ["live", str(rig_file(tmp_path)), "--skeleton", "h36m_17", "--keypoints-port", "0"]
    assert main([*arguments, "--record", str(record)]) == 0
    assert signal.getsignal(signal.Signals[name]) is before
    # It warns of recordings that were not closed.
    assert list(load_live_recording(record).frames()) == []
    assert "0 frames" in capsys.readouterr().out


def test_a_signal_while_it_opens_closes_what_is_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    def tracking(*_: object) -> None:
        signal.raise_signal(signal.SIGTERM)

    monkeypatch.setattr("fgpose.live.tracking.live_tracking.LiveTracking", tracking)
    record = tmp_path / "session.fgpose"
    arguments = ["live", str(rig_file(tmp_path)), "--skeleton", "h36m_17", "--keypoints-port", "0"]
    assert main([*arguments, "--record", str(record)]) == 130
    assert list(load_live_recording(record).frames()) == []
    assert "interrupted" in capsys.readouterr().err


def test_it_outlives_its_terminal_under_nohup() -> None:
    before, calls = signal.signal(signal.SIGHUP, signal.SIG_IGN), []
    try:
        with _on_signals(lambda: calls.append("ended")):
            signal.raise_signal(signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)
    assert calls == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "all detectors are elsewhere; say with --skeleton what their joints are"),
        (["--skeleton", "h36m_17", "--jobs", "0"], "--jobs must be at least 1, got 0"),
    ],
)
def test_wrong_options_are_refused(
    tmp_path: Path, options: list[str], message: str, capsys: pytest.CaptureFixture[str]
):
    assert main(["live", str(rig_file(tmp_path)), *options, "--keypoints-port", str(free_port())]) == 2
    assert message in capsys.readouterr().err


def test_a_port_that_is_taken_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        arguments = ["live", str(rig_file(tmp_path)), "--skeleton", "h36m_17", "--zmq", str(port)]
        assert main([*arguments, "--keypoints-port", str(free_port())]) == 2
    assert str(port) in capsys.readouterr().err


def write_cell(folder: Path) -> Path:
    path = folder / "cell.toml"
    path.write_text(
        "min_observed_share = 0.1\n"
        "[volume]\nlow_m = [-1, -1, 0]\nhigh_m = [1, 1, 2]\n"
        "[zones.table]\nboxes = [{ low_m = [-0.3, -0.3, 0], high_m = [0.3, 0.3, 0.9] }]\n"
    )
    return path


@pytest.mark.slow
def test_distances_are_published(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    keypoints_port, distances_port, poses_port = free_port(), free_port(), free_port()
    arguments = ["live", str(rig_file(tmp_path)), "--skeleton", "h36m_17"]
    arguments += ["--keypoints-port", str(keypoints_port), "--distances", str(write_cell(tmp_path))]
    arguments += ["--distances-port", str(distances_port), "--poses-port", str(poses_port)]
    measured, faults = list[LinkDistance](), list[DistanceFault]()
    published, enough, stop = threading.Event(), threading.Event(), threading.Event()

    def is_over(frame: LiveFrame) -> bool:
        """The distance of somebody was received, and then, without images, that it is not to be believed any more."""
        if any(each.fault is None and each.person is not None and each.expected_m < 5 for each in measured):
            enough.set()
            faults.extend(filter(None, [measured[-1].fault] if are_all(frame, CameraState.LOST) else []))
        return bool(faults)

    stop_when(monkeypatch, is_over)

    def listen() -> None:
        with zmq.Context() as context, context.socket(zmq.SUB) as consumer, context.socket(zmq.PUSH) as robot:
            consumer.setsockopt(zmq.LINGER, 0)
            robot.setsockopt(zmq.LINGER, 0)
            consumer.subscribe(b"")
            consumer.connect(f"tcp://127.0.0.1:{distances_port}")
            robot.connect(f"tcp://127.0.0.1:{poses_port}")
            while not stop.is_set():
                if consumer.poll(50):
                    measured.extend(decode_distances(consumer.recv()))
                    published.set()
                    robot.send(encode_robot({}, reset=True))

    threads = [
        threading.Thread(target=send, args=(keypoints_port, published, enough)),
        threading.Thread(target=listen),
    ]
    for thread in threads:
        thread.start()
    try:
        assert main(arguments) == 0
    finally:
        enough.set()
        stop.set()
        for thread in threads:
            thread.join()
    said = capsys.readouterr()
    assert "Distances are no safety function" in said.err
    assert f"distances at tcp://127.0.0.1:{distances_port}: " in said.out
    near = [distance for distance in measured if distance.fault is None]
    assert {distance.link for distance in near} == {"table"}
    assert {distance.person for distance in near} <= {None, 0, 1}
    assert any(distance.person is not None and distance.distance_m < distance.expected_m < 5 for distance in near)
    # When the detectors stop, the cameras are lost, and what is said of the zone is not to be believed.
    assert faults


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("[zones.table]", "[zones.table.of]"), "cell.toml"),
        (("high_m = [0.3", "high_m = [9.3"), "zones.table: with all cameras ok"),
    ],
)
def test_a_wrong_cell_is_named(
    tmp_path: Path, change: tuple[str, str], message: str, capsys: pytest.CaptureFixture[str]
):
    cell = write_cell(tmp_path)
    cell.write_text(cell.read_text().replace(*change))
    arguments = ["live", str(rig_file(tmp_path)), "--skeleton", "h36m_17", "--keypoints-port", str(free_port())]
    assert main([*arguments, "--distances", str(cell)]) == 2
    assert message in capsys.readouterr().err
