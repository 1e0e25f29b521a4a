"""Detections of a camera between its images."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.sampling import usual_step_s

# A dropped image is a gap of two steps, the jitter of a webcam's clock a few tenths of one.
_MAX_STEPS = 1.5


def between_images(
    time_s: Float[np.ndarray, " image"], values: Float[np.ndarray, "image ..."], at_s: Float[np.ndarray, " sample"]
) -> Float[np.ndarray, "sample ..."]:
    """Linear between the two images around each time; NaN before the first, after the last and in a gap.

    At 25 Hz a joint that is accelerated by 20 m/s^2, as the ankle of a walker, is put 4 mm beside its way at most.
    """
    if len(time_s) < 2:
        return np.full((len(at_s), *values.shape[1:]), np.nan)
    before, share, is_there = _around(time_s, at_s)
    share = share.reshape(-1, *(1,) * (values.ndim - 1))
    # Where the time is that of an image, the other one does not matter, and may be missing.
    first, second = (1 - share) * values[before], share * values[before + 1]
    between = np.where(share == 0, values[before], np.where(share == 1, values[before + 1], first + second))
    between[~is_there] = np.nan
    return between


def smaller_around(
    time_s: Float[np.ndarray, " image"], values: Float[np.ndarray, "image ..."], at_s: Float[np.ndarray, " sample"]
) -> Float[np.ndarray, "sample ..."]:
    """The smaller of the values of the two images around each time; 0 where there are not two, or a gap."""
    if len(time_s) < 2:
        return np.zeros((len(at_s), *values.shape[1:]))
    before, share, is_there = _around(time_s, at_s)
    share = share.reshape(-1, *(1,) * (values.ndim - 1))
    first, second = values[before], values[before + 1]
    smaller = np.where(share == 0, first, np.where(share == 1, second, np.minimum(first, second)))
    smaller[~is_there] = 0.0
    return smaller


def _around(
    time_s: Float[np.ndarray, " image"], at_s: Float[np.ndarray, " sample"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Index of the image before each time, the share of the way to the next, and whether both are near."""
    before = np.clip(np.searchsorted(time_s, at_s, side="right") - 1, 0, len(time_s) - 2)
    step_s = time_s[before + 1] - time_s[before]
    share = (at_s - time_s[before]) / step_s
    # Sums of times are rounded: what is an image within a nanosecond is that image.
    share = np.where(np.abs(share - np.round(share)) < 1e-7, np.round(share), share)
    is_image = (share == 0) | (share == 1)
    inside = (share >= 0) & (share <= 1) & (is_image | (step_s <= _MAX_STEPS * usual_step_s(time_s)))
    return before, np.clip(share, 0, 1), inside
