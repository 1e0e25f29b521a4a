"""One run after the other in this process: ``python soak_run.py RESULTS.jsonl FIRST RUNS FRAMES``.

The result of each is appended as a line of JSON: the run that is missing when the process has died is the one that
killed it.
"""

from __future__ import annotations

import ctypes
import itertools
import json
import os
import stat
import sys
import traceback
import warnings
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

import fgpose
from fgpose.estimation.online.window_graph import WindowGraph
from fgpose.trajectory import Estimate, Status
from soak_scenes import SoakConditions, draw, parts
from timing import resident_memory_mb

_MOST_FAILURES = 3
_FRAMES_PER_LOOK = 10
_BATCH_FRAMES = 60
_REPEATED_SHARE = 0.02


@dataclass
class SoakResult:
    """The result of a run."""

    seed: int
    n_frames: int
    conditions: list[str]
    repairs: int = 0
    memory_growth_mb: float = 0.0
    """Median resident memory in the last quarter of the run, over the quarters before."""
    window_mb: float = 0.0
    """What the longest window can take."""
    slots: float = 0.0
    """Most slots for factors that iSAM2 held, over what the frames of the window can need."""
    failures: list[str] = field(default_factory=list)
    """Exceptions and estimates that contradict themselves; the first few."""
    printed_bytes: int = 0
    """The text that reached standard output and standard error."""
    death: str | None = None


def run(soak: SoakConditions, n_frames: int) -> SoakResult:
    """Online, frame by frame, then the first frames as a batch."""
    result = SoakResult(soak.seed, n_frames, soak.conditions)
    for task in (_online, _batch):
        try:
            task(soak, n_frames, result)
        except Exception:
            result.failures.append(traceback.format_exc(limit=-3))
    return result


def _online(soak: SoakConditions, n_frames: int, result: SoakResult) -> None:
    rng = np.random.default_rng([soak.seed, 1])
    estimator = fgpose.Estimator(soak.rig, soak.skeleton, soak.config, times_are_checked=True)
    held_mb: tuple[list[float], ...] = ([], [], [], [])
    longest = 0
    for number, (before, frame) in enumerate(itertools.pairwise(_frames(soak, n_frames))):
        check(estimator.update(frame), result)
        if "repeated and old frames" in soak.troubles and number and rng.random() < _REPEATED_SHARE:
            _refused(estimator, [frame, before])
        quarter = 4 * number // n_frames
        longest = max(longest, len(estimator._body._window))
        solver, is_by_qr = estimator._body._window._solver, False
        if isinstance(solver, WindowGraph):
            n_factors = solver._smoother._isam.getFactorsUnsafe().size()
            result.slots = max(result.slots, n_factors / _most_factors(soak, longest))
            is_by_qr = solver._smoother._qr_frames > 0
        # QR takes several times the memory, but for a while only.
        if number % _FRAMES_PER_LOOK == 0 and not is_by_qr:
            held_mb[quarter].append(_held_mb())
    result.repairs, result.window_mb = estimator.repairs, _most_mb(soak, longest)
    usual_mb = [float(np.median(quarter)) for quarter in held_mb if quarter]
    if len(usual_mb) == len(held_mb):
        result.memory_growth_mb = usual_mb[-1] - max(usual_mb[:-1])


def _held_mb() -> float:
    """Resident memory but for what the allocator keeps for later (Linux, glibc)."""
    ctypes.CDLL(None).malloc_trim(0)
    return resident_memory_mb()


def _frames(soak: SoakConditions, n_frames: int) -> Iterator[fgpose.Observations]:
    return itertools.chain.from_iterable(parts(soak, n_frames + 1))


def _most_factors(soak: SoakConditions, longest: int) -> int:
    """That a window of so many frames can have: for each joint its detections and depths, a bone, motion, fading, an
    anchor, two priors, and what was marginalised. Unused slots are kept, so it is the longest window that counts; and
    it counts twice, for a factor that is replaced leaves its slot after the other has come."""
    per_joint = 2 * soak.rig.n_cameras + 7
    return per_joint * soak.skeleton.n_joints * (2 * longest + 2)


def _most_mb(soak: SoakConditions, longest: int) -> float:
    """That the Bayes tree of a window of so many frames can take: when nobody sees the person, all joints of a frame
    are correlated, and every variable is conditioned on as many others as a frame has."""
    n_variables = 2 * soak.skeleton.n_joints
    side = 3 * (n_variables + 2)
    return longest * n_variables * side**2 * np.dtype(float).itemsize / 1e6


def _refused(estimator: fgpose.Estimator, frames: list[fgpose.Observations]) -> None:
    """Frames that are not newer than the newest must change nothing but say so."""
    for frame in frames:
        try:
            estimator.update(frame)
        except ValueError as error:
            if "time must increase" not in str(error):
                raise
        else:
            raise AssertionError("a repeated or old frame was taken")


def _batch(soak: SoakConditions, n_frames: int, result: SoakResult) -> None:
    observations = next(parts(soak, min(n_frames, _BATCH_FRAMES)))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*has not converged")  # documented, and part of the result
        trajectory = fgpose.smooth(observations, soak.rig, soak.config)
    complain(result, "batch", trajectory.positions_m, trajectory.status, trajectory.covariance_m2)


def check(estimate: Estimate, result: SoakResult) -> None:
    """Note in the result where an estimate contradicts itself."""
    where = f"frame {estimate.frame}"
    complain(result, where, estimate.positions_m, estimate.status, estimate.covariance_m2)
    for lagged in estimate.newly_smoothed:
        complain(result, f"{where}, smoothed", lagged.positions_m, lagged.status, lagged.covariance_m2)


def complain(
    result: SoakResult, where: str, positions_m: np.ndarray, status: np.ndarray, covariance_m2: np.ndarray | None
) -> None:
    known = np.asarray(np.isfinite(positions_m).all(axis=-1))
    if (known != (status != Status.UNOBSERVABLE)).any():
        result.failures.append(f"{where}: a position is not a number where the status says that it is, or the reverse")
    if covariance_m2 is None:
        return
    of_known = covariance_m2[known]
    if not np.isfinite(of_known).all() or (of_known.size and np.linalg.eigvalsh(of_known).min() <= 0):
        result.failures.append(f"{where}: a covariance is not positive and finite")


def _main(results: str, first: str, runs: str, n_frames: str) -> None:
    for seed in range(int(first), int(first) + int(runs)):
        before = _printed_bytes()
        result = run(draw(seed), int(n_frames))
        result.failures = result.failures[:_MOST_FAILURES]
        result.printed_bytes = _printed_bytes() - before
        with Path(results).open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(result)) + "\n")


def _printed_bytes() -> int:
    """So far, if standard output and standard error are one file."""
    sys.stdout.flush()
    size = os.fstat(1)
    return size.st_size if stat.S_ISREG(size.st_mode) else 0


if __name__ == "__main__":
    _main(*sys.argv[1:])
