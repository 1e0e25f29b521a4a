"""The errors of detections that are correlated in time: how many frames count as one measurement."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

CORRELATION_S = 0.15
"""Time over which the errors of a pose network are correlated, measured on a monocular network."""


def correlated_frames(
    step_s: float | Float[np.ndarray, " frame"], correlation_s: float
) -> float | Float[np.ndarray, " frame"]:
    """How many frames count as one measurement when errors are correlated over this time; at least one."""
    return np.maximum(1.0, 2 * correlation_s / step_s)
