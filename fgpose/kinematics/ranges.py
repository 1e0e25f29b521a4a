"""Ranges of angles over time, without what noise adds to them.

The greatest of many values that each have an error is mostly one whose error is great too: of 250 frames of a knee, 5
degrees more than the greatest true angle. How much a curve is stretched so is simulated (bias correction by parametric
bootstrap, Efron and Tibshirani 1993): noise of the stated standard deviations is added to the curve once more, and what
that does to a quantile on average is taken away from it.

Of the stated error only a part is noise from frame to frame. What is constant shifts the whole curve, and where joints
are predicted the curve is smoother than the truth. So there is at most as much noise as is stated in half of the
frames, and at most as much as the curve is rough: its second differences over NOISE_S cannot be less than those of the
noise in it, on average over a second. Rather too little is taken away than too much.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.sampling import usual_step_s
from fgpose.shown import Shown

NOISE_S = 0.1
"""Correlation time of the noise in smoothed angles (Matern 3/2): after it, 74 % are left, after three times as long
20 %, as on clips of motion capture with simulated errors and with those of real networks."""
_ROUGH_S = 1.0  # over so long roughness is averaged
_SAMPLES = 32  # leave a sixth of the standard deviation of an extreme, beside which the stated one is large
_SETTLED = 8.0  # correlation times after which a process has forgotten that it began at nothing


@dataclass(frozen=True, eq=False, repr=False)
class AngleRanges(Shown):
    """Quantiles of angles over time, as they would be without noise from frame to frame."""

    quantiles_deg: Float[np.ndarray, "share angle"]
    """NaN: never determined. On the circle as JointAngles.quantiles_deg."""
    sigma_deg: Float[np.ndarray, "share angle"]
    """Standard deviations of these: of the angle where it has about this value, with all that lasts. NaN: not known."""
    noise_deg: Float[np.ndarray, "share angle"]
    """What noise has added to the quantiles of the curve, and was taken away; NaN where no standard deviation is
    known."""


def ranges_without_noise(
    time_s: Float[np.ndarray, " frame"],
    opened_deg: Float[np.ndarray, "frame angle"],
    sigma_deg: Float[np.ndarray, "frame angle"],
    shares: Float[np.ndarray, " share"],
) -> AngleRanges:
    """Ranges of angles that do not jump by whole turns.

    Args:
        time_s: of the frames.
        opened_deg: NaN: not determined.
        sigma_deg: their standard deviations; NaN: not known.
        shares: of the frames in which an angle is determined, from 0 to 1.
    """
    step_s, shape = usual_step_s(time_s), (len(shares), opened_deg.shape[1])
    without_deg, own_sigma_deg, added_deg = (np.full(shape, np.nan) for _ in range(3))
    for n in np.flatnonzero(np.isfinite(opened_deg).any(axis=0)).tolist():
        known = np.isfinite(opened_deg[:, n])
        angle_deg, stated_deg = opened_deg[known, n], sigma_deg[known, n]
        plain_deg = without_deg[:, n] = np.quantile(angle_deg, shares)
        if np.isfinite(stated_deg).all():
            noise_deg = _noise_sigma_deg(opened_deg[:, n], sigma_deg[:, n], step_s)[known]
            noisy_deg, own_sigma_deg[:, n] = _once_more(angle_deg, stated_deg, noise_deg, shares, step_s)
            # To take so much away from a flat curve that extremes change places would be too much.
            most_deg = plain_deg - np.median(angle_deg)
            added_deg[:, n] = np.clip(noisy_deg - plain_deg, np.minimum(most_deg, 0.0), np.maximum(most_deg, 0.0))
            without_deg[:, n] = plain_deg - added_deg[:, n]
    return AngleRanges(without_deg, own_sigma_deg, added_deg)


def _once_more(
    angle_deg: Float[np.ndarray, " frame"],
    sigma_deg: Float[np.ndarray, " frame"],
    noise_deg: Float[np.ndarray, " frame"],
    shares: Float[np.ndarray, " share"],
    step_s: float,
) -> tuple[Float[np.ndarray, " share"], Float[np.ndarray, " share"]]:
    """Quantiles of a curve with so much more noise, on average, and the standard deviations of the frames that have
    them."""
    rng, at = np.random.default_rng(0), np.rint(np.asarray(shares) * (len(angle_deg) - 1)).astype(int)
    found_deg, squared_deg2 = np.zeros(len(at)), np.zeros(len(at))
    for _ in range(_SAMPLES):
        noisy_deg = angle_deg + noise_deg * _noise(len(angle_deg), step_s, rng)
        frames = np.argpartition(noisy_deg, np.unique(at))[at]
        found_deg += np.quantile(noisy_deg, shares) / _SAMPLES
        squared_deg2 += sigma_deg[frames] ** 2 / _SAMPLES
    return found_deg, np.sqrt(squared_deg2)


def _noise_sigma_deg(
    angle_deg: Float[np.ndarray, " frame"], sigma_deg: Float[np.ndarray, " frame"], step_s: float
) -> Float[np.ndarray, " frame"]:
    """Standard deviation of the noise from frame to frame: the stated or the usual one, or as much as the curve is
    rough around there. None where roughness is not known."""
    from scipy.ndimage import uniform_filter1d

    lag, n_frames = max(round(NOISE_S / step_s), 1), len(angle_deg)
    if n_frames <= 2 * lag:
        return np.zeros(n_frames)
    second_deg = np.full(n_frames, np.nan)
    second_deg[lag:-lag] = angle_deg[2 * lag :] - 2 * angle_deg[lag:-lag] + angle_deg[: -2 * lag]
    told, width = np.isfinite(second_deg), int(np.clip(round(_ROUGH_S / step_s), 1, 2 * n_frames))
    of_noise = 6 - 8 * _correlation(lag * step_s) + 2 * _correlation(2 * lag * step_s)
    in_curve, in_noise = np.where(told, [second_deg**2, of_noise * sigma_deg**2], 0.0)
    found, most = (uniform_filter1d(each, width, mode="nearest") for each in (in_curve, in_noise))
    share = np.clip(np.divide(found, most, out=np.zeros(n_frames), where=most > 0), 0.0, 1.0)
    return np.sqrt(share) * np.minimum(sigma_deg, np.nanmedian(sigma_deg))


def _correlation(after_s: float) -> float:
    """Of the noise after this time."""
    return float((1 + after_s / NOISE_S) * np.exp(-after_s / NOISE_S))


def _noise(n_frames: int, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " frame"]:
    """Of variance 1: white noise through two first-order filters."""
    from scipy.signal import lfilter

    left = float(np.exp(-step_s / NOISE_S))
    before = int(min(_SETTLED * NOISE_S / step_s, n_frames)) + 1
    scale = np.sqrt((1 - left**2) ** 3 / (1 + left**2))
    filtered = lfilter([scale], [1.0, -2 * left, left**2], rng.standard_normal(before + n_frames))
    return np.asarray(filtered)[before:]
