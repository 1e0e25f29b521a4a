"""Legs that networks guess where a table hides them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from tests.fgpose.calibration.changes.changing import SKELETON


def shorter_legs(
    truth_m: Float[np.ndarray, "frame joint 3"], frames: slice, factor: float
) -> Float[np.ndarray, "frame joint 3"]:
    """With thighs and shanks shorter by this factor in some frames."""
    guessed_m = truth_m.copy()
    for side in ("left", "right"):
        hip, knee, ankle = (SKELETON.index(f"{side}_{joint}") for joint in ("hip", "knee", "ankle"))
        thigh_m, shank_m = truth_m[frames, knee] - truth_m[frames, hip], truth_m[frames, ankle] - truth_m[frames, knee]
        guessed_m[frames, knee] = truth_m[frames, hip] + factor * thigh_m
        guessed_m[frames, ankle] = guessed_m[frames, knee] + factor * shank_m
    return guessed_m
