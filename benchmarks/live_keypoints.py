"""The live system from keypoints: how late its frames are, and whether any is lost.

    python benchmarks/live_keypoints.py --frames 20000
    python benchmarks/live_keypoints.py --frames 7200 --busy 4

Runs ``fgpose live`` as a process of its own; another process sends the keypoints of simulated cameras over ZeroMQ, each
image when it is taken, as detectors elsewhere would. Prints a table of the time from taking the images to the arrival
of their frame at a consumer, of the longest time between two frames that were published, of how many images were lost,
and of cameras that were said not to be ok although they are.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from multiprocessing import Pipe, get_context
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import zmq
from rich.progress import Progress

from fgpose.io.calibration import save_rig
from fgpose.live.frame import CameraState, LiveFrame
from fgpose.live.outputs.frame_messages import decode_frame
from fgpose.live.reception.keypoint_messages import encode_keypoints
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import (
    CameraTimes,
    CrowdErrors,
    CrowdPlan,
    CrowdScene,
    DetectionNoise,
    Occlusion,
    crowd_motion,
    embedded_motion,
    ring_rig,
    simulate_crowd,
)

_SEED = 2
# People are found, estimators started and lengths learned meanwhile.
_SETTLED_S = 10.0
# The system, on a busy computer; then the process that sends gets all images.
_STARTS_WITHIN_S, _BEGINS_S, _ENCODES_S = 120.0, 5.0, 1e-3
# The first image of a camera may come so much later, the last frame so long after the last image.
_JOINS_S, _ANSWERS_S = 1.0, 2.0


@dataclass(frozen=True)
class Latency:
    """Of the frames after the system had settled."""

    n_frames: int
    n_people: int
    n_cameras: int
    rate_hz: float
    median_ms: float
    p95_ms: float
    p99_ms: float
    longest_ms: float
    gap_ms: float
    """The longest between two frames that were published, from the first image on."""
    n_images: int
    n_lost: int
    """Images that did not enter the estimate."""
    not_ok_s: float
    """Camera seconds in another state than ok, from a second after the first image on."""


def scene(n_people: int, n_cameras: int, n_frames: int, rate_hz: float) -> CrowdScene:
    """People who stay, with detections as a network gives them."""
    walks, works = [embedded_motion("cmu_02_01_short")], [embedded_motion("cmu_02_07_a")]
    plan = CrowdPlan(late_share=0.0, leaving_share=0.0, returning_share=0.0)
    motion = crowd_motion(n_people, n_frames, rate_hz, walks, works, _SEED, plan)
    rig = ring_rig(n_cameras, 5.0, 2.7, (0.0, 0.0, 0.9), focal_px=850.0, size_px=(1600, 1200))
    return simulate_crowd(motion, rig, DetectionNoise(), Occlusion(), CrowdErrors(), _SEED, CameraTimes(fps=(rate_hz,)))


def messages(recording: CrowdScene, begin_s: float) -> list[tuple[float, bytes]]:
    """When each image is taken (Unix time), and the message of its detector."""
    sizes = {camera.name: camera.size_px for camera in recording.rig.cameras}
    skeleton = recording.motion.skeleton.name
    return [
        (
            begin_s + image.time_s,
            encode_keypoints(
                image.camera, begin_s + image.time_s, sizes[image.camera], skeleton, image.points2d_px, image.confidence
            ),
        )
        for image in sorted(recording.observations.images, key=lambda image: image.time_s)
    ]


def stand_for_another_computer() -> None:
    """This process does not share the processor with others, where the user may say so."""
    with suppress(PermissionError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))


def send(port: int, coming: Connection) -> None:
    """As the detectors of all cameras: says that it is ready, and takes the images."""
    stand_for_another_computer()
    coming.send(True)
    images: list[tuple[float, bytes]] = coming.recv()
    if time.time() > images[0][0]:
        raise TimeoutError("the first images are due before they can be sent")
    with zmq.Context() as context, context.socket(zmq.PUSH) as detector:
        detector.connect(f"tcp://127.0.0.1:{port}")
        for taken_s, message in images:
            time.sleep(max(taken_s - time.time(), 0.0))
            detector.send(message)


@contextmanager
def busy(n_programs: int) -> Iterator[None]:
    """Other programs that want the processor."""
    # In sessions of their own, among which Linux shares the processor.
    command = [sys.executable, "-c", "while True: pass"]
    others = [subprocess.Popen(command, start_new_session=True) for _ in range(n_programs)]
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.wait()


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


@contextmanager
def subscribed(port: int) -> Iterator[zmq.Socket[bytes]]:
    """To the frames of a live system."""
    with zmq.Context() as context, context.socket(zmq.SUB) as frames:
        frames.setsockopt(zmq.LINGER, 0)
        frames.subscribe(b"")
        frames.connect(f"tcp://127.0.0.1:{port}")
        yield frames


def measure(
    n_people: int,
    n_cameras: int,
    n_frames: int,
    rate_hz: float,
    before: Sequence[str] = (),
    options: Sequence[str] = (),
) -> Latency:
    """A run of ``fgpose live``, with words before its command and options after it."""
    recording = scene(n_people, n_cameras, n_frames, rate_hz)
    skeleton = recording.motion.skeleton
    keypoints_port, frames_port = free_port(), free_port()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        save_rig(recording.rig, folder / "calibration.toml")
        tables = "".join(f'[cameras.{camera}]\nsource = "zmq"\n' for camera in recording.rig.names)
        (folder / "rig.toml").write_text(f'[live]\ncalibration = "calibration.toml"\n{tables}')
        command = [
            *before,
            sys.executable,
            "-m",
            "fgpose",
            "live",
            str(folder / "rig.toml"),
            "--skeleton",
            skeleton.name,
        ]
        ports = ["--keypoints-port", str(keypoints_port), "--zmq", str(frames_port)]
        system = subprocess.Popen([*command, *ports, *options], start_new_session=True)
        try:
            with subscribed(frames_port) as frames:
                if not frames.poll(round(1e3 * _STARTS_WITHIN_S)):
                    raise TimeoutError(f"fgpose live publishes nothing for {_STARTS_WITHIN_S:g} s")
                # Started as a new program, so that it shares nothing with this one.
                ours, its = Pipe()
                sender = get_context("spawn").Process(target=send, args=(keypoints_port, its))
                sender.start()
                ours.recv()
                stand_for_another_computer()
                images = messages(recording, time.time() + _BEGINS_S + _ENCODES_S * len(recording.observations.images))
                ours.send(images)
                received = _received(frames, images, skeleton)
                sender.join()
        finally:
            system.terminate()
            system.wait()
    percentiles = np.percentile([*received.delays_s.values()], [50, 95, 99, 100]) * 1e3
    assert received.last is not None
    n_used = sum(camera.n_used for camera in received.last.cameras)
    return Latency(
        len(received.delays_s),
        n_people,
        n_cameras,
        rate_hz,
        *percentiles.tolist(),
        gap_ms=1e3 * received.gap_s,
        n_images=len(images),
        n_lost=len(images) - n_used,
        not_ok_s=received.not_ok_s,
    )


@dataclass
class _Received:
    """By a consumer."""

    first_s: float
    last_s: float
    """When the first image was taken, and the last, Unix time."""
    delays_s: dict[float, float] = field(default_factory=dict)
    """Of the frames of images after settling."""
    gap_s: float = 0.0
    not_ok_s: float = 0.0
    last: LiveFrame | None = None

    def add(self, frame: LiveFrame) -> None:
        if frame.people and frame.time_s > self.first_s + _SETTLED_S:
            self.delays_s.setdefault(frame.time_s, time.time() - frame.time_s)
        if self.last is not None and self.last.published_s > self.first_s:
            since_s = frame.published_s - self.last.published_s
            self.gap_s = max(self.gap_s, since_s)
            if self.first_s + _JOINS_S < frame.published_s < self.last_s:
                self.not_ok_s += since_s * sum(camera.state is not CameraState.OK for camera in frame.cameras)
        self.last = frame


def _received(frames: zmq.Socket[bytes], images: list[tuple[float, bytes]], skeleton: Skeleton) -> _Received:
    """Everything that is published of these images."""
    first_s, last_s = images[0][0], images[-1][0]
    received = _Received(first_s, last_s)
    with Progress() as progress:
        task = progress.add_task(f"{len(images)} images", total=last_s - first_s)
        while time.time() < last_s + _ANSWERS_S:
            if frames.poll(50):
                received.add(decode_frame(frames.recv(), skeleton))
                progress.update(task, completed=time.time() - first_s)
    return received


def table(latency: Latency) -> str:
    heads = "people | cameras | rate | frames | median | 95 % | 99 % | longest | longest gap | images lost | not ok"
    figures = (latency.median_ms, latency.p95_ms, latency.p99_ms, latency.longest_ms, latency.gap_ms)
    milliseconds = " | ".join(f"{value:.1f} ms" for value in figures)
    return (
        f"| {heads} |\n|{'---|' * 11}\n| {latency.n_people} | {latency.n_cameras} | {latency.rate_hz:.0f} Hz | "
        f"{latency.n_frames} | {milliseconds} | {latency.n_lost} of {latency.n_images} | {latency.not_ok_s:.1f} s |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--frames", type=int, default=20_000)
    parser.add_argument("--people", type=int, default=2)
    parser.add_argument("--cameras", type=int, default=4)
    parser.add_argument("--rate-hz", type=float, default=30.0)
    parser.add_argument("--busy", type=int, default=0, help="programs that want the processor as well")
    parser.add_argument("--real-time", action="store_true", help="run it before all other programs (chrt --rr 1)")
    parser.add_argument("--no-diagnose", action="store_true", help="without the diagnosis of the last minute")
    parser.add_argument("--output", type=Path, help="write the figures to this file (JSON)")
    arguments = parser.parse_args()
    with busy(arguments.busy):
        before = ["chrt", "--rr", "1"] if arguments.real_time else []
        options = ["--no-diagnose"] if arguments.no_diagnose else []
        latency = measure(arguments.people, arguments.cameras, arguments.frames, arguments.rate_hz, before, options)
    print(table(latency))
    if arguments.output:
        arguments.output.write_text(json.dumps(asdict(latency), indent=1) + "\n")


if __name__ == "__main__":
    main()
