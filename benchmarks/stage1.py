"""Stage 1 on the demo videos: time per view, and agreement with MediaPipe's own pipeline. Needs the registries once."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from fgpose.geometry.camera import Camera
from fgpose.monocular.detection import detect
from fgpose.monocular.downloads.models import pull
from fgpose.monocular.network import Image
from fgpose.monocular.networks.blazepose import BlazePose
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
