"""Both solvers of the online window beside the batch: errors on the clips of the benchmark, and the time of an update.

``python window_solvers.py --variants clean occluded occluded_2_cameras`` prints a line for each. The solvers take turns
frame by frame, so that their times are of the same moments; other work makes both slower.

The clips are short, so the window runs also with the bone lengths of the batch, as of somebody who is recognised. An
oracle, online and in batch, says how much of the distance between the two is due to the frames that are still to come:
it is told which detections are hidden, how large the noise of the others is, and the lengths of its batch.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
import tyro
from jaxtyping import Float
from rich.progress import track

import fgpose
from fgpose.assessment.metrics import mean_known, mpjpe_m, nees
from fgpose.estimation.estimator import Estimator
from fgpose_benchmarks.accuracy.families import find_variant
from fgpose_benchmarks.accuracy.methods import empty_frames, what_an_oracle_knows
from fgpose_benchmarks.accuracy.variants import TEST_CLIPS, TUNING_CLIPS, record
from fgpose_benchmarks.comparison.recording import BenchmarkRecording

_SOLVERS = ("isam2", "window")
_BONES_KNOWN, _ORACLE = "window, bones known", "window of an oracle"
_BONE_SIGMA_M = 0.005
_SETTLED_S = 0.2  # both begin with the same triangulated points
_WARM_UP_S = 1.0  # twice the longest lag


@dataclass
class Figures:
    """On the recordings of a variant, one number a recording."""

    newest_mm: list[float] = field(default_factory=list)
    lagged_mm: list[float] = field(default_factory=list)
    batch_mm: list[float] = field(default_factory=list)
    """Of the batch that is told the same."""
    nees: list[float] = field(default_factory=list)
    """Mean squared error of the newest pose in standard deviations, for each coordinate: 1 where covariances are right,
    less where they are too large."""
    update_ms: list[float] = field(default_factory=list)
    """Of every update."""


def _error_mm(positions_m: Float[np.ndarray, "frame joint 3"], recording: BenchmarkRecording) -> float:
    settled = slice(int(_SETTLED_S * recording.fps), None)
    return 1e3 * mpjpe_m(positions_m[settled], recording.truth_m[settled])


def _nees(estimates: Sequence[fgpose.Estimate], recording: BenchmarkRecording) -> float:
    positions_m = np.stack([estimate.positions_m for estimate in estimates])
    covariances_m2 = np.stack([estimate.covariance_m2 for estimate in estimates if estimate.covariance_m2 is not None])
    return float(mean_known(nees(positions_m - recording.truth_m, covariances_m2))) / 3


@dataclass(frozen=True, eq=False)
class _Given:
    """What an estimator is told."""

    observations: fgpose.Observations
    rig: fgpose.CameraRig
    config: fgpose.Config

    def online(self, solver: Literal["isam2", "window"], lag_s: float) -> Estimator:
        online = replace(self.config.online, solver=solver, lag_s=lag_s)
        return Estimator(self.rig, self.observations.skeleton, replace(self.config, online=online))

    @cached_property
    def batch(self) -> fgpose.Trajectory:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*has not converged")
            return fgpose.smooth(self.observations, self.rig, self.config)

    @property
    def bone_lengths(self) -> fgpose.BoneLengths:
        """Those of the batch."""
        assert self.batch.bone_lengths_m is not None
        return fgpose.BoneLengths(self.batch.bone_lengths_m, np.full_like(self.batch.bone_lengths_m, _BONE_SIGMA_M))


def _run(recording: BenchmarkRecording, lag_s: float, figures: dict[str, Figures]) -> None:
    """All of them on one recording."""
    n_frames, after = len(recording.truth_m), empty_frames(recording, lag_s)
    usual = _Given(recording.observations, recording.rig, fgpose.Config())
    seen, config = what_an_oracle_knows(recording)
    told = _Given(seen, recording.true_rig, config)
    given = {**dict.fromkeys((*_SOLVERS, _BONES_KNOWN), usual), _ORACLE: told}
    estimators = {name: each.online(name if name in _SOLVERS else "window", lag_s) for name, each in given.items()}
    for name in (_BONES_KNOWN, _ORACLE):
        estimators[name].know(given[name].bone_lengths)
    estimates: dict[str, list[fgpose.Estimate]] = {name: [] for name in given}
    for frames in zip(*([*each.observations, *after] for each in given.values()), strict=True):
        for (name, estimator), frame in zip(estimators.items(), frames, strict=True):
            start_s = time.perf_counter()
            estimates[name].append(estimator.update(frame))
            if len(estimates[name]) > _WARM_UP_S * recording.fps:
                figures[name].update_ms.append(1e3 * (time.perf_counter() - start_s))
    for name, each in estimates.items():
        lagged_m = np.full_like(recording.truth_m, np.nan)
        for smoothed in (frame for estimate in each for frame in estimate.newly_smoothed):
            if smoothed.frame < n_frames:
                lagged_m[smoothed.frame] = smoothed.positions_m
        newest = each[:n_frames]
        figures[name].newest_mm.append(_error_mm(np.stack([estimate.positions_m for estimate in newest]), recording))
        figures[name].lagged_mm.append(_error_mm(lagged_m, recording))
        figures[name].nees.append(_nees(newest, recording))
        figures[name].batch_mm.append(_error_mm(given[name].batch.positions_m, recording))


def main(
    variants: tuple[str, ...] = ("clean", "occluded", "occluded_3_cameras", "occluded_2_cameras"),
    clips: Literal["test", "tuning"] = "test",
    frames: int = 200,
    lag_s: float = 0.2,
) -> None:
    """Print the errors of both solvers and of an oracle, each over those of the batch that is told the same, and the
    ratio of the solvers' times.

    Args:
        variants: of the open benchmark.
        clips: those that defaults were never chosen on, or those that they may be.
        frames: of each clip, at 50 Hz.
        lag_s: online.lag_s.
    """
    names = TEST_CLIPS if clips == "test" else TUNING_CLIPS
    print(f"{len(names)} clips, lag {lag_s:g} s; mean errors in mm\n")
    print("| variant | | batch | newest | over batch | one lag later | over batch | NEES |")
    print("|---|---|---:|---:|---:|---:|---:|---:|")
    ratios = []
    for variant in variants:
        figures = {name: Figures() for name in (*_SOLVERS, _BONES_KNOWN, _ORACLE)}
        for clip in track(names, variant, transient=True):
            _run(record(find_variant(variant), clip, frames), lag_s, figures)
        for name, each in figures.items():
            newest, lagged, batch = (float(np.mean(mm)) for mm in (each.newest_mm, each.lagged_mm, each.batch_mm))
            cells = f"{batch:.1f} | {newest:.1f} | {newest / batch:.2f} | {lagged:.1f} | {lagged / batch:.2f}"
            print(f"| {variant} | {name} | {cells} | {np.mean(each.nees):.2f} |", flush=True)
        times = [np.percentile(figures[name].update_ms, (50, 99)) for name in _SOLVERS]
        ratios.append(f"{variant}: {times[1][0] / times[0][0]:.2f} (median), {times[1][1] / times[0][1]:.2f} (99 %)")
    print("\nTime of an update of window over isam2:", *ratios, sep="\n")


if __name__ == "__main__":
    tyro.cli(main)
