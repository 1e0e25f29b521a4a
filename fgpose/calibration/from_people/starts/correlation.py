"""How well two tracks fit together at every shift between the clocks of their cameras."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fgpose.calibration.from_people.starts.motion_signals import MotionSignals
from fgpose.estimation.noise import TELLING_HZ
from fgpose_factors.robust_statistics import robust_sigma

# Two tracks that have less in common say nothing: a quarter of the shorter one, and of short ones more.
_MIN_SHARE = 0.25
_MIN_OVERLAP_S, _MAX_MIN_OVERLAP_S, _SHORT_SHARE = 2.0, 10.0, 0.6
# Peaks that are nearer together are one: it is the gait that makes others, a step (0.4 s) away or more.
PEAK_WIDTH_S = 0.25


@dataclass(frozen=True, eq=False)
class Correlation:
    """Of two tracks, for all whole shifts in samples: time of the first = time of the second + shift / TELLING_HZ."""

    first_shift: int
    score: Float[np.ndarray, " shift"]
    """Normalised cross-correlation times the root of the seconds in common, in units of what chance makes of it
    (robust standard deviation over all shifts); 0 where the tracks have too little in common."""

    def at(self, shifts: Int[np.ndarray, " _"]) -> Float[np.ndarray, " _"]:
        """Scores of shifts, 0 of those that are too large to have anything in common."""
        index = shifts - self.first_shift
        inside = (index >= 0) & (index < len(self.score))
        return np.where(inside, self.score[np.clip(index, 0, max(len(self.score) - 1, 0))], 0.0)

    @property
    def shifts(self) -> Int[np.ndarray, " shift"]:
        return self.first_shift + np.arange(len(self.score))

    @property
    def mirrored(self) -> Correlation:
        """Of the second track with the first."""
        return Correlation(-int(self.shifts[-1]), self.score[::-1])


def correlate(first: MotionSignals, second: MotionSignals) -> Correlation:
    """Masked normalised cross-correlation over all channels together, by FFT (Padfield 2012).

    The mean of the signals is zero, so none is subtracted.
    """
    from scipy.fft import next_fast_len

    n_first, n_second = first.known.shape[1], second.known.shape[1]
    if not n_first or not n_second:
        return Correlation(0, np.zeros(1))
    n_channels = min(len(first.values), len(second.values))
    size = next_fast_len(n_first + n_second - 1, real=True)

    def product(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        spectrum = np.fft.rfft(one[:n_channels], size) * np.fft.rfft(other[:n_channels], size).conj()
        # From -(n_second - 1) to n_first - 1.
        return np.roll(np.fft.irfft(spectrum.sum(axis=0), size), n_second - 1)[: n_first + n_second - 1]

    mask, other_mask = first.known.astype(float), second.known.astype(float)
    energy = product(first.values**2, other_mask) * product(mask, second.values**2)
    overlap_s = product(mask, other_mask) / max(_n_common(first, second), 1) / TELLING_HZ
    enough = overlap_s >= min_overlap_s(first, second)
    correlation = product(first.values, second.values) / np.sqrt(np.maximum(energy, 1e-12))
    score = np.where(enough, correlation * np.sqrt(np.maximum(overlap_s, 0.0)), 0.0)
    shift = first.first - second.first - (n_second - 1)
    return Correlation(shift, score / chance_of(score[enough]))


def min_overlap_s(first: MotionSignals, second: MotionSignals) -> float:
    """What two tracks need to have in common."""
    shorter_s = min(first.lasts_s, second.lasts_s)
    return float(np.clip(_MIN_SHARE * shorter_s, min(_MIN_OVERLAP_S, _SHORT_SHARE * shorter_s), _MAX_MIN_OVERLAP_S))


def peaks(score: Float[np.ndarray, " shift"], at_most: int, width_s: float = PEAK_WIDTH_S) -> Int[np.ndarray, " peak"]:
    """Indices of the highest positive local maxima, the highest first."""
    from scipy.signal import find_peaks

    padded = np.concatenate([[-np.inf], score, [-np.inf]])
    found = find_peaks(padded, height=1e-9, distance=max(round(width_s * TELLING_HZ), 1))[0] - 1
    return found[np.argsort(-score[found], kind="stable")][:at_most]


def _n_common(first: MotionSignals, second: MotionSignals) -> int:
    """Channels that both have."""
    n = min(len(first.known), len(second.known))
    return int((first.known[:n].any(axis=1) & second.known[:n].any(axis=1)).sum())


def chance_of(score: Float[np.ndarray, " shift"]) -> float:
    """Robust standard deviation of scores around 0; 1 if there are none."""
    spread = robust_sigma(score) if score.size else 0.0
    return spread if spread > 1e-6 else 1.0
