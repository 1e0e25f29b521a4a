"""Whether triangulated joints can be those of a body: its limbs keep their lengths, and are alike left and right."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

# Of real detectors seen by two cameras, where errors along the epipolar lines go unnoticed: see unsteadiness.
STEADY = 0.25


def unsteadiness(positions_m: Float[np.ndarray, "frame joint 3"], limbs: Int[np.ndarray, "limb side 2"]) -> float:
    """By how much the limbs change their lengths and differ between left and right, as a share of their lengths; the
    median over the limbs. 0.05 to 0.15 of a body that real detectors see; NaN without limbs."""
    if not len(limbs):
        return np.nan
    lengths_m = np.linalg.norm(positions_m[:, limbs[..., 0]] - positions_m[:, limbs[..., 1]], axis=-1)
    usual_m = _median_of_frames(lengths_m)
    usual_m = np.where(usual_m > 0, usual_m, np.nan)  # between a joint and itself
    change = _median_of_frames(np.abs(lengths_m - usual_m)) / usual_m
    difference = np.abs(usual_m[:, 0] - usual_m[:, 1]) / usual_m.mean(axis=-1)
    known = np.isfinite(difference)
    return float(np.median(change[known].mean(axis=-1)) + np.median(difference[known])) if known.any() else np.nan


def _median_of_frames(values: Float[np.ndarray, "frame limb side"]) -> Float[np.ndarray, "limb side"]:
    """Of what is known; NaN where three frames are not. Many times as fast as nanmedian."""
    if not len(values):
        return np.full(values.shape[1:], np.nan)
    rows = np.sort(values, axis=0)  # NaN last
    count = np.isfinite(values).sum(axis=0)
    middle = np.take_along_axis(rows, np.maximum(count // 2, 0)[None].clip(max=len(rows) - 1), axis=0)[0]
    return np.where(count >= 3, middle, np.nan)
