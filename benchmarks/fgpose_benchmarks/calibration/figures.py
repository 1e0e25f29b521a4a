"""The figures that a calibration from people is to reach, and what it does reach."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fgpose_benchmarks.calibration.scores import CalibrationScore
from fgpose_benchmarks.calibration.variants import VARIANTS, Group

Scores = Sequence[CalibrationScore]
_GROUPS: dict[str, Group] = {variant.name: variant.group for variant in VARIANTS}
_SCALES = {variant.name: variant.scale for variant in VARIANTS}


def group_of(variant: str) -> Group | None:
    """The group of a variant by name; None for what is not of this benchmark."""
    return _GROUPS.get(variant)


def every(scores: Scores, number: str) -> np.ndarray:
    """All values of a number of the scores, without a sign; those that do not exist are left out."""
    values = [np.atleast_1d(np.asarray(getattr(score, number), dtype=float)) for score in scores]
    found = np.abs(np.concatenate(values)) if values else np.empty(0)
    return found[~np.isnan(found)]


def median(scores: Scores, number: str) -> float:
    found = every(scores, number)
    return float(np.median(found)) if len(found) else float("nan")


def worst(scores: Scores, number: str) -> float:
    return float(every(scores, number).max(initial=-np.inf)) if len(every(scores, number)) else float("nan")


@dataclass(frozen=True)
class Figure:
    """One number to reach, and of which recordings."""

    number: int
    what: str
    limit: float
    value: Callable[[Scores], float]
    among: Callable[[CalibrationScore], bool]
    at_least: bool = False
    decimals: int = 1

    def reached(self, scores: Scores) -> tuple[float, int]:
        """The value, NaN where there is none, and of how many recordings."""
        own = [score for score in scores if self.among(score)]
        return self.value(own), len(own)

    def met(self, value: float) -> bool:
        return value >= self.limit if self.at_least else value <= self.limit


def _in(*groups: Group) -> Callable[[CalibrationScore], bool]:
    return lambda score: group_of(score.variant) in groups


def _scaled_by(cue: str) -> Callable[[CalibrationScore], bool]:
    """Walks whose scale is from a cue."""
    return lambda score: group_of(score.variant) in ("walk", "scale") and _SCALES[score.variant] == cue


def _median(number: str) -> Callable[[Scores], float]:
    return lambda scores: median(scores, number)


def _worst(number: str) -> Callable[[Scores], float]:
    return lambda scores: worst(scores, number)


def share(hits: Sequence[bool]) -> float:
    """In percent; NaN of nothing."""
    return 100 * float(np.mean(hits)) if len(hits) else float("nan")


def _right_peaks(scores: Scores) -> float:
    return share([value == 1.0 for score in scores for value in score.right_peak])


def _median_start(scores: Scores) -> float:
    return median([score for score in scores if 0.0 not in score.right_peak], "start_frames")


def _worst_start(scores: Scores) -> float:
    return worst([score for score in scores if 0.0 not in score.right_peak], "start_frames")


def _wrong_starts_flagged(scores: Scores) -> float:
    return share([score.outcome != "good" for score in scores if 0.0 in score.right_peak])


def _failures_flagged(scores: Scores) -> float:
    return share([score.outcome != "good" for score in scores if score.has_failed])


def _false_alarms(scores: Scores) -> float:
    return share([score.outcome != "good" for score in scores if score.is_right])


def _within_two(*numbers: str) -> Callable[[Scores], float]:
    return lambda scores: share([bool(value <= 2.0) for number in numbers for value in every(scores, number)])


_SIMULATED = ("walk", "errors", "scale", "focal length", "starts", "people", "hard")
_WITHIN = _within_two("position_sigmas", "direction_sigmas", "focal_sigmas", "start_sigmas")
_WALK, _FOCAL, _STARTS = _in("walk"), _in("focal length"), _in("starts")


def _shared(score: CalibrationScore) -> bool:
    return score.variant.startswith("shared_")


def _of_balance(score: CalibrationScore) -> bool:
    return score.variant == "balance_blazepose"


def _with_cameras(n_cameras: int) -> Callable[[CalibrationScore], bool]:
    return lambda score: score.n_cameras == n_cameras and group_of(score.variant) != "real"


FIGURES = (
    Figure(1, "position of a camera, mm: median", 30.0, _median("position_mm"), _WALK),
    Figure(1, "position of a camera, mm: worst", 60.0, _worst("position_mm"), _WALK),
    Figure(1, "rotation between cameras, degrees: median", 0.7, _median("rotation_deg"), _WALK, decimals=2),
    Figure(1, "rotation between cameras, degrees: worst", 1.5, _worst("rotation_deg"), _WALK, decimals=2),
    Figure(2, "induced 3D error, mm: median", 8.0, _median("induced_mm"), _WALK),
    Figure(2, "induced 3D error, mm: worst", 8.0, _worst("induced_mm"), _WALK),
    Figure(2, "smoothed MPJPE / true rig, after a similarity: median", 1.05, _median("ratio"), _WALK, decimals=3),
    Figure(2, "smoothed MPJPE / true rig, metric: median", 1.2, _median("metric_ratio"), _WALK, decimals=3),
    Figure(3, "scale from stature, %: median", 1.5, _median("scale_percent"), _scaled_by("stature"), decimals=2),
    Figure(3, "scale from a distance, %: median", 0.5, _median("scale_percent"), _scaled_by("distance"), decimals=2),
    Figure(3, "vertical, degrees: median", 0.7, _median("vertical_deg"), _WALK, decimals=2),
    Figure(3, "floor, mm: median", 20.0, _median("floor_mm"), _WALK),
    Figure(4, "shared focal length, %: median", 1.5, _median("focal_percent"), _shared, decimals=2),
    Figure(4, "position of a camera, focal length shared, mm: median", 60.0, _median("position_mm"), _shared),
    Figure(4, "focal length of each camera, %: median", 1.5, _median("focal_percent"), _FOCAL, decimals=2),
    Figure(5, "starts at the right peak, %", 95.0, _right_peaks, _STARTS, at_least=True),
    Figure(5, "recordings with others flagged, %", 100.0, _wrong_starts_flagged, _STARTS, at_least=True),
    Figure(5, "right starts, frames: median", 0.1, _median_start, _STARTS, decimals=2),
    Figure(5, "right starts, frames: worst", 0.3, _worst_start, _STARTS, decimals=2),
    Figure(6, "failures flagged, %", 100.0, _failures_flagged, lambda score: True, at_least=True),
    Figure(6, "false alarms, %", 5.0, _false_alarms, lambda score: True),
    Figure(6, "errors within two stated sigmas, %", 90.0, _WITHIN, _in(*_SIMULATED), at_least=True),
    Figure(7, "balance_blazepose, induced 3D error, mm", 8.0, _worst("induced_mm"), _of_balance),
    Figure(7, "balance_blazepose, errors within two stated sigmas, %", 90.0, _WITHIN, _of_balance, at_least=True),
    Figure(8, "time with 4 cameras, s: worst", 60.0, _worst("time_s"), _with_cameras(4)),
    Figure(8, "time with 8 cameras, s: worst", 240.0, _worst("time_s"), _with_cameras(8)),
)  # fmt: skip
"""In the order of the list that they are from."""
