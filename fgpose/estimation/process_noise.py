"""How much each joint may accelerate: the noise of the motion model, learned from the motion itself.

The accelerations of a punching wrist and of a standing pelvis differ by a factor of a hundred: one density for all
would smooth the wrist too much and the pelvis too little. A first-order Gauss-Markov process of variance a^2 and time
constant tau has, at low frequencies, the power spectral density 2 tau a^2. For a^2 stands the mean square acceleration
nearby in time, of the motion as estimated so far.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.config import MotionConfig

# Bounds of the density. Online the least is higher, since a joint at rest may start to move.
LEAST_DENSITY, _LEAST_DENSITY_ONLINE, _MOST_DENSITY = 0.3, 1.0, 300.0


def is_adaptive(config: MotionConfig) -> bool:
    """Whether the density is learned: only accelerations are."""
    return config.adaptive and config.model == "constant_velocity"


def initial_density(config: MotionConfig) -> float:
    """Density of the model's noise before anything is known of the motion."""
    return config.velocity_density if config.model == "random_walk" else config.acceleration_density


def least_density(config: MotionConfig) -> float:
    """The least that any joint's density can become."""
    return min(LEAST_DENSITY, config.acceleration_density) if is_adaptive(config) else initial_density(config)


def process_density(
    positions_m: Float[np.ndarray, "frame joint 3"], time_s: Float[np.ndarray, " frame"], config: MotionConfig
) -> Float[np.ndarray, "frame joint"]:
    """Power spectral density of each joint's noise around each frame: of its acceleration, m^2/s^3, learned if
    adaptive; of its velocity, m^2/s, with random walk.

    Args:
        positions_m: of a smoothed motion; NaN where a joint is not estimated.
        time_s: strictly increasing.
    """
    if not is_adaptive(config) or len(time_s) < 3:
        return np.full(positions_m.shape[:2], initial_density(config))
    velocity_mps = np.gradient(positions_m, time_s, axis=0)
    squared = np.mean(np.gradient(velocity_mps, time_s, axis=0) ** 2, axis=-1)
    density = _density(_mean_nearby(squared, time_s, config.nearby_s), LEAST_DENSITY, config)
    return np.where(np.isnan(density), initial_density(config), density)


class RunningDensity:
    """The same frame by frame; earlier frames have less weight.

    It takes the velocities of frames that are one lag old: the newest ones change too much with every detection.
    """

    def __init__(self, n_joints: int, config: MotionConfig) -> None:
        self._config = config
        self._squared = np.full(n_joints, config.acceleration_density / (2 * config.acceleration_time_s))
        self._time_s, self._velocities_mps = -np.inf, np.full((n_joints, 3), np.nan)

    def add(self, time_s: float, velocities_mps: Float[np.ndarray, "joint 3"]) -> None:
        """Take the velocities of the next frame; NaN where a joint is not estimated."""
        step_s = time_s - self._time_s
        squared = np.mean(((velocities_mps - self._velocities_mps) / step_s) ** 2, axis=-1)
        self._time_s, self._velocities_mps = time_s, velocities_mps
        keep = np.exp(-step_s / self._config.nearby_s)
        self._squared = np.where(np.isnan(squared), self._squared, keep * self._squared + (1 - keep) * squared)

    def density(self) -> Float[np.ndarray, " joint"]:
        """Power spectral density of each joint's noise; as process_density."""
        if not is_adaptive(self._config):
            return np.full(self._squared.shape, initial_density(self._config))
        return _density(self._squared, _LEAST_DENSITY_ONLINE, self._config)


def _density(squared: np.ndarray, least: float, config: MotionConfig) -> np.ndarray:
    """From the mean square acceleration, (m/s^2)^2."""
    least = min(least, config.acceleration_density)
    return np.clip(2 * config.acceleration_time_s * squared, least, _MOST_DENSITY)


def _mean_nearby(
    values: Float[np.ndarray, "frame joint"], time_s: Float[np.ndarray, " frame"], reach_s: float
) -> Float[np.ndarray, "frame joint"]:
    """Mean of what is known from reach_s before each frame to reach_s after it; NaN where nothing is."""
    first_s, last_s = np.maximum(time_s - reach_s, time_s[0]), np.minimum(time_s + reach_s, time_s[-1])

    def integral(values: np.ndarray) -> np.ndarray:
        between = (values[1:] + values[:-1]) / 2 * np.diff(time_s)[:, None]
        totals = np.cumsum(np.vstack([np.zeros_like(between[:1]), between]), axis=0)
        return np.stack([np.interp(last_s, time_s, total) - np.interp(first_s, time_s, total) for total in totals.T], 1)

    known = np.isfinite(values)
    known_s = integral(known.astype(float))
    # Of differences of cumulated times, what is left by rounding is nothing.
    enough = known_s > 1e-9 * (last_s - first_s)[:, None]
    nothing = np.full(values.shape, np.nan)
    return np.divide(integral(np.where(known, values, 0.0)), known_s, out=nothing, where=enough)
