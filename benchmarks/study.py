"""A study: how much faster two workers are than one, that both give the same, and what the plan holds in memory.

    python benchmarks/study.py                # 200 recordings of 10 s with two workers, 20 of them with one; 15 minutes
    python benchmarks/study.py --recordings 24

The ratio is that of the rates, in recordings per second of the time from the first to the last outcome. Workers start
within seconds, and are there then. Parts with one worker stand before and after the part with two, so that a machine
that becomes slower shows.
"""

from __future__ import annotations

import shutil
import tempfile
import time
import tracemalloc
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from fgpose.io.calibration import save_rig
from fgpose.io.keypoints import save_observations
from fgpose.io.skeletons import load_skeleton
from fgpose.study import Plan, StudyDescription, run_study
from fgpose.study.study import study_of
from fgpose_benchmarks.synthetic import DetectionNoise, Occlusion, embedded_motion, ring_rig, simulate

DATA = {
    "keypoints": "{subject}/{session}/{trial}.npz",
    "calibration": "{subject}/{session}/Calib.toml",
    "skeleton": "h36m_17",
}
CLIPS = ("cmu_02_05", "cmu_02_07_a", "cmu_02_10")
PLANNED = 10_000
DURATION_S = 10.0


@dataclass(frozen=True)
class WorkerRun:
    """Recordings by a number of workers."""

    n_workers: int
    n_done: int
    took_s: float

    @property
    def rate_hz(self) -> float:
        return self.n_done / self.took_s


def write_recordings(root: Path, n_recordings: int) -> None:
    """Motion capture through the synthetic rig, each from another moment of a clip and with other errors."""
    skeleton, rig = load_skeleton("h36m_17"), ring_rig()
    for number in range(n_recordings):
        positions_m, fps = embedded_motion(CLIPS[number % len(CLIPS)])
        n_frames = round(DURATION_S * fps)
        first = 17 * number % (len(positions_m) - n_frames)
        part_m = positions_m[first : first + n_frames]
        scene = simulate(part_m, skeleton, rig, fps, DetectionNoise(), Occlusion(), number)
        folder = root / f"S{number % 10:02}" / "A"
        folder.mkdir(parents=True, exist_ok=True)
        save_rig(rig, folder / "Calib.toml")
        save_observations(scene.observations, folder / f"t{number // 10:03}.npz")


def measured(study: StudyDescription, output: Path, n_workers: int, only: str = "") -> WorkerRun:
    """From when the workers are there to the last outcome."""
    shutil.rmtree(output, ignore_errors=True)
    times_s: list[float] = []
    result = run_study(
        replace(study, output=output),
        n_workers=n_workers,
        only=only,
        on_begin=lambda n_recordings: times_s.append(time.perf_counter()),
        on_outcome=lambda outcome: times_s.append(time.perf_counter()),
    )
    assert result.counts.keys() == {"done"}, result.failures
    part = WorkerRun(n_workers, result.counts["done"], times_s[-1] - times_s[0])
    print(f"{n_workers} workers: {part.n_done} recordings in {part.took_s:.1f} s, {60 * part.rate_hz:.1f} per minute")
    return part


def n_different(first: Path, second: Path) -> tuple[int, int]:
    """How many files of motion both have, and how many of these differ in a byte."""
    common = [path.relative_to(first) for path in (first / "recordings").rglob("motion.parquet")]
    common = [path for path in common if (second / path).exists()]
    return len(common), sum((first / path).read_bytes() != (second / path).read_bytes() for path in common)


def plan_peak_bytes(root: Path) -> tuple[int, float]:
    """The most that a plan of 10,000 recordings holds, and how many seconds it takes (without the measurement)."""
    for subject in range(100):
        folder = root / f"S{subject:03}" / "A"
        folder.mkdir(parents=True)
        for trial in range(PLANNED // 100):
            (folder / f"{trial:03}.npz").touch()
        (folder / "Calib.toml").touch()
    plan = Plan(study_of({"data": DATA}, root / "study.toml"))
    start_s = time.perf_counter()
    assert plan.counted() == PLANNED
    took_s = time.perf_counter() - start_s
    tracemalloc.start()
    assert sum(1 for _ in plan) == PLANNED
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak, took_s


def main(recordings: int = 200, compared: int = 20) -> None:
    """Measure.

    Args:
        recordings: how many, with two workers.
        compared: how many with one worker, before and after: the first trials of each of ten subjects.
    """
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        peak, took_s = plan_peak_bytes(root / "plan")
        print(f"plan of {PLANNED} recordings: {took_s:.1f} s, at most {peak / 1e6:.1f} MB")
        write_recordings(root / "data", recordings)
        study = study_of({"data": DATA}, root / "data" / "study.toml")
        few = f"*/t00[0-{compared // 10 - 1}]" if recordings > compared else ""
        before = measured(study, root / "before", 1, few)
        both = measured(study, root / "both", 2)
        after = measured(study, root / "after", 1, few)
        one_hz = np.mean([before.rate_hz, after.rate_hz])
        print(f"ratio of two workers to one: {both.rate_hz / one_hz:.2f}")
        for name in ("before", "after"):
            n_common, n_other = n_different(root / name, root / "both")
            print(f"{n_other} of {n_common} results differ in a byte between one worker and two")


if __name__ == "__main__":
    tyro.cli(main)
