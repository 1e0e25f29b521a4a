"""Long runs in a process of their own, so that nothing else counts in their memory.

``python isolated.py batch|isam2|window RECORDING.npz SKELETON [tidied]`` prints one JSON object; RECORDING is of the
scenario of this folder.
"""

from __future__ import annotations

import cProfile
import json
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

import fgpose
from fgpose.io.keypoints import save_observations
from fgpose_benchmarks.synthetic import ring_rig
from scenario import POSITIONS_ONLY
from timing import peak_memory_mb, resident_memory_mb, timed

_SHORT_FRAMES = 300
_SHORT_RUNS = 3
_COUNTED_SHARE = 0.02  # of the frames, twice


Solver = Literal["isam2", "window"]
Task = Literal["batch"] | Solver
"""In batch, or online by one of the solvers."""


def run_isolated(task: Task, observations: fgpose.Observations, *, tidied: bool = False) -> dict[str, Any]:
    """The numbers of a task on a recording, measured in a fresh process; tidied: see online."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.npz"
        save_observations(observations, path)
        command = [sys.executable, str(Path(__file__)), task, str(path), observations.skeleton.name]
        command += ["tidied"] if tidied else []
        return json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout)


def batch(observations: fgpose.Observations) -> dict[str, Any]:
    """The whole recording once, between runs over its first frames."""
    rig = ring_rig()
    short = observations.frames(slice(0, _SHORT_FRAMES))

    def short_runs() -> list[float]:
        return [timed(lambda: fgpose.smooth(short, rig, POSITIONS_ONLY))[0].cpu_s for _ in range(_SHORT_RUNS)]

    before_s = short_runs()
    timing, trajectory = timed(lambda: fgpose.smooth(observations, rig, POSITIONS_ONLY))
    peak_mb = peak_memory_mb()
    short_ms = 1e3 * float(np.median(before_s + short_runs())) / short.n_frames
    convergence = trajectory.convergence
    return {
        "wall_ms": 1e3 * timing.wall_s / observations.n_frames,
        "cpu_ms": 1e3 * timing.cpu_s / observations.n_frames,
        "short_cpu_ms": short_ms,
        "peak_mb": peak_mb,
        "converged": convergence is not None and convergence.converged,
    }


def online(observations: fgpose.Observations, solver: Solver, *, tidied: bool = False) -> dict[str, Any]:
    """Every frame as if live; time and memory after each, and the function calls of the last frames of both halves,
    which do not depend on the other work of a machine. Frames whose calls are counted are not timed: it slows them.
    Tidied: the estimator learns and revises between the images (Estimator.tidy), as that of `fgpose live` does; what an
    update takes then is how much older a pose is than its images."""
    config = fgpose.Config(online={"solver": solver})
    estimator = fgpose.Estimator(ring_rig(), observations.skeleton, config)
    wall_ms, cpu_ms, resident_mb = [], [], []
    n_counted = round(_COUNTED_SHARE * observations.n_frames)
    profiles = {end: cProfile.Profile() for end in (observations.n_frames // 2, observations.n_frames)}
    for index, frame in enumerate(observations):
        profile = next((each for end, each in profiles.items() if end - n_counted <= index < end), None)
        if profile is not None:
            profile.runcall(estimator.update, frame)
            continue
        timing, _ = timed(lambda frame=frame: estimator.update(frame), collect=False)
        wall_ms.append(1e3 * timing.wall_s)
        cpu_ms.append(1e3 * timing.cpu_s)
        resident_mb.append(resident_memory_mb())
        if tidied:
            estimator.tidy()
    calls = [sum(entry.callcount for entry in profile.getstats()) for profile in profiles.values()]
    return {"wall_ms": wall_ms, "cpu_ms": cpu_ms, "resident_mb": resident_mb, "calls": calls}


def _main(task: str, path: str, skeleton: str, *tidied: str) -> None:
    observations = fgpose.load_observations(path, ring_rig(), skeleton)
    online_by = {solver: partial(online, solver=solver, tidied=bool(tidied)) for solver in get_args(Solver)}
    print(json.dumps({"batch": batch, **online_by}[task](observations)))


if __name__ == "__main__":
    _main(*sys.argv[1:])
