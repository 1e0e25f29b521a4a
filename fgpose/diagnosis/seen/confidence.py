"""Joints of which the network is unsure throughout."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from fgpose.diagnosis.body.joint_names import in_words
from fgpose.diagnosis.examined import Examined
from fgpose.finding import Code, Finding, Severity

# Of the usual confidence of the recording. Joints that a network sees have 0.7 to 1.2 times it, ears and toes that are
# half of the time on the far side of the body 0.4 (balance_openpose).
_LOW = 0.3


def low_confidence(examined: Examined) -> list[Finding]:
    """Joints that are detected, but hardly believed by the network itself, in most views."""
    confidence, seen = examined.confidence, examined.seen
    if not seen.any():
        return []
    usual = float(np.median(confidence[seen]))
    medians = [np.median(own[mask]) if mask.any() else np.nan for own, mask in _of_joints(confidence, seen)]
    joints = examined.main.skeleton.joints
    low = [joint for joint, median in zip(joints, medians, strict=True) if median < _LOW * usual]
    if not low:
        return []
    level = float(np.nanmax([median for median in medians if median < _LOW * usual]))
    return [
        Finding(
            Code.LOW_CONFIDENCE,
            Severity.DOUBTFUL,
            f"The network is unsure of {in_words(low)} throughout: median confidence {level:.2f} and less, of all "
            f"joints {usual:.2f}",
            "It probably guesses what it cannot see. Give --min-confidence to leave such detections out, or a skeleton "
            "without these joints.",
            0.5 * len(low) / len(joints),
            numbers={"confidence": level, "usual": usual},
        )
    ]


def _of_joints(confidence: np.ndarray, seen: np.ndarray) -> Iterable[tuple[np.ndarray, np.ndarray]]:
    return ((confidence[..., j], seen[..., j]) for j in range(confidence.shape[-1]))
