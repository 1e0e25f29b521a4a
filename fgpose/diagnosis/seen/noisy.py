"""Detections that jump about from image to image in all views: in the dark, of blurred or of tiny images."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.diagnosis.examined import Examined
from fgpose.diagnosis.hypotheses.consistency import SPREAD_M
from fgpose.diagnosis.hypotheses.scene import limb_joints
from fgpose.diagnosis.seen.keypoints import LOWEST_HZ, WHITE
from fgpose.finding import Code, Finding, Severity
from fgpose.sampling import frames_per_second, stretches
from fgpose_factors.robust_statistics import robust_sigma

# Along each axis of the image, at the body: three times the errors of networks, of which a third at most is new in each
# image.
_NOISY_M = 0.054
_BLOCK_S, _LEAST_S = 1.0, 2.0
_FEWEST = 10  # numbers that tell a standard deviation
_MOST_VIEWS = 0.5  # of those that show somebody: noise of a camera is told of it by other checks
_ALL = 0.8  # of the time


def noisy_keypoints(examined: Examined) -> list[Finding]:
    """Stretches of time in which most views have errors of decimetres that are others in each image: no motion is as
    fast, and what agrees with none looks like somebody else, or like another calibration."""
    seen = examined.main
    if not frames_per_second(seen.frame_time_s) > LOWEST_HZ:
        return []
    number = ((seen.frame_time_s - seen.frame_time_s[0]) / _BLOCK_S).astype(int)
    blocks, points_px = np.unique(number), seen.points2d_px[:, :, limb_joints(seen.skeleton)]
    noise_m = np.stack([_noise_m(points_px[number == block]) for block in blocks])
    told = np.isfinite(noise_m)
    noisy = told.any(axis=1) & ((noise_m > _NOISY_M).sum(axis=1) > _MOST_VIEWS * told.sum(axis=1))
    if not noisy.sum() * _BLOCK_S > _LEAST_S:
        return []
    return [_noisy(examined, noisy, noise_m, float(seen.frame_time_s[0]))]


def _noisy(
    examined: Examined, noisy: Bool[np.ndarray, " block"], noise_m: Float[np.ndarray, "block camera"], begin_s: float
) -> Finding:
    first, end = max(stretches(noisy), key=lambda stretch: stretch[1] - stretch[0])
    from_s, to_s, share = begin_s + first * _BLOCK_S, begin_s + end * _BLOCK_S, float(noisy.mean())
    there_m = float(np.nanmedian(noise_m[noisy]))
    when = "throughout" if share > _ALL else f"from {from_s:.0f} to {to_s:.0f} s"
    reason = f"The keypoints jump about from image to image by {100 * there_m:.0f} cm at the body in most views, {when}"
    remedy = "More light, shorter exposures, larger images of the person, or a larger network."
    if share <= _ALL:
        usual_m = float(np.nanmedian(noise_m[~noisy])) if np.isfinite(noise_m[~noisy]).any() else np.nan
        reason += f"; otherwise by {100 * usual_m:.1f} cm: too much for what the rest tells of the detector"
        remedy = f"Cut the recording there, and estimate each part by itself. {remedy}"
    return Finding(
        Code.NOISY_KEYPOINTS,
        Severity.DOUBTFUL,
        reason,
        remedy,
        0.7,
        from_s=None if share > _ALL else from_s,
        to_s=None if share > _ALL else to_s,
        numbers={"noise_m": there_m, "share": share},
    )


def _noise_m(points_px: Float[np.ndarray, "frame camera joint 2"]) -> Float[np.ndarray, " camera"]:
    """Standard deviation of what is new in each image, at a body of usual size; NaN where there is too little."""
    n_frames, found_m = len(points_px) - len(WHITE) + 1, np.full(points_px.shape[1], np.nan)
    if n_frames < 1:
        return found_m
    white_px = np.asarray(sum(weight * points_px[k : k + n_frames] for k, weight in enumerate(WHITE)))
    for c, own in enumerate(np.moveaxis(white_px, 1, 0)):
        joints = np.isfinite(own).all(axis=-1).any(axis=0)
        known_px = own[np.isfinite(own)]
        if joints.sum() > 2 and known_px.size >= _FEWEST:
            # Of the mean pose: that of a noisy one is larger.
            mean_px = np.nanmean(points_px[:, c][:, joints], axis=0)
            found_m[c] = SPREAD_M * robust_sigma(known_px) / np.sqrt(np.var(mean_px, axis=0).sum())
    return found_m
