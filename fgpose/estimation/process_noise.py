"""How much each joint may accelerate: the noise of the motion model, learned from the motion itself.

The accelerations of a punching wrist and of a standing pelvis differ by a factor of a hundred: one density for all
would smooth the wrist too much and the pelvis too little. The accelerations of a smoothed motion cannot simply be taken
for the true ones: the more is smoothed, the smaller they are, and a density that follows them falls with every turn.
But how much is smoothed is known. Measured with an information I per second, white noise of density q on the
acceleration leaves a smoother with the spectrum q / (1 + (w / b)^4), b^4 = q I (Wiener's filter), whose mean square is
q b / (2 sqrt 2). The density sought is the one for which this is the mean square acceleration found (MacKay 1992,
Bayesian interpolation: a hyperparameter re-estimated from the parameters that are well measured).

That is so where many frames fall into 1 / b. Fast motion at 50 Hz, and slow one at 10, has its bandwidth b where frames
end, and differences between them show less of it. The second difference of positions in frames dt apart is the mean of
the acceleration under a triangle, which has the spectrum q dt^3 (2 + cos w) / 3 for w from 0 to pi per frame; its
errors, those of positions that are known to 1 / (I dt), have the spectrum (2 - 2 cos w)^2 / (I dt). The filter is as
before.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from jaxtyping import Float

from fgpose.config import MotionConfig
from fgpose.estimation.noise import shrunk

NEARBY_S = 0.2
"""Accelerations, and what detections tell of them, are averaged from so long before a frame to so long after it. On the
tuning clips of the benchmark half of it raises the mean errors with two cameras by 3 %; otherwise half and twice as
long change less than 1 %."""
# Bounds of the density. Online the least is higher, since a joint at rest may start to move. The most is beyond that of
# a sprinter's ankle at 30 Hz, some 10,000.
LEAST_DENSITY, _LEAST_DENSITY_ONLINE, _MOST_DENSITY = 0.3, 1.0, 30_000.0
_SMOOTHED = 2 * np.sqrt(2)  # q b over the mean square of the smoothed acceleration
# What is usual for a joint counts as so many measurements; the frames nearby are about ten. On the tuning clips of the
# benchmark the mean errors with 1 and 16 differ by less than 3 %.
_USUAL_MEASUREMENTS = 4.0


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
    positions_m: Float[np.ndarray, "frame joint 3"],
    time_s: Float[np.ndarray, " frame"],
    information: Float[np.ndarray, "frame joint"],
    config: MotionConfig,
) -> Float[np.ndarray, "frame joint"]:
    """Power spectral density of each joint's noise around each frame: of its acceleration, m^2/s^3, learned if
    adaptive; of its velocity, m^2/s, with random walk.

    Args:
        positions_m: of a smoothed motion; NaN where a joint is not estimated.
        time_s: strictly increasing.
        information: of the detections of each frame, on each axis; see Evidence.information.
        config: the motion model.
    """
    if not is_adaptive(config) or len(time_s) < 3:
        return np.full(positions_m.shape[:2], initial_density(config))
    steps_s = np.gradient(time_s)[:, None]
    per_s = _mean_nearby(information / steps_s, time_s, NEARBY_S)
    squared = _mean_nearby(_squared_accelerations(positions_m, time_s), time_s, NEARBY_S)
    step_s = _mean_nearby(steps_s, time_s, NEARBY_S)
    density, measurements = _resolved(squared, per_s, step_s, LEAST_DENSITY, config)
    logs, total = np.sum(measurements * np.log(density), axis=0), measurements.sum(axis=0)
    unknown = np.full(total.shape, np.log(initial_density(config)))
    usual = np.exp(np.divide(logs, total, out=unknown, where=total > 0))
    return shrunk(density, measurements, usual, _USUAL_MEASUREMENTS)


class RunningDensity:
    """The same frame by frame; earlier frames have less weight.

    It takes the velocities of frames that are one lag old: the newest ones change too much with every detection.
    """

    def __init__(self, n_joints: int, config: MotionConfig) -> None:
        self._config = config
        self._squared, self._per_s, self._step_s = np.zeros(n_joints), np.zeros(n_joints), np.zeros(n_joints)
        self._time_s, self._velocities_mps = -np.inf, np.full((n_joints, 3), np.nan)

    def add(
        self,
        time_s: float,
        velocities_mps: Float[np.ndarray, "joint 3"],
        information: Float[np.ndarray, " joint"],
    ) -> None:
        """Take the velocities of the next frame, NaN where a joint is not estimated, and the information of its
        detections."""
        step_s = time_s - self._time_s
        squared = np.mean(((velocities_mps - self._velocities_mps) / step_s) ** 2, axis=-1)
        self._time_s, self._velocities_mps = time_s, velocities_mps
        keep = np.where(np.isfinite(squared), np.exp(-step_s / NEARBY_S), 1.0)
        self._squared = keep * self._squared + (1 - keep) * np.nan_to_num(squared)
        self._per_s = keep * self._per_s + (1 - keep) * information / step_s
        self._step_s = keep * self._step_s + (1 - keep) * np.where(keep < 1, step_s, 0.0)

    def density(self) -> Float[np.ndarray, " joint"]:
        """Power spectral density of each joint's noise; as process_density."""
        usual = np.full(self._squared.shape, initial_density(self._config))
        if not is_adaptive(self._config):
            return usual
        own = _resolved(self._squared, self._per_s, self._step_s, _LEAST_DENSITY_ONLINE, self._config)
        return shrunk(*own, usual, _USUAL_MEASUREMENTS)


def _squared_accelerations(
    positions_m: Float[np.ndarray, "frame joint 3"], time_s: Float[np.ndarray, " frame"]
) -> Float[np.ndarray, "frame joint"]:
    """Mean over the axes, (m/s^2)^2; NaN in the first and the last frame, and next to an unknown position."""
    step_s = np.diff(time_s)[:, None, None]
    change_mps = np.diff(np.diff(positions_m, axis=0) / step_s, axis=0)
    squared = np.full(positions_m.shape[:2], np.nan)
    squared[1:-1] = np.mean((change_mps / ((step_s[1:] + step_s[:-1]) / 2)) ** 2, axis=-1)
    return squared


def _resolved(
    squared: np.ndarray, per_s: np.ndarray, step_s: np.ndarray, least: float, config: MotionConfig
) -> tuple[np.ndarray, np.ndarray]:
    """The density whose smoothed motion has these mean square accelerations; and how many measurements of it the frames
    nearby are: as many as a motion along three axes up to the bandwidth b has degrees of freedom in their time, and no
    more than frames show. Where nothing is known, none."""
    between_frames = np.divide((_SMOOTHED * squared) ** 0.8, per_s**0.2, out=np.ones_like(squared), where=per_s > 0)
    density = between_frames * _missed_by_frames(between_frames * per_s * step_s**4)
    density = np.clip(density, min(least, config.acceleration_density), _MOST_DENSITY)
    bandwidth = np.minimum((density * per_s) ** 0.25 / _SMOOTHED, 1 / np.maximum(step_s, 1e-9))
    measurements = 3 * 2 * NEARBY_S * bandwidth
    known = np.isfinite(measurements)
    return np.where(known, density, 1.0), np.where(known, measurements, 0.0)


def _missed_by_frames(found: np.ndarray) -> np.ndarray:
    """By how many times the density is larger than q, where q b / (2 sqrt 2) is the mean square of differences between
    frames; of q I dt^4."""
    logs, times = _missed()
    return np.exp(np.interp(np.log(np.maximum(found, 1e-30)), logs, times))


@cache
def _missed() -> tuple[Float[np.ndarray, " strength"], Float[np.ndarray, " strength"]]:
    """Logarithms of q I dt^4 as differences between frames have it, and of its true value over it."""
    w = (np.arange(500) + 0.5) / 500 * np.pi
    true = np.geomspace(1e-4, 1e8, 200)
    signal, noise = true[:, None] * (2 + np.cos(w)) / 3, (2 - 2 * np.cos(w)) ** 2
    squared = np.mean(signal**2 / (signal + noise), axis=1)  # of accelerations, in units of 1 / (I dt^5)
    found = (_SMOOTHED * squared) ** 0.8
    return np.log(found), np.log(true / found)


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
