"""The live system from real videos played in real time: how late its frames are, and what its hurry costs.

    python benchmarks/live_videos.py --minutes 30

Runs ``fgpose live`` as a process of its own on the demonstration videos of one person, each played forwards and
backwards again and again, so that nobody jumps. Prints a table of the delay from the capture of the newest image to the
arrival of the frame at a consumer (ZeroMQ), early and late in the run; of the rate of detections; and of the error
against the unhurried result, for which every image is looked at: undisturbed, and while other programs take so much of
the processor that the rate is halved.

    python benchmarks/live_videos.py --messages

prints which share of the processor time the messages between the processes take, and pictures, where every image is
looked at, however long that takes: so the load of the machine does not count.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import av
import numpy as np

import timed_messages
from fgpose.child_process import n_cores
from fgpose.live.frame import LiveFrame
from fgpose.live.outputs.frame_messages import decode_frame
from fgpose.live.recording.live_recording import LiveRecording, load_live_recording
from fgpose.monocular.downloads.demo_videos import fetch_demo_videos
from fgpose.monocular.networks import open_network
from fgpose.skeleton import Skeleton
from live_keypoints import busy, free_port, subscribed

_MODEL = "blazepose-lite"
# After which the people are known and what is learned at first is learned.
_SETTLED_S = 20.0
# Recordings begin together; the time of the beginning is known to an image or two.
_SHIFTS = np.arange(-3, 4)
_FPS = 60.0
_CODEC = {"preset": "fast", "crf": "20", "bf": "0"}


@dataclass(frozen=True)
class LiveRun:
    """A run of the live system, all after it had settled."""

    name: str
    minutes: float
    frames_hz: float
    """Frames with new images."""
    images_hz: float
    """Detections that were used, of each camera."""
    median_ms: float
    p95_ms: float
    p99_ms: float
    first_ms: float
    """Median delay of the first quarter."""
    last_ms: float
    """Of the last quarter."""
    mpjpe_mm: float
    """From the unhurried result."""


def there_and_back(videos: Path, folder: Path, every: int = 1) -> list[Path]:
    """Each video forwards and backwards, one image in so many, encoded as cameras do: a key frame a second, no frame
    that refers to a later one."""
    files = []
    for video in sorted(videos.glob("*.mp4")):
        path = folder / video.name
        frames = [frame.to_ndarray(format="yuv420p") for frame in av.open(str(video)).decode(video=0)][::every]
        with av.open(str(path), "w") as container:
            rate = round(_FPS / every)
            stream = container.add_stream("libx264", rate=rate, options=_CODEC | {"g": str(rate)})
            stream.height, stream.width = frames[0].shape[0] * 2 // 3, frames[0].shape[1]
            stream.pix_fmt = "yuv420p"
            for frame in frames + frames[-2:0:-1]:
                container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="yuv420p")))
            container.mux(stream.encode(None))
        files.append(path)
    return files


def rig_file(folder: Path, calibration: Path, videos: Sequence[Path], *, fast: bool) -> Path:
    how = 'pace = "fast"' if fast else "loop = true"
    tables = [f'[cameras.{video.stem}]\nsource = "{video}"\n{how}\n' for video in videos]
    path = folder / ("fast.toml" if fast else "live.toml")
    path.write_text(f'[live]\ncalibration = "{calibration}"\n' + "".join(tables))
    return path


def start(
    rig: Path, record: Path, *options: str, environment: Mapping[str, str] | None = None
) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "fgpose", "live", str(rig), "--model", _MODEL, "--max-people", "1"]
    return subprocess.Popen([*command, "--record", str(record), *options], env=environment)


def share_of_messages(rig: Path, folder: Path, minutes: float) -> str:
    """A table of processor time: of all processes, of their messages, and of pictures."""
    options = ("--page", str(free_port()), "--duration-s", str(60 * minutes))
    times = folder / "times"
    times.mkdir()
    process = start(rig, folder / "messages.fgpose", *options, environment=timed_messages.environment(times))
    if process.wait():
        raise RuntimeError(f"fgpose live ended with status {process.returncode}")
    return timed_messages.table(times)


def unhurried(folder: Path, calibration: Path, videos: Sequence[Path]) -> tuple[np.ndarray, np.ndarray]:
    """Times since the beginning and poses where every image was looked at: the second of two rounds."""
    with av.open(str(videos[0])) as container:
        n_images = container.streams.video[0].frames
    record = folder / "unhurried.fgpose"
    process = start(rig_file(folder, calibration, videos, fast=True), record)
    try:
        while not (record.exists() and _n_images(record, n_images - 1)):
            time.sleep(2.0)
            if process.poll() is not None:
                raise RuntimeError(f"fgpose live ended with status {process.returncode}")
    finally:
        process.terminate()
        process.wait()
    recording = load_live_recording(record)
    begin_s = _begin_s(recording)
    poses = {frame.time_s - begin_s: frame.people[0].positions_m for frame in recording.frames() if frame.people}
    return np.array([*poses]), np.stack([*poses.values()])


def _n_images(record: Path, n: int) -> bool:
    """Whether each camera has had so many images."""
    last: dict[str, int] = {}
    for images in load_live_recording(record).updates():
        for image in images:
            last[image.detections.camera] = last.get(image.detections.camera, 0) + 1
    return len(last) == 4 and min(last.values()) >= n


def _begin_s(recording: LiveRecording) -> float:
    return min(image.detections.time_s for images in recording.updates() for image in images)


def received(port: int, skeleton: Skeleton, stop: threading.Event) -> Iterator[tuple[float, LiveFrame]]:
    """Frames as a consumer gets them, and when (Unix time)."""
    with subscribed(port) as frames:
        while not stop.is_set():
            if frames.poll(100):
                message = frames.recv()
                yield time.time(), decode_frame(message, skeleton)


def measure(
    name: str, rig: Path, record: Path, skeleton: Skeleton, minutes: float, truth: tuple[np.ndarray, np.ndarray]
) -> LiveRun:
    port, stop = free_port(), threading.Event()
    process = start(rig, record, "--zmq", str(port))
    threading.Timer(60 * minutes + _SETTLED_S + 10.0, stop.set).start()
    delays: list[tuple[float, float]] = []
    poses: dict[float, np.ndarray] = {}
    n_used: list[tuple[float, int]] = []
    first_s = None
    try:
        for arrived_s, frame in received(port, skeleton, stop):
            if not frame.people or frame.time_s in poses:
                continue
            first_s = arrived_s if first_s is None else first_s
            if arrived_s > first_s + _SETTLED_S:
                delays.append((arrived_s, arrived_s - frame.time_s))
                n_used.append((arrived_s, sum(camera.n_used for camera in frame.cameras)))
                poses[frame.time_s] = frame.people[0].positions_m
    finally:
        process.terminate()
        process.wait()
    at_s, delay_s = np.array(delays).T
    quarter = max(len(delay_s) // 4, 1)
    lasted_s = at_s[-1] - at_s[0]
    percentiles = (1e3 * np.percentile(delay_s, [50, 95, 99])).tolist()
    return LiveRun(
        name,
        lasted_s / 60,
        len(delay_s) / lasted_s,
        (n_used[-1][1] - n_used[0][1]) / lasted_s / 4,
        *percentiles,
        first_ms=1e3 * float(np.median(delay_s[:quarter])),
        last_ms=1e3 * float(np.median(delay_s[-quarter:])),
        mpjpe_mm=_mpjpe_mm(poses, _begin_s(load_live_recording(record)), truth),
    )


def _mpjpe_mm(poses: dict[float, np.ndarray], begin_s: float, truth: tuple[np.ndarray, np.ndarray]) -> float:
    """Mean distance from the unhurried pose at the same place in the videos."""
    times_s, true_m = truth
    period_s = (2 * 100 - 2) / _FPS
    at_s = (np.array([*poses]) - begin_s) % period_s
    live_m = np.stack([*poses.values()])
    errors = []
    for shift in _SHIFTS:
        wanted_s = (at_s + shift / _FPS) % period_s
        inside = (wanted_s >= times_s[0]) & (wanted_s <= times_s[-1])
        after = np.clip(np.searchsorted(times_s, wanted_s), 1, len(times_s) - 1)
        share = ((wanted_s - times_s[after - 1]) / (times_s[after] - times_s[after - 1]))[:, None, None]
        expected_m = (1 - share) * true_m[after - 1] + share * true_m[after]
        errors.append(float(np.nanmean(np.linalg.norm(live_m - expected_m, axis=-1)[inside])))
    return 1e3 * min(errors)


def table(runs: Sequence[LiveRun]) -> str:
    lines = [
        "| run | minutes | frames/s | images/s of each camera | median | 95 % | 99 % | first quarter | last quarter | "
        "from the unhurried |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for run in runs:
        milliseconds = " | ".join(
            f"{value:.0f} ms" for value in (run.median_ms, run.p95_ms, run.p99_ms, run.first_ms, run.last_ms)
        )
        lines.append(
            f"| {run.name} | {run.minutes:.0f} | {run.frames_hz:.1f} | {run.images_hz:.1f} | {milliseconds} | "
            f"{run.mpjpe_mm:.1f} mm |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--minutes", type=float, default=2.0, help="of the undisturbed run (default: %(default)s)")
    parser.add_argument("--loaded-minutes", type=float, default=1.0, help="of the other (default: %(default)s)")
    parser.add_argument("--busy", type=int, default=n_cores(), help="programs that want the processor as well")
    parser.add_argument("--messages", action="store_true", help="only print what messages take, over --minutes")
    parser.add_argument("--output", type=Path, help="write the figures to this file (JSON)")
    arguments = parser.parse_args()
    source = fetch_demo_videos(recording="Demo_SinglePerson", progress=print)
    calibration = source / "calibration" / "Calib.qca.txt"
    skeleton = open_network(_MODEL, max_people=1).skeleton
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        videos = there_and_back(source / "videos", folder)
        if arguments.messages:
            rig = rig_file(folder, calibration, videos, fast=True)
            print(share_of_messages(rig, folder, arguments.minutes))
            return
        truth = unhurried(folder, calibration, videos)
        rig = rig_file(folder, calibration, videos, fast=False)
        runs = [measure("undisturbed", rig, folder / "a.fgpose", skeleton, arguments.minutes, truth)]
        with busy(arguments.busy):
            loaded = f"beside {arguments.busy} busy programs"
            runs.append(measure(loaded, rig, folder / "b.fgpose", skeleton, arguments.loaded_minutes, truth))
    print(table(runs))
    if arguments.output:
        arguments.output.write_text(json.dumps([asdict(run) for run in runs], indent=1) + "\n")


if __name__ == "__main__":
    main()
