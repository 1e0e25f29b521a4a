"""The live system from keypoints: how late its frames are, and whether any is lost.

    python benchmarks/live_keypoints.py --frames 20000

Runs ``fgpose live`` as a process of its own; another process sends the keypoints of simulated cameras over ZeroMQ, each
image when it is taken, as detectors elsewhere would. Prints a table of the time from taking the images to the arrival
of their frame at a consumer, and of how many images were lost.
"""

from __future__ import annotations

import argparse
import json
import socket
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import zmq
from rich.progress import Progress

from fgpose.io.calibration import save_rig
from fgpose.live.frame import LiveFrame
from fgpose.live.outputs.frame_messages import decode_frame
from fgpose.live.reception.keypoint_messages import encode_keypoints
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import (
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
_BEGINS_S = 5.0
"""Until the system runs."""


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
    n_lost: int
    """Images that did not enter the estimate."""


def scene(n_people: int, n_cameras: int, n_frames: int, rate_hz: float) -> CrowdScene:
    """People who stay, with detections as a network gives them."""
    walks, works = [embedded_motion("cmu_02_01_short")], [embedded_motion("cmu_02_07_a")]
    plan = CrowdPlan(late_share=0.0, leaving_share=0.0, returning_share=0.0)
    motion = crowd_motion(n_people, n_frames, rate_hz, walks, works, _SEED, plan)
    rig = ring_rig(n_cameras, 5.0, 2.7, (0.0, 0.0, 0.9), focal_px=850.0, size_px=(1600, 1200))
    return simulate_crowd(motion, rig, DetectionNoise(), Occlusion(), CrowdErrors(), _SEED)


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


def send(port: int, images: list[tuple[float, bytes]]) -> None:
    """As the detectors of all cameras."""
    with zmq.Context() as context, context.socket(zmq.PUSH) as detector:
        detector.connect(f"tcp://127.0.0.1:{port}")
        for taken_s, message in images:
            time.sleep(max(taken_s - time.time(), 0.0))
            detector.send(message)


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


def measure(n_people: int, n_cameras: int, n_frames: int, rate_hz: float) -> Latency:
    recording = scene(n_people, n_cameras, n_frames, rate_hz)
    skeleton = recording.motion.skeleton
    keypoints_port, frames_port = free_port(), free_port()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        save_rig(recording.rig, folder / "calibration.toml")
        tables = "".join(f'[cameras.{camera}]\nsource = "zmq"\n' for camera in recording.rig.names)
        (folder / "rig.toml").write_text(f'[live]\ncalibration = "calibration.toml"\n{tables}')
        command = [sys.executable, "-m", "fgpose", "live", str(folder / "rig.toml"), "--skeleton", skeleton.name]
        system = subprocess.Popen([*command, "--keypoints-port", str(keypoints_port), "--zmq", str(frames_port)])
        images = messages(recording, time.time() + _BEGINS_S)
        # Started as a new program, so that it shares nothing with this one.
        sender = get_context("spawn").Process(target=send, args=(keypoints_port, images))
        sender.start()
        try:
            delays_s, last = _received(frames_port, images, skeleton)
        finally:
            sender.join()
            system.terminate()
            system.wait()
    n_used = sum(camera.n_used for camera in last.cameras)
    percentiles = np.percentile(delays_s, [50, 95, 99, 100]) * 1e3
    return Latency(len(delays_s), n_people, n_cameras, rate_hz, *percentiles.tolist(), n_lost=len(images) - n_used)


def _received(port: int, images: list[tuple[float, bytes]], skeleton: Skeleton) -> tuple[list[float], LiveFrame]:
    """Delays of the frames after settling, and the last frame."""
    first_s, last_s = images[0][0], images[-1][0]
    delays_s: dict[float, float] = {}
    frame = None
    with zmq.Context() as context, context.socket(zmq.SUB) as consumer:
        consumer.setsockopt(zmq.LINGER, 0)
        consumer.subscribe(b"")
        consumer.connect(f"tcp://127.0.0.1:{port}")
        with Progress() as progress:
            task = progress.add_task(f"{len(images)} images", total=last_s - first_s)
            while time.time() < last_s + 1.0:
                if not consumer.poll(50):
                    continue
                frame = decode_frame(consumer.recv(), skeleton)
                progress.update(task, completed=time.time() - first_s)
                if frame.people and frame.time_s > first_s + _SETTLED_S:
                    delays_s.setdefault(frame.time_s, time.time() - frame.time_s)
    assert frame is not None
    return [*delays_s.values()], frame


def table(latency: Latency) -> str:
    heads = "people | cameras | rate | frames | median | 95 % | 99 % | longest | images lost"
    figures = (latency.median_ms, latency.p95_ms, latency.p99_ms, latency.longest_ms)
    milliseconds = " | ".join(f"{value:.1f} ms" for value in figures)
    return (
        f"| {heads} |\n|{'---|' * 9}\n| {latency.n_people} | {latency.n_cameras} | {latency.rate_hz:.0f} Hz | "
        f"{latency.n_frames} | {milliseconds} | {latency.n_lost} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--frames", type=int, default=20_000)
    parser.add_argument("--people", type=int, default=2)
    parser.add_argument("--cameras", type=int, default=4)
    parser.add_argument("--rate-hz", type=float, default=30.0)
    parser.add_argument("--output", type=Path, help="write the figures to this file (JSON)")
    arguments = parser.parse_args()
    latency = measure(arguments.people, arguments.cameras, arguments.frames, arguments.rate_hz)
    print(table(latency))
    if arguments.output:
        arguments.output.write_text(json.dumps(asdict(latency), indent=1) + "\n")


if __name__ == "__main__":
    main()
