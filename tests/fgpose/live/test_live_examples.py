"""The programs of examples/live run as a user would run them, and are what the documentation shows."""

from __future__ import annotations

import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from fgpose.io.skeletons import load_skeleton
from fgpose.live.frame import CameraState, CameraStatus, LiveFrame
from fgpose.live.outputs import open_lsl_output, open_zmq_output
from fgpose.live.outputs.mcap_output import McapSink
from fgpose.live.outputs.output import BackgroundOutput
from fgpose.live.reception.keypoint_socket import KeypointSocket
from fgpose.live.tracking.observed import Volume
from fgpose.robot.cell import Capsule, Cell, Limits, Link
from fgpose.robot.distance_server import DistanceServer
from fgpose_benchmarks.synthetic import ring_rig
from tests.fgpose.live.output_frames import SKELETON, frame, free_port

ROOT = Path(__file__).parents[3]
EXAMPLES = ROOT / "examples" / "live"


@contextmanager
def running(name: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-W", "error", str(EXAMPLES / name), *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def lines_of_frame(output: BackgroundOutput, process: subprocess.Popen[str], n_lines: int) -> list[str]:
    """What a consumer prints, while the same frame is published over and over."""
    assert process.stdout is not None
    has_printed = threading.Event()

    def publish() -> None:
        while not has_printed.wait(0.01):
            output.publish(frame(3))

    publisher = threading.Thread(target=publish)
    publisher.start()
    try:
        return [process.stdout.readline() for _ in range(n_lines)]
    finally:
        has_printed.set()
        publisher.join()


def test_a_zmq_consumer_prints_the_people() -> None:
    output = open_zmq_output(port := free_port())
    with running("zmq_consumer.py", f"tcp://127.0.0.1:{port}") as process:
        lines = lines_of_frame(output, process, 3)
    output.close()
    assert lines[0] == "3 2 people, 75% observed\n"
    assert re.match(r"4 confirmed pelvis \[4\. +0\.03 +0\. *\]", lines[1]), lines


def test_an_lsl_consumer_prints_a_person() -> None:
    output = open_lsl_output(SKELETON, now_s=time.time, name="fgpose example")
    with running("lsl_consumer.py", "fgpose example 1") as process:
        (line,) = lines_of_frame(output, process, 1)
    output.close()
    assert "'pelvis_X': 7.0" in line


def test_an_mcap_consumer_prints_the_people(tmp_path: Path) -> None:
    sink = McapSink(tmp_path / "people.mcap")
    sink.send(frame(3))
    sink.close()
    with running("mcap_consumer.py", str(tmp_path / "people.mcap")) as process:
        assert process.stdout is not None
        assert process.stdout.read().splitlines()[0] == "3 4 confirmed pelvis 4.0 0.03 0.0"


def test_what_a_detector_sends_arrives() -> None:
    rig, coco = ring_rig(), load_skeleton("coco_17")
    camera = rig.cameras[2]
    with KeypointSocket(rig, coco, port=0) as socket:
        size = map(str, camera.size_px)
        with running("keypoint_detector.py", camera.name, *size, socket.address):
            first, second = socket.receive(20.0), socket.receive(20.0)
        assert first is not None
        assert second is not None
        assert socket.rejected == ()
    assert (first.detections.camera, first.detections.n_people) == (camera.name, 2)
    assert first.detections.time_s < second.detections.time_s
    assert np.isfinite(first.detections.points2d_px).all()


def test_a_robot_hears_distances() -> None:
    arm = Link("forearm", (Capsule((0.0, 0.0, 0.0), (0.0, 0.0, 0.4), 0.05),))
    cell = Cell((arm,), Limits(min_observed_share=0.01), Volume((-1.0, -1.0, 0.2), (1.0, 1.0, 1.8)))
    rig, coco = ring_rig(), load_skeleton("coco_17")
    statuses = tuple(CameraStatus(name, CameraState.OK, unproven_s=0.0) for name in rig.names)
    server = DistanceServer(cell, rig, coco, port=0, poses_port=0, now_s=lambda: 1000.0)
    server.publish(LiveFrame(0, 1000.0, 1000.0, coco, (), statuses, 1.0, 940.0))
    with running("robot.py", server.poses_address, server.address) as process:
        assert process.stdout is not None
        assert "forearm inf None\n" in process.stdout
        server.close()
        assert "no distances: this is a fault too\n" in process.stdout


@pytest.mark.parametrize("name", sorted(path.name for path in EXAMPLES.glob("*.py")))
def test_the_documentation_shows_the_example_itself(name: str) -> None:
    text = "".join((ROOT / "docs" / page).read_text() for page in ("live_messages.md", "live_distances.md"))
    shown = text.partition(f"`examples/live/{name}`:")[2].partition("```python\n")[2].partition("```")[0]
    assert shown
    assert (EXAMPLES / name).read_text().endswith(shown)
