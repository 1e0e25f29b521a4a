"""Keypoints that are not what a network saw: guessed ones, and smoothed ones."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float, Int

from fgpose.diagnosis.body.joint_names import in_words_by_part
from fgpose.diagnosis.examined import Examined
from fgpose.diagnosis.hypotheses.consistency import SPREAD_M
from fgpose.diagnosis.hypotheses.scene import limb_joints
from fgpose.estimation.evidence.credibility import credible
from fgpose.finding import Code, Finding, Severity
from fgpose.observations import Observations
from fgpose.sampling import frames_per_second, parts_of
from fgpose_factors.robust_statistics import robust_sigma

# Of the usual confidence of the recording. Joints that a network sees have 0.7 to 1.2 times it, ears and toes that are
# half of the time on the far side of the body 0.4 (balance_openpose). Throughout: three quarters of the time, as knees
# and ankles behind occluders have 0.28 times it half of the time (fgpose_benchmarks/data/detection_errors).
_LOW, _THROUGHOUT = 0.4, 0.75
# Of the frames, in which a joint may be guessed in all views.
_DOUBTED = 0.03
# Compared are images of about this rate: what passes is faster than 3 Hz. Slower recordings cannot tell.
_RATE_HZ, LOWEST_HZ = 12.0, 9.0
_FAST = 0.75  # quantile of the speed: filters of networks for video follow what moves
_FEWEST = 100
# Of the spread of the joints: 0.024 to 0.13 of 107 recordings, 0.005 and more with filters of 4 Hz and more, which harm
# little, or with that of MediaPipe for video; 0.0002 to 0.008 with a Gaussian of 0.2 s, 0.00003 to 0.0007 of 0.4 s.
_TREMBLES = 0.005
# Of the distance between rays. Where both are small, the keypoints have no errors: they are of no network.
_OF_DISTANCE = 0.25
# Trembling at the first of these rates over that at the one above, and over the distance between rays; medians of the
# cameras. With networks 0.37 and 0.28 and more, with an exponential filter that lets a third of a new image pass, or
# One Euro, 0.15 to 0.26 and 0.1. Where one of the two is small, limbs are fast or errors last; both are in 1 of 97
# random recordings, with a rig whose rays meet nowhere.
_SHORT_HZ, _FILTERED, _OF_ERRORS = 28.0, 0.28, 0.2
WHITE = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / np.sqrt(70)
"""Leaves white noise as it is, and takes motion away."""


def low_confidence(examined: Examined) -> list[Finding]:
    """Joints that are detected, but hardly believed by the network itself, in most views."""
    confidence, seen = examined.confidence, examined.seen
    if not seen.any():
        return []
    usual = float(np.median(confidence[seen]))
    highest = [
        np.quantile(own[mask], _THROUGHOUT) if mask.any() else np.nan
        for own, mask in zip(np.moveaxis(confidence, -1, 0), np.moveaxis(seen, -1, 0), strict=True)
    ]
    skeleton = examined.main.skeleton
    joints = skeleton.joints
    low = [joint for joint, level in zip(joints, highest, strict=True) if level < _LOW * usual]
    if not low:
        return _doubted(examined.main)
    level = max(float(level) for level in highest if level < _LOW * usual)
    return [
        Finding(
            Code.LOW_CONFIDENCE,
            Severity.DOUBTFUL,
            f"The network is unsure of {in_words_by_part(skeleton, low)} throughout: confidence up to {level:.2f} in "
            f"three quarters of the detections, of all joints {usual:.2f} (median)",
            f"It probably guesses what it cannot see. Give --min-confidence {_above(level):.2f} to leave them out, or "
            "a skeleton without these joints.",
            0.5 * len(low) / len(joints),
            numbers={"confidence": level, "usual": usual},
        )
    ]


def _doubted(observations: Observations) -> list[Finding]:
    """Joints that are hardly called observed for their confidence, on whatever the views agree."""
    said = np.where(observations.seen.any(axis=1), credible(observations.confidence, observations.frame_time_s), np.nan)
    n_seen, skeleton = np.isfinite(said).sum(axis=0), observations.skeleton
    doubt = 1 - np.nansum(said, axis=0) / np.maximum(n_seen, 1)
    doubted = [joint for joint, of, n in zip(skeleton.joints, doubt, n_seen, strict=True) if n and of > _DOUBTED]
    if not doubted:
        return []
    most = float(doubt[n_seen > 0].max())
    return [
        Finding(
            Code.LOW_CONFIDENCE,
            Severity.NOTE,
            f"The network is less sure of {in_words_by_part(skeleton, doubted)} than of other joints, or than at other "
            "times, and may guess them in all views: their covariances contain that, however well the views agree",
            "If they are seen, give confidences that mean the same for all joints, or none.",
            0.2 * most,
            numbers={"doubt": most},
        )
    ]


def _above(level: float) -> float:
    """A threshold that nearly all of these detections are below: in steps of 0.05."""
    return math.ceil(1.3 * level / 0.05) * 0.05


def smoothed_keypoints(examined: Examined) -> list[Finding]:
    """Cameras whose keypoints of fast limbs have none of the errors that networks have in each image anew."""
    seen, rate_hz = examined.main, frames_per_second(examined.main.frame_time_s)
    if not rate_hz > LOWEST_HZ:
        return []
    # At 30 Hz it is three, and at 29.97 too.
    step, joints = max(int(rate_hz / _RATE_HZ + 0.51), 1), limb_joints(seen.skeleton)
    trembling = [_trembling(seen.points2d_px[:, c][:, joints], step) for c in range(seen.n_cameras)]
    alone = examined.rig.n_cameras < 2
    distance_m = np.inf if alone else examined.geometry.state.consistency.median_m
    smooth = [c for c, own in enumerate(trembling) if own < min(_TREMBLES, _OF_DISTANCE * distance_m / SPREAD_M)]
    if not smooth:
        return [] if alone else _filtered(seen, rate_hz, joints, trembling, distance_m / SPREAD_M)
    cameras = [""] if len(smooth) == seen.n_cameras else [seen.camera_names[c] for c in smooth]
    largest_mm = 1000 * SPREAD_M * max(trembling[c] for c in smooth)
    return [_smoothed(camera, largest_mm, Severity.NOTE if alone else Severity.DOUBTFUL) for camera in cameras]


def _filtered(
    seen: Observations, rate_hz: float, joints: Int[np.ndarray, " limb"], over_several: list[float], distance: float
) -> list[Finding]:
    """All cameras whose keypoints have errors, by the distance between rays as a share of the spread of the joints, and
    hardly tremble from one image to the next; how they tremble over several is known."""
    short = max(round(rate_hz / _SHORT_HZ), 1)
    if short * _SHORT_HZ > 1.5 * rate_hz:
        return []
    from_image_to_image = [_trembling(seen.points2d_px[:, c][:, joints], short) for c in range(seen.n_cameras)]
    trembling = np.stack([from_image_to_image, over_several], axis=1)
    known = trembling[np.isfinite(trembling).all(axis=1)]
    if not len(known):
        return []
    share, smallest = float(np.median(known[:, 0] / known[:, 1])), float(np.median(known[:, 0]))
    if not (share < _FILTERED and smallest < _OF_ERRORS * distance):
        return []
    return [
        Finding(
            Code.SMOOTHED_KEYPOINTS,
            Severity.NOTE,
            "The keypoints were probably filtered: from one image to the next they tremble by "
            f"{share:.2f} of what they tremble over several, and by {smallest / distance:.2f} of their errors; as "
            "networks give them it is 0.35 and 0.3 or more",
            "Give the keypoints as the network gave them. A filter that knows the past alone (exponential, One Euro, "
            "Kalman) delays the motion by what no camera shows, and no covariance contains.",
            0.3,
            numbers={"share": share},
        )
    ]


def _trembling(points_px: Float[np.ndarray, "frame joint 2"], step: int) -> float:
    """Noise of joints that move fast, by fourth differences of every so many frames, as a share of the spread of the
    joints in the image; NaN where there are too few. Images that are repeated tell nothing."""
    n_frames = len(points_px) - 4 * step
    if n_frames < 1:
        return np.nan
    noise_px, speed = (
        np.empty((n_frames, *points_px.shape[1:])),
        np.empty(points_px[:n_frames].shape[:2], points_px.dtype),
    )
    for part in parts_of(n_frames):
        five_px = [points_px[part.start + k * step : part.stop + k * step] for k in range(5)]
        noise_px[part] = np.abs(sum(weight * each for weight, each in zip(WHITE, five_px, strict=True)))
        speed[part] = np.linalg.norm(five_px[3] - five_px[1], axis=-1)
    known = np.isfinite(noise_px).all(axis=-1) & (noise_px > 0).any(axis=-1)
    if known.sum() < _FEWEST:
        return np.nan
    fast = known & (speed >= np.quantile(speed[known], _FAST))
    in_images_px = spread_px(points_px)
    return robust_sigma(noise_px[fast]) / in_images_px if in_images_px > 0 else np.nan


def spread_px(points_px: Float[np.ndarray, "frame joint 2"]) -> float:
    """Of the joints in an image that shows all of them, by both axes; 0: there is none."""
    parts = (points_px[part] for part in parts_of(len(points_px)))
    spreads_px = np.concatenate([np.std(some[np.isfinite(some).all(axis=(1, 2))], axis=1) for some in parts])
    return float(np.median(spreads_px)) if len(spreads_px) else 0.0


def _smoothed(camera: str, trembling_mm: float, severity: Severity) -> Finding:
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
