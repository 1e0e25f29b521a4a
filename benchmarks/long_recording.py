"""Memory, time and files of ``fgpose smooth`` on a long recording, beside those of a minute.

``python benchmarks/long_recording.py --minutes 10`` makes recordings of the scenario of this folder at 60 Hz, runs the
command on each in a process of its own, and prints a table.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from fgpose import save_rig
from fgpose.io.keypoints import save_observations
from scenario import scene

_FPS = 60
_KIB_PER_MB = 1e6 / 1024


@dataclass(frozen=True)
class Measured:
    minutes: float
    peak_mb: float
    """Largest resident memory of the process."""
    cpu_ms: float
    """Processor time for each frame, everything included but the start of the program."""
    rrd_mb: float


def measured(minutes: float, folder: Path, *, with_3d: bool) -> Measured:
    """One run of the command."""
    name, n_frames = f"{minutes:g}", round(minutes * 60 * _FPS)
    recording, rig, output = folder / f"{name}.npz", folder / "rig.toml", folder / "out"
    # In a process of its own: a command starts as a copy of the process that runs it, whose largest memory counts as
    # its own for ever.
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as apart:
        apart.submit(_make, n_frames, recording, rig, with_3d=with_3d).result()
    start_s, _ = _run("--version")
    source = [str(recording), "--rig", str(rig), "--skeleton", "h36m_17"]
    cpu_s, peak_mb = _run("smooth", *source, "--output", str(output))
    return Measured(minutes, peak_mb, 1e3 * (cpu_s - start_s) / n_frames, (output / f"{name}.rrd").stat().st_size / 1e6)


def _make(n_frames: int, recording: Path, rig: Path, *, with_3d: bool) -> None:
    """Write a recording and its rig."""
    made = scene(n_frames)
    observations = replace(made.observations, time_s=np.arange(n_frames) / _FPS)
    if not with_3d:
        observations = replace(observations, points3d_m=None, covariance3d_m2=None)
    save_observations(observations, recording)
    save_rig(made.rig, rig)


def _run(*arguments: str) -> tuple[float, float]:
    """Processor time, seconds, and the largest resident memory, megabytes, of fgpose with these arguments."""
    process = subprocess.Popen([sys.executable, "-m", "fgpose", *arguments], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"fgpose {' '.join(arguments)} ended with code {process.returncode}")
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / _KIB_PER_MB


def _main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0, help="of the long recording")
    parser.add_argument("--with-3d", action="store_true", help="with per-view 3D and its covariances")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        runs = [measured(minutes, Path(folder), with_3d=options.with_3d) for minutes in (1.0, options.minutes)]
    print(
        "| minutes | peak memory, MB | CPU time, ms/frame | over that of a minute | .rrd, MB |\n"
        "|---:|---:|---:|---:|---:|"
    )
    for run in runs:
        ratio = run.cpu_ms / runs[0].cpu_ms
        print(f"| {run.minutes:g} | {run.peak_mb:.0f} | {run.cpu_ms:.2f} | {ratio:.2f} | {run.rrd_mb:.0f} |")


if __name__ == "__main__":
    _main()
