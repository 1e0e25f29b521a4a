"""Stage 1 on the demo videos: time per view, and agreement with MediaPipe's own pipeline. Needs the registries once.

    python benchmarks/stage1.py --devices cpu openvino

compares devices of the ONNX Runtime that is installed, in turns: images per second, processor time per image, and how
far the joints of each are from those of the first.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from fgpose.geometry.camera import Camera
from fgpose.monocular.detection import detect
from fgpose.monocular.downloads.models import pull
from fgpose.monocular.network import Image
from fgpose.monocular.networks.blazepose import BlazePose
from fgpose.monocular.networks.devices import Device
from metric import Metric
from scenario import demo_sources
from timing import Timing, timed

_REFERENCE = Path(__file__).parents[1] / "tests" / "data" / "mediapipe_reference" / "blazepose_full.npz"
_THREADS = 2
_WARM_UP_FRAMES = 3
_LIMITS_MS = {("blazepose-full", "tracking"): 15.0, ("blazepose-full", "detection in every frame"): 25.0}


def time_per_view(n_frames: int, models: tuple[str, ...]) -> list[Metric]:
    """From decoded image to people with absolute joints, one person, one view at a time; median over all views."""
    views = [(camera, list(_images(video, n_frames))) for camera, video in _cameras()]
    metrics = []
    for model in models:
        pulled = pull(model)
        for how, every in (("tracking", False), ("detection in every frame", True)):
            network = BlazePose(pulled.landmarks, pulled.detector, threads=_THREADS, detect_every_frame=every)
            timings = [timing for camera, images in views for timing in _timings(network, camera, images)]
            wall_ms, cpu_ms = np.median([(1e3 * timing.wall_s, 1e3 * timing.cpu_s) for timing in timings], axis=0)
            name = f"{model}, {how}: time per view, {_THREADS} threads"
            metrics.append(Metric(name, float(wall_ms), "ms", limit=_LIMITS_MS.get((model, how)), cpu=float(cpu_ms)))
    return metrics


def agreement_with_mediapipe() -> list[Metric]:
    """Landmarks of twelve frames against mediapipe 0.10.21; the README of the reference tells how they were made."""
    pulled, reference = pull("blazepose-full"), np.load(_REFERENCE)
    network = BlazePose(pulled.landmarks, pulled.detector, threads=_THREADS)
    off_px, off_mm = [], []
    for index, (_, video) in enumerate(_cameras()):
        images = list(_images(video, int(reference["frames"].max()) + 1))
        for frame, number in enumerate(reference["frames"]):
            found = network.landmarks.locate(images[number], network.detector.detect(images[number])[0])
            expected_px, expected_m = reference["points2d_px"][index, frame], reference["world_m"][index, frame]
            height_px = np.ptp(expected_px[:, 1])
            off_px.append(1000 / height_px * np.linalg.norm(found.points2d_px - expected_px, axis=1))
            off_mm.append(1000 * np.linalg.norm(found.world_m - expected_m, axis=1))
    name = "blazepose-full against mediapipe, 12 frames, median"
    return [
        Metric(f"{name}: 2D, person 1,000 px tall", float(np.median(off_px)), "px", limit=2.0, exact=True),
        Metric(f"{name}: relative 3D", float(np.median(off_mm)), "mm", limit=6.0, exact=True),
    ]


def parallel(n_frames: int, runs: int) -> list[Metric]:
    """All cameras beside each other on two cores against one after the other, decoding included; the runs alternate."""
    pulled = pull("blazepose-full")
    network = BlazePose(pulled.landmarks, pulled.detector, threads=1)
    sources = demo_sources()
    ratios = []
    for _ in range(runs):
        one, two = (timed(lambda jobs=jobs: detect(sources, network, jobs=jobs, frames=n_frames))[0] for jobs in (1, 2))
        ratios.append(one.wall_s / two.wall_s)
    return [Metric("four videos, two cameras at a time over one", float(np.median(ratios)), "x", "higher", limit=1.6)]


@dataclass(frozen=True)
class DeviceRuns:
    """A device at work on all images, once in each run."""

    device: Device
    images_hz: list[float]
    cpu_ms: list[float]
    """Processor time of an image."""
    off_px: float
    """Median distance of the joints from those of the first device."""


def devices(names: Sequence[Device], model: str, threads: int, jobs: int, n_frames: int, runs: int) -> list[DeviceRuns]:
    """BlazePose on each device in turn, from decoded images to people; so many cameras at a time as there are jobs."""
    pulled = pull(model)
    networks = [BlazePose(pulled.landmarks, pulled.detector, threads=threads, device=name) for name in names]
    views = [(camera, list(_images(video, n_frames))) for camera, video in _cameras()]
    n_images = sum(len(images) for _, images in views)
    joints = [_joints_px(network, views, jobs) for network in networks]  # warm from here on
    timings = [[timed(lambda each=each: _joints_px(each, views, jobs))[0] for each in networks] for _ in range(runs)]
    return [
        DeviceRuns(
            name,
            [n_images / timing.wall_s for timing in of_device],
            [1e3 * timing.cpu_s / n_images for timing in of_device],
            float(np.nanmedian(np.linalg.norm(joints_px - joints[0], axis=-1))),
        )
        for name, of_device, joints_px in zip(names, zip(*timings, strict=True), joints, strict=True)
    ]


def _joints_px(network: BlazePose, views: Sequence[tuple[Camera, list[Image]]], jobs: int) -> np.ndarray:
    """Of the first person in each image, (image, joint, 2); NaN without one."""

    def of_view(view: tuple[Camera, list[Image]]) -> list[np.ndarray]:
        tracker, nobody = network.tracker(view[0]), np.full((1, network.skeleton.n_joints, 2), np.nan)
        return [np.concatenate([tracker.detect(image).points2d_px, nobody])[0] for image in view[1]]

    with ThreadPoolExecutor(jobs) as pool:
        return np.concatenate(list(pool.map(of_view, views)))


def _device_table(all_runs: Sequence[DeviceRuns]) -> str:
    """Medians, and medians of the ratios to the first device in the same run."""
    first, rows = (
        all_runs[0],
        ["| device | images/s | over the first | processor time per image | over the first | joints |"],
    )
    rows.append("|---|---:|---:|---:|---:|---:|")
    for each in all_runs:
        rate = f"{np.median(each.images_hz):.1f} | {np.median(np.divide(each.images_hz, first.images_hz)):.2f}"
        cpu = f"{np.median(each.cpu_ms):.1f} ms | {np.median(np.divide(each.cpu_ms, first.cpu_ms)):.2f}"
        rows.append(f"| {each.device} | {rate} | {cpu} | {each.off_px:.3f} px |")
    return "\n".join(rows)


def _cameras() -> list[tuple[Camera, Path]]:
    """Each camera with its video; a video that is narrower than its calibration has a camera that fits."""
    sources = demo_sources()
    return [(camera, clip.path) for camera, clip in zip(sources.rig.cameras, sources.clips, strict=True)]


def _images(video: Path, n: int) -> Iterator[Image]:
    capture = cv2.VideoCapture(str(video))
    for _ in range(n):
        yield np.ascontiguousarray(capture.read()[1][..., ::-1])


def _timings(network: BlazePose, camera: Camera, images: list[Image]) -> list[Timing]:
    tracker = network.tracker(camera)
    return [timed(lambda image=image: tracker.detect(image), collect=False)[0] for image in images][_WARM_UP_FRAMES:]


def main() -> None:
    parser = argparse.ArgumentParser(description="BlazePose on several devices, in turns")
    parser.add_argument("--devices", nargs="+", default=["cpu"], help="as fgpose's --device (default: cpu)")
    parser.add_argument("--model", default="blazepose-full", help="default: %(default)s")
    parser.add_argument("--threads", type=int, default=1, help="of each run of a network (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=1, help="cameras at a time (default: %(default)s)")
    parser.add_argument("--frames", type=int, default=15, help="of each of the four videos (default: %(default)s)")
    parser.add_argument("--runs", type=int, default=9, help="of each device (default: %(default)s)")
    given = parser.parse_args()
    print(_device_table(devices(given.devices, given.model, given.threads, given.jobs, given.frames, given.runs)))


if __name__ == "__main__":
    main()
