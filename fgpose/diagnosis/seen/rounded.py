"""Gaps that were filled along straight lines, and rounded afterwards: to tenths or whole pixels.

Then bends of a straight line are as small as many of a joint that moves, and only many of them in a row are not by
chance.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.sampling import parts_of, stretches

_BENDS = 2.01  # a straight line, times the step of rounding
_OFF, _MOVES = 0.75, 10  # from a line, root mean square, and along it, in steps
_LEAST, _MOST = 5, 200  # images in a row; runs of a joint that are looked at, the longest
# Moments of the same joint that are as fast, by which it is known how often bends are small. Slow ones hardly bend.
_AS_FAST, _FEWEST = 0.5, 20
# Expected number of such runs of a joint. Of real detectors, rounded to tenths and to whole pixels, none has less than
# 1e-5; with gaps of 0.4 to 1.2 s that were filled, half of them have less than 1e-6.
_BY_CHANCE = 1e-6


def filled_and_rounded(
    points_px: Float[np.ndarray, "frame joint 2"], bend_px: Float[np.ndarray, "frame-2 joint"], step_px: float
) -> Bool[np.ndarray, "frame joint"]:
    """Of one camera.

    Args:
        points_px: NaN = missing.
        bend_px: their second differences.
        step_px: to which they were rounded.
    """
    filled = np.zeros(points_px.shape[:2], dtype=bool)
    for joint in range(points_px.shape[1]):
        own_px = points_px[:, joint].astype(float)
        for first, end in _improbable(own_px, bend_px[:, joint], step_px):
            filled[first + 1 : end + 1, joint] = True
    return filled


def _improbable(
    points_px: Float[np.ndarray, "frame 2"], bend_px: Float[np.ndarray, " bend"], step_px: float
) -> list[tuple[int, int]]:
    """Runs of bends of a joint."""
    small, speed_px = bend_px <= _BENDS * step_px, np.linalg.norm(points_px[2:] - points_px[:-2], axis=-1) / 2
    long = [run for run in stretches(small) if run[1] - run[0] >= _LEAST]
    long = sorted(long, key=lambda run: run[0] - run[1])[:_MOST]
    runs = [(run, speed) for run in long if (speed := _speed_on_line_px(points_px[run[0] : run[1] + 2], step_px)) > 0]
    others = np.isfinite(bend_px)
    for (first, end), _ in runs:
        others[first:end] = False
    found = []
    for (first, end), speed in runs:
        as_fast = others & (speed_px >= _AS_FAST * speed)
        number = int(as_fast.sum())
        share = max(float(small[as_fast].mean()), 1 / number) if number >= _FEWEST else 1.0
        if number * share ** (end - first) < _BY_CHANCE:
            found.append((first, end))
    return found


def _speed_on_line_px(points_px: Float[np.ndarray, "frame 2"], step_px: float) -> float:
    """From image to image; 0 where they are on no line, or hardly move."""
    time = np.arange(len(points_px)) - (len(points_px) - 1) / 2
    centred_px = points_px - points_px.mean(axis=0)
    slope_px = time @ centred_px / (time @ time)
    off_px = centred_px - time[:, None] * slope_px
    speed_px = float(np.linalg.norm(slope_px))
    is_line = np.sqrt(np.mean(off_px**2, axis=0)).max() <= _OFF * step_px
    return speed_px if is_line and speed_px * (len(time) - 1) >= _MOVES * step_px else 0.0


def differences_px(points_px: Float[np.ndarray, "frame joint 2"], order: int) -> Float[np.ndarray, "shorter joint"]:
    """Of this order (the second are bends), the larger of both axes; in double precision, as what counts as exact is
    not far above the rounding of single."""
    found_px = np.empty((max(len(points_px) - order, 0), points_px.shape[1]))
    for part in parts_of(len(found_px)):
        some_px = points_px[part.start : part.stop + order].astype(float)
        found_px[part] = np.abs(np.diff(some_px, n=order, axis=0)).max(axis=-1)
    return found_px
