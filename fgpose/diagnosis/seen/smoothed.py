"""Keypoints that were smoothed before they were given: fast limbs are cut off, and nothing in the numbers says so."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.diagnosis.examined import Examined
from fgpose.diagnosis.hypotheses.agreement import SPREAD_M
from fgpose.diagnosis.hypotheses.scene import limb_joints
from fgpose.finding import Code, Finding, Severity
from fgpose.sampling import frames_per_second

# Compared are images of about this rate: what passes is faster than 3 Hz. Slower recordings cannot tell.
_RATE_HZ, _LOWEST_HZ = 12.0, 9.0
_FAST = 0.75  # quantile of the speed: filters of networks for video follow what moves
_FEWEST = 100
# Of the spread of the joints: 0.024 to 0.13 of 107 recordings, 0.005 and more with filters of 4 Hz and more, which harm
# little, or with that of MediaPipe for video; 0.0002 to 0.008 with a Gaussian of 0.2 s, 0.00003 to 0.0007 of 0.4 s.
_TREMBLES = 0.005
# Of the distance between rays. Where both are small, the keypoints have no errors: they are of no network.
_OF_DISTANCE = 0.25
_WHITE = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / np.sqrt(70)  # leaves white noise as it is, takes motion away
_SIGMA_OF_MEDIAN = 1.4826


def smoothed_keypoints(examined: Examined) -> list[Finding]:
    """Cameras whose keypoints of fast limbs have none of the errors that networks have in each image anew."""
    seen, rate_hz = examined.main, frames_per_second(examined.main.frame_time_s)
    if not rate_hz > _LOWEST_HZ:
        return []
    step, joints = max(round(rate_hz / _RATE_HZ), 1), limb_joints(seen.skeleton)
    trembling = [_trembling(seen.points2d_px[:, c][:, joints], step) for c in range(seen.n_cameras)]
    alone = examined.rig.n_cameras < 2
    distance_m = np.inf if alone else examined.geometry.state.agreement.median_m
    smooth = [c for c, own in enumerate(trembling) if own < min(_TREMBLES, _OF_DISTANCE * distance_m / SPREAD_M)]
    if not smooth:
        return []
    cameras = [""] if len(smooth) == seen.n_cameras else [seen.camera_names[c] for c in smooth]
    largest_mm = 1000 * SPREAD_M * max(trembling[c] for c in smooth)
    return [_finding(camera, largest_mm, Severity.NOTE if alone else Severity.DOUBTFUL) for camera in cameras]


def _trembling(points_px: Float[np.ndarray, "frame joint 2"], step: int) -> float:
    """Noise of joints that move fast, by fourth differences of every so many frames, as a share of the spread of the
    joints in the image; NaN where there are too few. Images that are repeated tell nothing."""
    n_frames = len(points_px) - 4 * step
    if n_frames < 1:
        return np.nan
    parts_px = [points_px[k * step : k * step + n_frames] for k in range(5)]
    noise_px = np.abs(sum(weight * part for weight, part in zip(_WHITE, parts_px, strict=True)))
    speed = np.linalg.norm(parts_px[3] - parts_px[1], axis=-1)
    known = np.isfinite(noise_px).all(axis=-1) & (noise_px > 0).any(axis=-1)
    if known.sum() < _FEWEST:
        return np.nan
    fast = known & (speed >= np.quantile(speed[known], _FAST))
    whole = points_px[np.isfinite(points_px).all(axis=(1, 2))]
    spread_px = float(np.median(np.std(whole, axis=1))) if len(whole) else 0.0
    return _SIGMA_OF_MEDIAN * float(np.median(noise_px[fast])) / spread_px if spread_px > 0 else np.nan


def _finding(camera: str, trembling_mm: float, severity: Severity) -> Finding:
    """Of one camera; empty: of all."""
    who = camera or "all cameras"
    return Finding(
        Code.SMOOTHED_KEYPOINTS,
        severity,
        f"The keypoints of {who} were smoothed: where limbs move fast, they tremble by {trembling_mm:.1g} mm at the "
        "body above 3 Hz, where networks have errors of 10 to 60 mm, new in each image",
        "Give the keypoints as the network gave them. Smoothed ones cut off what is fast, by more than the estimate "
        "claims; fgpose smooths by itself, and says how sure it is.",
        0.6,
        camera=camera,
        numbers={"trembling_mm": trembling_mm},
    )
