"""Joints of which the network is unsure throughout."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from fgpose.diagnosis.body.joint_names import in_words
from fgpose.diagnosis.examined import Examined
from fgpose.finding import Code, Finding, Severity

# Of the usual confidence of the recording. Joints that a network sees have 0.7 to 1.2 times it, ears and toes that are
# half of the time on the far side of the body 0.4 (balance_openpose). Throughout: three quarters of the time, as knees
# and ankles behind occluders have 0.28 times it half of the time (fgpose_benchmarks/data/detection_errors).
_LOW, _THROUGHOUT = 0.4, 0.75


def low_confidence(examined: Examined) -> list[Finding]:
    """Joints that are detected, but hardly believed by the network itself, in most views."""
    confidence, seen = examined.confidence, examined.seen
    if not seen.any():
        return []
    usual = float(np.median(confidence[seen]))
    highest = [
        np.quantile(own[mask], _THROUGHOUT) if mask.any() else np.nan for own, mask in _of_joints(confidence, seen)
    ]
    joints = examined.main.skeleton.joints
    low = [joint for joint, level in zip(joints, highest, strict=True) if level < _LOW * usual]
    if not low:
        return []
    level = max(float(level) for level in highest if level < _LOW * usual)
    return [
        Finding(
            Code.LOW_CONFIDENCE,
            Severity.DOUBTFUL,
            f"The network is unsure of {in_words(low)} throughout: confidence up to {level:.2f} in three quarters "
            f"of the detections, of all joints {usual:.2f} (median)",
            f"It probably guesses what it cannot see. Give --min-confidence {_above(level):.2f} to leave them out, or "
            "a skeleton without these joints.",
            0.5 * len(low) / len(joints),
            numbers={"confidence": level, "usual": usual},
        )
    ]


def _above(level: float) -> float:
    """A threshold that nearly all of these detections are below: in steps of 0.05."""
    return math.ceil(1.3 * level / 0.05) * 0.05


def _of_joints(confidence: np.ndarray, seen: np.ndarray) -> Iterable[tuple[np.ndarray, np.ndarray]]:
    return ((confidence[..., j], seen[..., j]) for j in range(confidence.shape[-1]))
