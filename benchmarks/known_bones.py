"""What the bone lengths of an earlier recording of the same person are worth, and what those of somebody else do.

The earlier recording is another clip of the same subject of the benchmark, which four cameras see without occluders.
Its result is used as ``--bones`` does, in batch and online, in recordings of some seconds under occlusion. Somebody
else is another subject, all grown men here, and a child: all lengths are 0.75 of those.

    python benchmarks/known_bones.py
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
import tyro
from jaxtyping import Float
from rich.progress import track

import fgpose
from fgpose.assessment.metrics import mpjpe_m
from fgpose_benchmarks.accuracy.families import find_variant
from fgpose_benchmarks.accuracy.methods import empty_frames
from fgpose_benchmarks.accuracy.variants import MAX_FRAMES, TEST_CLIPS, TUNING_CLIPS, record
from fgpose_benchmarks.comparison.recording import BenchmarkRecording

_CHILD = 0.75
_KINDS = ("batch", "newest", "lagged")


@dataclass
class Figures:
    """With some bones, on the recordings of a variant."""

    error_mm: dict[str, list[float]] = field(default_factory=lambda: {kind: [] for kind in _KINDS})
    """By kind of estimate, one number a recording."""
    away: dict[str, list[np.ndarray]] = field(default_factory=lambda: {kind: [] for kind in _KINDS})
    """Errors of all coordinates in their standard deviations."""
    said: list[bool] = field(default_factory=list)
    """Of each recording, in batch and online: whether the bones were seen to be somebody else's."""

    def add(self, kind: str, result: fgpose.Trajectory, truth_m: Float[np.ndarray, "frame joint 3"]) -> None:
        self.error_mm[kind].append(1e3 * mpjpe_m(result.positions_m, truth_m))
        if result.covariance_m2 is not None:
            variance_m2 = np.diagonal(result.covariance_m2, axis1=-2, axis2=-1)
            away = np.abs(result.positions_m - truth_m) / np.sqrt(variance_m2)
            self.away[kind].append(away[np.isfinite(away)])

    def row(self) -> str:
        cells = [f"{np.mean(self.error_mm[kind]):.1f}" for kind in _KINDS]
        for kind in _KINDS[:2]:
            away = np.concatenate(self.away[kind])
            cells.append(" / ".join(f"{100 * np.mean(away < sigmas):.0f}" for sigmas in (1, 2)))
        return " | ".join([*cells, f"{sum(self.said)} of {len(self.said)}"])


def _subject(clip: str) -> str:
    return clip.split("_")[1]


@cache
def _earlier(clip: str) -> fgpose.Trajectory:
    """The result of an undisturbed recording."""
    recording = record(find_variant("clean"), clip, MAX_FRAMES)
    return fgpose.smooth(recording.observations, recording.rig)


def _bones_for(clip: str) -> Mapping[str, fgpose.BoneLengths | None]:
    clips = [each for each in (*TUNING_CLIPS, *TEST_CLIPS) if each != clip]
    same = next(each for each in clips if _subject(each) == _subject(clip))
    other = next(each for each in clips if _subject(each) != _subject(clip))
    own, others = _earlier(same).bones, _earlier(other).bones
    assert own is not None
    child = fgpose.BoneLengths(_CHILD * own.lengths_m, own.sigma_m.copy())
    return {"none": None, "of the same person": own, "of another man": others, "of a child": child}


def _online(
    recording: BenchmarkRecording, bones: fgpose.BoneLengths | None
) -> tuple[fgpose.Trajectory, fgpose.Trajectory]:
    """The newest estimates, and those one lag later."""
    config = fgpose.Config()
    estimator = fgpose.Estimator(recording.rig, recording.observations.skeleton, config)
    if bones is not None:
        estimator.know(bones)
    frames = [*recording.observations, *empty_frames(recording, config.online.lag_s)]
    estimates = [estimator.update(frame) for frame in frames]
    lagged = {smoothed.frame: smoothed for each in estimates for smoothed in each.newly_smoothed}
    n_frames = len(recording.truth_m)
    newest = fgpose.Trajectory.from_estimates(estimates[:n_frames])
    return newest, fgpose.Trajectory.from_estimates([lagged[frame] for frame in range(n_frames)])


def _run(recording: BenchmarkRecording, figures: dict[str, Figures]) -> None:
    for whose, bones in _bones_for(recording.clip).items():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            batch = fgpose.smooth(recording.observations, recording.rig, bones=bones)
        results = batch, *_online(recording, bones)
        for kind, result in zip(_KINDS, results, strict=True):
            figures.setdefault(whose, Figures()).add(kind, result, recording.truth_m)
        figures[whose].said += [result.other_bone is not None for result in results[:2]]


def main(
    variants: Sequence[str] = ("occluded", "occluded_2_cameras"),
    frames: Sequence[int] = (50,),
) -> None:
    """Print the errors and the coverage with each of the bones, and how often they were seen to be somebody else's.

    Args:
        variants: of the open benchmark.
        frames: lengths of the recordings, at 50 Hz.
    """
    print("| variant | s | bones | batch [mm] | newest [mm] | lagged [mm] | batch [%] | newest [%] | somebody else's |")
    print("|---|---:|---|---:|---:|---:|---:|---:|---:|")
    for variant in variants:
        for n_frames in frames:
            figures: dict[str, Figures] = {}
            for clip in track(TEST_CLIPS, variant, transient=True):
                _run(record(find_variant(variant), clip, n_frames), figures)
            for whose, each in figures.items():
                print(f"| {variant} | {n_frames / 50:g} | {whose} | {each.row()} |", flush=True)


if __name__ == "__main__":
    tyro.cli(main)
