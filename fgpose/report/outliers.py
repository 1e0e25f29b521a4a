"""Which recordings of a study are unlike the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

MEASURES = {
    "seen_share": -1,
    "views": -1,
    "unobservable_share": 1,
    "longest_gap_s": 1,
    "reprojection_px": 1,
    "worst_camera_px": 1,
    "hallucinated_share": 1,
    "sigma_mm": 1,
    "bone_spread_share": 1,
    "bone_asymmetry_share": 1,
    "max_speed_mps": 1,
}
"""Numbers of Quality by which recordings are compared: 1 where larger is worse, -1 where smaller is."""
OUTLIER_Z = 3.5
"""Iglewicz and Hoaglin (1993): how to detect and handle outliers."""
# With fewer, every recording is an outlier or none.
_LEAST = 5
# Of the median: recordings that are nearly all alike have no outlier that differs by less than 3.5 %.
_LEAST_SPREAD = 0.01


@dataclass(frozen=True)
class Outlier:
    """How far a recording is from the others, in the measure in which it is furthest on the bad side."""

    z: float
    measure: str
    """Empty if it is no worse than the median in any."""


def robust_z(values: Float[np.ndarray, " recording"]) -> Float[np.ndarray, " recording"]:
    """Distance from the median in standard deviations by the median absolute deviation; where more than half are equal,
    by the mean absolute deviation (the same reference). NaN where not known, or too few are."""
    known = np.isfinite(values)
    if known.sum() < _LEAST:
        return np.full(values.shape, np.nan)
    difference = values - np.median(values[known])
    spread = 1.4826 * float(np.median(np.abs(difference[known]))) or 1.2533 * float(np.mean(np.abs(difference[known])))
    spread = max(spread, _LEAST_SPREAD * abs(float(np.median(values[known]))))
    return difference / spread if spread > 0 else np.where(known, 0.0, np.nan)


def outliers(columns: dict[str, Float[np.ndarray, " recording"]]) -> list[Outlier]:
    """One for each recording.

    Args:
        columns: of MEASURES, those that are known.
    """
    names: Sequence[str] = [name for name in MEASURES if name in columns]
    if not names:
        return []
    scores = np.stack([MEASURES[name] * robust_z(columns[name]) for name in names])
    scores = np.where(np.isfinite(scores), scores, 0.0)
    worst = scores.argmax(axis=0)
    best = scores.max(axis=0)
    return [
        Outlier(float(z), names[index] if z > 0 else "") for z, index in zip(best.tolist(), worst.tolist(), strict=True)
    ]
