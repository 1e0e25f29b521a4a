"""From a result to numbers: one Score for every recording and method."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Bool, Float

from fgpose.assessment.evaluation import PCK_THRESHOLD_M
from fgpose.assessment.metrics import (
    acceleration_error_mps2,
    bone_length_spread_m,
    joint_errors_m,
    mean_known,
    mpjpe_m,
    nees,
    share_missing,
)
from fgpose.io.atomic import write_text
from fgpose.io.content import parse_json, read_content
from fgpose.plain_files import naming
from fgpose_benchmarks.comparison.recording import BenchmarkRecording, Method, MethodResult

# The middle, the usual one and the tail of the distribution.
COVERAGE_LEVELS = (0.5, 0.9, 0.99)


@dataclass(frozen=True)
class Scored:
    """What was scored: one method on one recording."""

    variant: str
    clip: str
    method: str
    group: str


_Scored = TypeVar("_Scored", bound=Scored)


@dataclass(frozen=True)
class Score(Scored):
    """How good one method was on one recording. Lengths in mm; NaN where a number does not exist."""

    mpjpe_mm: float
    """Absolute, over the joints that the method gives."""
    relative_mpjpe_mm: float
    """Relative to the pelvis."""
    median_mm: float
    p95_mm: float
    pck_150mm: float
    """Share of all joints (missing ones count as wrong) within 150 mm."""
    missing_share: float
    acceleration_mm_per_frame2: float
    """Mean distance of the second differences from those of the truth."""
    bone_spread_mm: float
    """Mean over the bones of the SD of their length over time."""
    ms_per_frame: float
    nees: float
    """Mean normalised estimation error squared per degree of freedom; 1 if consistent."""
    coverage: tuple[float, ...]
    """Share of the joints inside the ellipsoids of COVERAGE_LEVELS."""
    coverage_occluded: tuple[float, ...]
    """The same of joints that at least half of the cameras cannot see."""
    joint_mm: tuple[float, ...]
    """Absolute error of each joint."""
    offset_error_frames: float
    """Largest error of an estimated time offset, in frames."""


def score(
    recording: BenchmarkRecording, result: MethodResult, method: Method[BenchmarkRecording, MethodResult]
) -> Score:
    """How good a method's result is, by the definitions of fgpose.assessment.metrics.

    Raises:
        ValueError: the result has other frames or joints than the recording.
    """
    if result.positions_m.shape != recording.truth_m.shape:
        raise ValueError(
            f"{method.name} gave {result.positions_m.shape} for {recording.clip} ({recording.variant}), "
            f"expected {recording.truth_m.shape}"
        )
    skeleton, n_frames = recording.observations.skeleton, len(recording.truth_m)
    pair = result.positions_m, recording.truth_m
    errors_mm = 1000 * joint_errors_m(*pair)
    known_mm = errors_mm[np.isfinite(errors_mm)]
    median_mm, p95_mm = np.percentile(known_mm, (50, 95)).tolist() if known_mm.size else (np.nan, np.nan)
    squared = _squared_errors(recording, result)
    return Score(
        variant=recording.variant,
        clip=recording.clip,
        method=method.name,
        group=method.group,
        mpjpe_mm=float(mean_known(errors_mm)),
        relative_mpjpe_mm=1000 * mpjpe_m(*pair, skeleton.root),
        median_mm=median_mm,
        p95_mm=p95_mm,
        pck_150mm=float(np.mean(errors_mm <= 1000 * PCK_THRESHOLD_M)),
        missing_share=share_missing(errors_mm),
        acceleration_mm_per_frame2=1000 * acceleration_error_mps2(*pair, np.arange(n_frames, dtype=float)),
        bone_spread_mm=1000 * float(mean_known(bone_length_spread_m(skeleton, result.positions_m))),
        ms_per_frame=1000 * result.time_s / n_frames,
        nees=float(mean_known(squared)) / 3,
        coverage=_coverage(squared),
        coverage_occluded=_coverage(squared[_hidden(recording)]),
        joint_mm=tuple(mean_known(errors_mm, axis=0).tolist()),
        offset_error_frames=_offset_error_frames(recording, result),
    )


def _squared_errors(recording: BenchmarkRecording, result: MethodResult) -> Float[np.ndarray, "frame joint"]:
    """Squared errors in units of the stated covariance; NaN without one."""
    if result.covariance_m2 is None:
        return np.full(recording.truth_m.shape[:2], np.nan)
    return nees(result.positions_m - recording.truth_m, result.covariance_m2)


def _coverage(squared: Float[np.ndarray, "*points"]) -> tuple[float, ...]:
    from scipy.stats import chi2

    within = [np.where(np.isnan(squared), np.nan, squared <= chi2.ppf(level, df=3)) for level in COVERAGE_LEVELS]
    return tuple(float(mean_known(inside)) for inside in within)


def _hidden(recording: BenchmarkRecording) -> Bool[np.ndarray, "frame joint"]:
    """Joints that at least half of the cameras cannot see: behind an occluder, or not detected at all."""
    unseen = recording.occluded | ~recording.observations.seen
    return unseen.mean(axis=1) >= 0.5


def _offset_error_frames(recording: BenchmarkRecording, result: MethodResult) -> float:
    if result.offsets_s is None:
        return float("nan")
    return float(np.abs(result.offsets_s - recording.true_offsets_s).max() * recording.fps)


def save_scores(scores: Sequence[Scored], path: Path) -> None:
    """Write scores as a JSON list of objects with their fields; NaN becomes null.

    Raises:
        OSError: the file cannot be written.
    """
    objects = [{name: _to_json(value) for name, value in asdict(each).items()} for each in scores]
    write_text(path, json.dumps(objects, indent=1, allow_nan=False) + "\n")


def load_scores(path: Path, kind: type[_Scored]) -> list[_Scored]:
    """Read what save_scores has written of scores of one kind.

    Raises:
        ValueError: the file is not such a list.
        OSError: the file cannot be read.
    """
    with naming(path, "not a list of scores", damage=(TypeError, AttributeError)):
        return [_from_json(item, kind) for item in parse_json(read_content(path))]


def _to_json(value: Any) -> Any:
    if isinstance(value, tuple | list):
        return [_to_json(item) for item in value]
    return None if isinstance(value, float) and np.isnan(value) else value


def _from_json(item: dict[str, Any], kind: type[_Scored]) -> _Scored:
    names = {field.name for field in fields(kind)}
    if set(item) != names:
        raise ValueError(f"each has or lacks {', '.join(sorted(set(item) ^ names))}")
    return kind(**{name: _number(value) for name, value in item.items()})


def _number(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(_number(item) for item in value)
    return float("nan") if value is None else value
