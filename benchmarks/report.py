"""Time and size of reports: `python benchmarks/report.py`.

A result of one person of 60 s at 60 Hz from four cameras, without images: seconds to write its report, megabytes of the
file, and milliseconds until the first picture stands in the browser (navigation to the frame after the first plot).
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from fgpose.geometry.camera import CameraRig
from fgpose.io.skeletons import load_skeleton
from fgpose.report import FinishedRecording, write_report
from fgpose.trajectory import Status, Trajectory
from fgpose_benchmarks.synthetic import ring_rig, walking
from tests.fgpose.browser import BROWSER, browser

SECONDS, FPS, RUNS = 60, 60.0, 5


def recording(rig: CameraRig) -> FinishedRecording:
    """Somebody who walks to and fro: the content does not matter for the time, the size of the arrays does."""
    skeleton, rng, n_frames = load_skeleton("h36m_17"), np.random.default_rng(0), int(SECONDS * FPS)
    stride_m = walking(60, FPS, skeleton)
    phase = np.arange(n_frames) % 118
    positions_m = stride_m[np.minimum(phase, 118 - phase)] + rng.normal(scale=0.002, size=(n_frames, 17, 3))
    sigma_m = rng.uniform(0.008, 0.014, (n_frames, 17))
    trajectory = Trajectory(
        skeleton=skeleton,
        time_s=np.arange(n_frames) / FPS,
        positions_m=positions_m,
        status=np.full((n_frames, 17), Status.OBSERVED, dtype=np.int8),
        covariance_m2=sigma_m[..., None, None] ** 2 * np.eye(3),
        residual_px=rng.rayleigh(4.0, (n_frames, rig.n_cameras, 17)),
        visibility=rng.uniform(0.8, 1.0, (n_frames, rig.n_cameras, 17)),
        camera_names=rig.names,
    )
    return FinishedRecording("walk", {0: trajectory}, rig)


def first_picture_ms(path: Path) -> float:
    with browser(path.as_uri()) as page:
        page.wait_for("performance.getEntriesByName('first plot').length > 0")
        return float(page.value("performance.getEntriesByName('first plot')[0].startTime"))


def main() -> None:
    made = recording(ring_rig(4))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "report.html"
        begin_s, begin_cpu_s = time.perf_counter(), time.process_time()
        write_report(made, path)
        print(f"report of {SECONDS} s, s: {time.perf_counter() - begin_s:.2f} (at most 10)")
        print(f"of it in the process, s: {time.process_time() - begin_cpu_s:.2f}")
        print(f"file, MB: {path.stat().st_size / 1e6:.2f} (at most 5)")
        if BROWSER is None:
            print("first picture: no Chromium is installed")
            return
        shown_ms = sorted(first_picture_ms(path) for _ in range(RUNS))
        print(
            f"first picture, ms: median {shown_ms[RUNS // 2]:.0f}, slowest {shown_ms[-1]:.0f} of {RUNS} (at most 1000)"
        )


if __name__ == "__main__":
    main()
