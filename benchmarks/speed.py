"""Time and memory of fgpose alone: batch, online, covariance, import."""

from __future__ import annotations

import subprocess
import sys
from typing import Literal

import numpy as np

import fgpose
from fgpose_benchmarks.synthetic import NO_OCCLUSION, Occlusion
from isolated import Solver, run_isolated
from metric import Metric
from scenario import POSITIONS_ONLY, scene, scene_of_33_joints
from timing import Timing, timed

_IMPORT = "import time; import numpy, gtsam; t = time.perf_counter(); import fgpose; print(time.perf_counter() - t)"
_LONG_FRAMES = 10_000
_WARM_UP_FRAMES = 50
"""Twice the lag: by then the online window is full and everything is imported."""


def _median_ms(timings: list[Timing], n_frames: int) -> tuple[float, float]:
    """Median wall and processor time per frame."""
    wall_s, cpu_s = np.median([(timing.wall_s, timing.cpu_s) for timing in timings], axis=0)
    return float(1e3 * wall_s / n_frames), float(1e3 * cpu_s / n_frames)


def batch(n_frames: int, runs: int) -> list[Metric]:
    """A short recording, everything included but the covariances, which have a metric of their own."""
    short = scene(n_frames)
    timings = [timed(lambda: fgpose.smooth(short.observations, short.rig, POSITIONS_ONLY))[0] for _ in range(runs)]
    wall_ms, cpu_ms = _median_ms(timings, n_frames)
    return [Metric(f"batch, {n_frames} frames: time", wall_ms, "ms/frame", limit=3.0, cpu=cpu_ms)]


def batch_long(n_frames: int) -> list[Metric]:
    """A long recording in a fresh process."""
    result = run_isolated("batch", scene(n_frames).observations)
    name = f"batch, {n_frames} frames"
    # A recording of a few windows pays as much again for the sample from which it learns its bone lengths.
    limit = 1.3 if n_frames >= _LONG_FRAMES else None
    return [
        Metric(f"{name}: time", result["wall_ms"], "ms/frame", cpu=result["cpu_ms"]),
        # By processor time: the two parts lie a minute apart, in which the load of a shared machine changes.
        Metric(
            f"{name}: CPU time per frame over that of 300", result["cpu_ms"] / result["short_cpu_ms"], "x", limit=limit
        ),
        Metric(f"{name}: peak resident memory", result["peak_mb"], "MB", limit=1500.0),
    ]


# Medians and 99th percentiles of an update, in ms.
_LIMITS_MS: dict[tuple[Solver, int], tuple[float, float]] = {
    ("isam2", 17): (7.0, 16.0),
    ("window", 17): (2.5, 5.0),
    ("window", 33): (6.0, 12.0),
}


def online(n_frames: int, solver: Solver, n_joints: Literal[17, 33] = 17) -> list[Metric]:
    """Latency of an update, with covariance and residuals, lag 0.5 s; 17 joints at 50 Hz, or 33 at 60 Hz. Once all work
    is in the update, once the estimator is tidied between the images, as by `fgpose live`."""
    recording = scene(n_frames) if n_joints == 17 else scene_of_33_joints(n_frames)
    name, metrics = f"online by {solver}, {n_joints} joints, {n_frames} frames", []
    limits_ms = _LIMITS_MS.get((solver, n_joints), (None, None))
    for tidied in (False, True):
        result = run_isolated(solver, recording.observations, tidied=tidied)
        wall_ms, cpu_ms = (np.array(result[clock])[_WARM_UP_FRAMES:] for clock in ("wall_ms", "cpu_ms"))
        for what, percent, limit in zip(("median update", "99th percentile"), (50, 99), limits_ms, strict=True):
            label = f"{name}: {what}{', tidied between images' if tidied else ''}"
            latency_ms, of_cpu_ms = float(np.percentile(wall_ms, percent)), float(np.percentile(cpu_ms, percent))
            metrics.append(Metric(label, latency_ms, "ms", limit=limit, cpu=of_cpu_ms))
    return metrics


def online_occluded(n_frames: int, solver: Solver) -> list[Metric]:
    """How much longer an update takes where three of the four cameras are occluded."""
    clear_ms, occluded_ms = (
        np.median(run_isolated(solver, scene(n_frames, occlusion).observations)["wall_ms"][_WARM_UP_FRAMES:])
        for occlusion in (NO_OCCLUSION, Occlusion())
    )
    name = f"online by {solver}, 17 joints, {n_frames} frames: median update, occluded over clear"
    return [Metric(name, float(occluded_ms / clear_ms), "x", limit=1.3)]


def online_long(n_frames: int, solver: Solver) -> list[Metric]:
    """Whether memory and time stay flat: the last quarter of a long run against the second."""
    result = run_isolated(solver, scene(n_frames).observations)
    resident_mb, wall_ms, cpu_ms = (
        np.array_split(np.array(result[name]), 4) for name in ("resident_mb", "wall_ms", "cpu_ms")
    )
    name = f"online by {solver}, {n_frames} frames, last quarter over second"
    cpu_ratio = float(np.median(cpu_ms[3]) / np.median(cpu_ms[1]))
    memory_ratio = resident_mb[3].mean() / resident_mb[1].mean()
    calls_before, calls_at_end = result["calls"]
    # The calls of a few frames depend on what these show.
    calls_limit = 1.02 if n_frames >= _LONG_FRAMES else None
    return [
        Metric(f"{name}: resident memory", float(memory_ratio), "x", limit=1.02, exact=True),
        Metric(f"{name}: function calls of an update", calls_at_end / calls_before, "x", limit=calls_limit, exact=True),
        Metric(
            f"{name}: median update",
            float(np.median(wall_ms[3]) / np.median(wall_ms[1])),
            "x",
            limit=1.1,
            cpu=cpu_ratio,
        ),
        Metric(f"online, {n_frames} frames: resident memory at the end", float(resident_mb[3][-1]), "MB"),
    ]


def covariance(n_frames: int, runs: int) -> list[Metric]:
    """What the covariances of all joints in all frames cost on top of the solution; the runs alternate."""
    short = scene(n_frames)
    ratios = []
    for _ in range(runs):
        without, _ = timed(lambda: fgpose.smooth(short.observations, short.rig, POSITIONS_ONLY))
        full, _ = timed(lambda: fgpose.smooth(short.observations, short.rig))
        ratios.append((full.wall_s / without.wall_s - 1, full.cpu_s / without.cpu_s - 1))
    wall, cpu = np.median(ratios, axis=0)
    return [
        Metric("covariance of all joints and frames over the solution", float(wall), "x", limit=2.0, cpu=float(cpu))
    ]


def import_time(runs: int) -> list[Metric]:
    """`import fgpose` after numpy and gtsam, in fresh processes."""
    times_s = [
        float(subprocess.run([sys.executable, "-c", _IMPORT], check=True, stdout=subprocess.PIPE, text=True).stdout)
        for _ in range(runs + 1)
    ]
    # The first run may have to compile and to read from disk.
    return [Metric("import fgpose beyond numpy and gtsam", float(np.median(times_s[1:])), "s", limit=0.3)]
