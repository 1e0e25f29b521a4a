"""The live system from videos over RTSP: what is used of four cameras of 1080p, how late, and what takes the processor.

    python benchmarks/live_rtsp.py --minutes 3

Plays the demonstration videos of one person, at 30 images a second, from an RTSP server in a process of its own to
``fgpose live`` with a recorder and a consumer (ZeroMQ). Prints how many images came and were used of each camera, the
delay from the capture of the newest image to the arrival of its frame at the consumer, and the processor time of each
stage. Needs GStreamer's RTSP server, see RTSP_PACKAGES.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import timed_stages
from fgpose.live.frame import LiveFrame
from fgpose.live.recording.played_cameras import RTSP_PACKAGES, Served, served
from fgpose.monocular.downloads.demo_videos import fetch_demo_videos
from fgpose.monocular.networks import open_network
from live_keypoints import free_port
from live_videos import received, start, there_and_back

_MODEL = "blazepose-lite"
# Of 60 images a second, which is what the videos have.
_EVERY = 2
# After which the clocks of the cameras are known, and the person.
_SETTLED_S = 30.0
_TICKS_HZ = os.sysconf("SC_CLK_TCK")
_OTHERS = "the RTSP server", "everything on this machine", "taken by other machines on the same computer"


@dataclass(frozen=True)
class Moment:
    """The consumer has got a frame."""

    arrived_s: float
    delay_s: float
    frame: LiveFrame
    others_s: tuple[float, ...]
    """Processor time so far of the server and of the machine, see _OTHERS."""


def rig_file(folder: Path, calibration: Path, videos: Sequence[Path], server: Served) -> Path:
    tables = [f'[cameras.{video.stem}]\nsource = "{server.address(video)}"\n' for video in videos]
    path = folder / "rtsp.toml"
    path.write_text(f'[live]\ncalibration = "{calibration}"\n' + "".join(tables))
    return path


def consumed(rig: Path, folder: Path, server: Served, minutes: float) -> list[Moment]:
    """Frames with new images after the system had settled."""
    skeleton, port, stop = open_network(_MODEL, max_people=1).skeleton, free_port(), threading.Event()
    times = folder / "times"
    times.mkdir()
    process = start(rig, folder / "rtsp.fgpose", "--zmq", str(port), environment=timed_stages.environment(times))
    moments, newest_s, first_s = list[Moment](), -np.inf, None
    try:
        for arrived_s, frame in received(port, skeleton, stop):
            if not frame.people or frame.time_s <= newest_s:
                continue
            newest_s, first_s = frame.time_s, arrived_s if first_s is None else first_s
            if arrived_s > first_s + _SETTLED_S:
                moments.append(Moment(arrived_s, arrived_s - frame.time_s, frame, others_s(server)))
            if arrived_s > first_s + _SETTLED_S + 60 * minutes:
                stop.set()
    finally:
        process.terminate()
        process.wait()
    return moments


def table_of_images(moments: Sequence[Moment]) -> str:
    first, last = moments[0], moments[-1]
    lasted_s = last.arrived_s - first.arrived_s
    delays_ms = 1e3 * np.array([moment.delay_s for moment in moments])
    median_ms, p95_ms, p99_ms = np.percentile(delays_ms, [50, 95, 99])
    lines = ["| camera | images/s that came | used | ok |", "|---|---:|---:|---:|"]
    for c, (before, after) in enumerate(zip(first.frame.cameras, last.frame.cameras, strict=True)):
        came_hz, used_hz = ((after.n_images - before.n_images) / lasted_s, (after.n_used - before.n_used) / lasted_s)
        ok = np.mean([moment.frame.cameras[c].state.value == "ok" for moment in moments])
        lines.append(f"| {after.name} | {came_hz:.1f} | {used_hz:.1f} | {ok:.1%} |")
    return "\n".join(
        [
            f"{lasted_s / 60:.1f} minutes, {len(moments) / lasted_s:.1f} frames/s; from the capture to the consumer: "
            f"median {median_ms:.0f} ms, 95 % {p95_ms:.0f} ms, 99 % {p99_ms:.0f} ms, longest {delays_ms.max():.0f} ms",
            "",
            *lines,
        ]
    )


def table_of_stages(taken_s: dict[str, float], lasted_s: float, n_images: int) -> str:
    """Of which n_images came in that time, of all cameras."""
    lines = ["| stage | share of a core | per image that came |", "|---|---:|---:|"]
    total = {**taken_s, "all of fgpose live": sum(taken_s.values())}
    for stage, seconds in total.items():
        lines.append(f"| {stage} | {seconds / lasted_s:.1%} | {1e3 * seconds / n_images:.2f} ms |")
    return "\n".join(lines)


def others_s(server: Served) -> tuple[float, ...]:
    """See _OTHERS."""
    of_server = Path(f"/proc/{server.process_id}/stat").read_text().rpartition(")")[2].split()
    user, nice, system, _, _, irq, softirq, stolen, *_ = map(
        int, Path("/proc/stat").read_text().splitlines()[0].split()[1:]
    )
    ticks = int(of_server[11]) + int(of_server[12]), user + nice + system + irq + softirq, stolen
    return tuple(each / _TICKS_HZ for each in ticks)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--minutes", type=float, default=3.0, help="after it has settled (default: %(default)s)")
    arguments = parser.parse_args()
    source = fetch_demo_videos(recording="Demo_SinglePerson", progress=print)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        videos = there_and_back(source / "videos", folder, _EVERY)
        with served(videos) as server:
            if server is None:
                raise SystemExit(f"GStreamer's RTSP server is not installed: apt install {RTSP_PACKAGES}")
            rig = rig_file(folder, source / "calibration" / "Calib.qca.txt", videos, server)
            moments = consumed(rig, folder, server, arguments.minutes)
        first, last = moments[0], moments[-1]
        lasted_s = last.arrived_s - first.arrived_s
        n_images = sum(camera.n_images for camera in last.frame.cameras)
        n_images -= sum(camera.n_images for camera in first.frame.cameras)
        taken_s = timed_stages.taken_s(folder / "times", first.arrived_s, last.arrived_s)
        mbits = [8e-6 * video.stat().st_size for video in videos]
    print(table_of_images(moments), "\n")
    print(table_of_stages(taken_s, lasted_s, n_images))
    for what, before_s, after_s in zip(_OTHERS, first.others_s, last.others_s, strict=True):
        print(f"{what}: {(after_s - before_s) / lasted_s:.1%} of a core")
    print(f"each round of the videos has {', '.join(f'{each:.1f}' for each in mbits)} Mbit")


if __name__ == "__main__":
    main()
