"""Whether limbs move as fast as those of people do: nothing else contradicts a frame rate that all cameras share."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.diagnosis.examined import Examined, NotJudgedError
from fgpose.finding import Code, Finding, Severity
from fgpose.sampling import usual_step_s

_LIMBS = ("left_wrist", "right_wrist", "left_ankle", "right_ankle")
_FRAMES = 900  # from the middle
_FEWEST, _SEEN = 100, 0.8
_MOVES_M = 0.1
# For how long limbs keep their velocity: 0.10 to 0.28 s in walks, punches, climbing, housework and balancing. Exercises
# may be slow.
_USUAL, _SLOW_S, _TOO_SLOW_S = "0.1 to 0.3 s", 0.45, 1.0
# Of a filter and of white noise after it are 1.7 standard deviations of the filter.
_MORE_THAN_FILTER, _PER_FILTER = 3.0, 12


def slow_motion(examined: Examined) -> list[Finding]:
    """Limbs that turn round too slowly: numbers of frames as times, or a slow-motion video."""
    kept_s = velocities_kept_s(examined)
    if kept_s < _SLOW_S:
        return []
    return [
        Finding(
            Code.FRAME_RATE,
            Severity.WRONG if kept_s > _TOO_SLOW_S else Severity.NOTE,
            f"Wrists and ankles keep their velocity for {kept_s:.1f} s, those of people do for {_USUAL}: speeds are "
            "too small, or the person moves very slowly",
            "Is the frame rate right (--fps)? Are times numbers of frames, or the videos slow motion?",
            0.7,
            numbers={"velocity_kept_s": kept_s},
        )
    ]


def velocities_kept_s(examined: Examined) -> float:
    """After which time half is left of the correlation of the velocities of the limbs, relative to the body: the
    median of those that move. Raises NotJudgedError if that is not known."""
    main, middle = examined.main, examined.main.n_frames // 2
    stretch = np.arange(max(middle - _FRAMES // 2, 0), min(middle + _FRAMES // 2, main.n_frames))
    body_m, joints = examined.agreed_m(stretch), main.skeleton.joints
    limbs_m = [body_m[:, joints.index(name)] - _centre_m(body_m) for name in _LIMBS if name in joints]
    kept = [frames for limb_m in limbs_m if (frames := _frames_kept(limb_m)) is not None]
    if not kept:
        raise NotJudgedError("no wrist or ankle is seen to move for long enough")
    return float(np.median(kept)) * usual_step_s(main.frame_time_s[stretch])


def _centre_m(body_m: Float[np.ndarray, "frame joint 3"]) -> Float[np.ndarray, "frame 3"]:
    known = np.isfinite(body_m)
    return np.where(known, body_m, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)


def _frames_kept(limb_m: Float[np.ndarray, "frame 3"]) -> float | None:
    """Smoothed as little as noise allows, which makes velocities change from frame to frame."""
    known = np.flatnonzero(np.isfinite(limb_m).all(axis=-1))
    if len(known) < max(_FEWEST, _SEEN * len(limb_m)):
        return None
    frames = np.arange(known[0], known[-1] + 1)
    path_m = np.stack([np.interp(frames, known, limb_m[known, axis]) for axis in range(3)], axis=-1)
    away_m = np.linalg.norm(path_m - np.median(path_m, axis=0), axis=-1)
    if np.quantile(away_m, 0.9) < _MOVES_M:
        return None
    sigma = 1
    while _PER_FILTER * sigma < len(path_m):
        kept = _half_width(np.diff(_smoothed(path_m, sigma), axis=0))
        if kept > _MORE_THAN_FILTER * sigma:
            return kept
        sigma *= 2
    return None


def _smoothed(path_m: Float[np.ndarray, "frame 3"], sigma: int) -> Float[np.ndarray, "whole 3"]:
    """Of the frames around which all of the filter lies."""
    from scipy.ndimage import gaussian_filter1d

    reach = 3 * sigma
    return np.asarray(gaussian_filter1d(path_m, sigma, axis=0, radius=reach))[reach:-reach]


def _half_width(velocities: Float[np.ndarray, "frame 3"]) -> float:
    """Of their autocorrelation."""
    spectrum = np.abs(np.fft.rfft(velocities - velocities.mean(axis=0), 2 * len(velocities), axis=0)) ** 2
    correlation = np.fft.irfft(spectrum.sum(axis=1))[: len(velocities)]
    return float(np.argmax(correlation < 0.5 * correlation[0]))
