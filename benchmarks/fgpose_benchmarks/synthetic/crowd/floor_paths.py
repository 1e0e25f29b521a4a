"""Ways over the floor: curves through points, and the speed along them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

AT_REST_MPS = 0.15
"""Whoever is slower stands."""


def steps(ground_m: Float[np.ndarray, "frame 2"]) -> Float[np.ndarray, "frame 2"]:
    """Way of each frame, central difference; NaN stays NaN."""
    ahead, behind = np.diff(ground_m, axis=0, append=np.nan), np.diff(ground_m, axis=0, prepend=np.nan)
    ahead, behind = np.where(np.isnan(ahead), behind, ahead), np.where(np.isnan(behind), ahead, behind)
    return (ahead + behind) / 2


def curve(
    points_m: Float[np.ndarray, "point 2"],
) -> tuple[CubicSpline, Float[np.ndarray, " fine"], Float[np.ndarray, " fine"]]:
    """A curve through points; the way along it, and the parameter there."""
    from scipy.interpolate import CubicSpline

    chord_m = np.linalg.norm(np.diff(points_m, axis=0), axis=-1)
    at = np.concatenate([[0.0], np.cumsum(np.maximum(chord_m, 1e-3))])
    line = CubicSpline(at, points_m, bc_type="natural")
    fine = np.linspace(0.0, at[-1], 200)
    steps_m = np.linalg.norm(np.diff(line(fine), axis=0), axis=-1)
    return line, np.concatenate([[0.0], np.cumsum(steps_m)]), fine


def speed_profile(n: int, n_ramp: float, *, from_rest: bool, to_rest: bool) -> Float[np.ndarray, " frame"]:
    """Speed over the cruising speed."""
    frame = np.arange(1, n + 1)
    rise = 0.5 - 0.5 * np.cos(np.pi * np.minimum(frame / n_ramp, 1.0)) if from_rest else np.ones(n)
    fall = 0.5 - 0.5 * np.cos(np.pi * np.minimum((n - frame) / n_ramp, 1.0)) if to_rest else np.ones(n)
    return rise * fall


def turning_radps(walk_m: Float[np.ndarray, "frame 2"], fps: float) -> float:
    step_m = np.diff(walk_m, axis=0)
    step_m = step_m[np.linalg.norm(step_m, axis=-1) * fps > AT_REST_MPS]
    heading = np.unwrap(np.arctan2(step_m[:, 1], step_m[:, 0]))
    return float(np.abs(np.diff(heading)).max() * fps) if len(heading) > 1 else 0.0
