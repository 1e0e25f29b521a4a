"""Time stamps of the images of a video, some of which may be wrong."""

from __future__ import annotations

from bisect import bisect_left

import numpy as np
from jaxtyping import Float, Int

# Images that are closer than this share of an image's duration were not taken so: the clock went back.
_CLOSEST = 0.1
_FEWEST = 10  # images that tell what is far from them


def repaired(
    stamps_s: Float[np.ndarray, " image"], step_s: float
) -> tuple[Float[np.ndarray, " image"] | None, Int[np.ndarray, " bad"]]:
    """Stamps that increase, and the images whose stamps do not, which are interpolated.

    None if most do not, or if so many lie between others that the clock went back.

    Args:
        stamps_s: NaN where there is none.
        step_s: how long an image usually lasts.
    """
    good = _without_far_ends(_increasing(stamps_s), stamps_s)
    bad = np.setdiff1d(np.arange(len(stamps_s)), good)
    if len(bad) >= len(good):
        return None, bad
    times_s = _between_good(stamps_s, good, step_s)
    return (times_s if (np.diff(times_s) > _CLOSEST * step_s).all() or not len(bad) else None), bad


def _increasing(stamps_s: Float[np.ndarray, " image"]) -> Int[np.ndarray, " good"]:
    """The most images whose stamps increase; of two with the same stamp the first."""
    ends: list[int] = []
    """Of the sequences of each length, the image that ends the one whose last stamp is smallest."""
    before = np.full(len(stamps_s), -1)
    for image in np.flatnonzero(np.isfinite(stamps_s)).tolist():
        length = bisect_left(ends, stamps_s[image], key=lambda end: stamps_s[end])
        if length < len(ends) and stamps_s[ends[length]] == stamps_s[image]:
            continue
        before[image] = ends[length - 1] if length else -1
        ends[length : length + 1] = [image]
    chain: list[int] = []
    image = ends[-1] if ends else -1
    while image >= 0:
        chain.append(image)
        image = int(before[image])
    return np.array(chain[::-1], dtype=int)


def _without_far_ends(
    good: Int[np.ndarray, " good"], stamps_s: Float[np.ndarray, " image"]
) -> Int[np.ndarray, " fewer"]:
    """Without a first or last one that is farther from all others than these last: it increases whatever it is."""
    for end in (slice(1, None), slice(None, -1)):
        others = good[end]
        lasts_s, all_s = (float(np.ptp(stamps_s[each])) if len(each) else 0.0 for each in (others, good))
        if len(others) >= _FEWEST and all_s - lasts_s > lasts_s:
            good = others
    return good


def _between_good(
    stamps_s: Float[np.ndarray, " image"], good: Int[np.ndarray, " good"], step_s: float
) -> Float[np.ndarray, " image"]:
    """The stamps, those of all but the good images interpolated; at the ends at this distance from each other."""
    n_images = len(stamps_s)
    images = np.concatenate([[-1], good, [n_images]])
    first_s, last_s = stamps_s[good[0]], stamps_s[good[-1]]
    ends_s = first_s - (good[0] + 1) * step_s, last_s + (n_images - good[-1]) * step_s
    return np.interp(np.arange(n_images), images, np.concatenate([ends_s[:1], stamps_s[good], ends_s[1:]]))
