"""Scores that nothing was run for."""

from __future__ import annotations

from typing import Any

import numpy as np

from fgpose_benchmarks.comparison.scores import Score

_NUMBERS: dict[str, Any] = {
    "relative_mpjpe_mm": 30.0,
    "median_mm": 25.0,
    "p95_mm": 80.0,
    "pck_150mm": 0.975,
    "missing_share": 0.0,
    "acceleration_mm_per_frame2": 2.5,
    "bone_spread_mm": 6.0,
    "ms_per_frame": 4.0,
    "nees": 1.1,
    "coverage": (0.5, 0.9, 0.99),
    "coverage_occluded": (0.48, 0.88, 0.98),
    "joint_mm": (30.0,) * 17,
    "offset_error_frames": np.nan,
}


def made_up(
    variant: str = "occluded",
    clip: str = "walk",
    method: str = "fgpose batch",
    group: str = "ours",
    mpjpe_mm: float = 40.0,
    **numbers: Any,
) -> Score:
    """One score; the numbers not given are the same for every one."""
    return Score(variant, clip, method, group, mpjpe_mm, **(_NUMBERS | numbers))


def over_clips(errors_mm: list[float], **same: Any) -> list[Score]:
    """One score for each error, of the clips a, b, c, ..."""
    return [made_up(clip=chr(ord("a") + index), mpjpe_mm=error, **same) for index, error in enumerate(errors_mm)]
