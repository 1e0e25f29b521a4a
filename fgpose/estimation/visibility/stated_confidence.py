"""What the confidence that a detector states says for a visible joint against a hallucinated one.

Some networks know what they invent, others do not, and one may know it of legs and not of wrists. So nothing is assumed
of it: how often each confidence is stated is counted in the recording, of detections that other views show to be of
their joints and of those that they show to be hallucinated. Where the two are alike it says nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.noise import MEMORY_S
from fgpose.estimation.visibility.spread import PRIOR_MEASUREMENTS, PRIOR_MEASUREMENTS_OF_CAMERA

# Tenths, and finer at either end: some networks are sure of nearly all that they see (BlazePose: half of it from 0.99).
_LEVELS = np.array([0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99])


@dataclass(frozen=True, eq=False)
class StatedConfidence:
    """How many measurements of visible and of hallucinated detections had a confidence of each level."""

    counts: Float[np.ndarray, "2 joint level"]

    @staticmethod
    def unknown(n_joints: int) -> StatedConfidence:
        """Before there is any frame."""
        return StatedConfidence(np.zeros((2, n_joints, len(_LEVELS) + 1)))

    @staticmethod
    def of(
        evidence: Evidence,
        visibility: Float[np.ndarray, "frame camera joint"],
        independent: Float[np.ndarray, "*#frames"],
    ) -> StatedConfidence:
        """Of the detections of some frames; one that no other view can contradict tells nothing.

        Args:
            evidence: of the frames.
            visibility: probability that each detection is of its joint.
            independent: how much of an independent measurement each detection is.
        """
        told = evidence.detected & (evidence.detected.sum(axis=1, keepdims=True) > 1)
        measurements = np.where(told, independent, 0.0)
        at, shape = _at_level(evidence.confidence), (told.shape[2], len(_LEVELS) + 1)
        shares = visibility, 1 - visibility
        sums = [np.bincount(at.ravel(), (measurements * share).ravel(), shape[0] * shape[1]) for share in shares]
        return StatedConfidence(np.reshape(sums, (2, *shape)))

    def then(self, others: StatedConfidence, passed_s: float) -> StatedConfidence:
        """With these, which came so much later: a stream forgets, as light and clothes change."""
        return StatedConfidence(np.exp(-passed_s / MEMORY_S) * self.counts + others.counts)

    def log_odds(self, evidence: Evidence) -> Float[np.ndarray, "frame camera joint"]:
        """What the confidence of each detection says for visible against hidden; 0 where nothing was detected."""
        return np.where(evidence.detected, self._log_odds.ravel()[_at_level(evidence.confidence)], 0.0)

    @cached_property
    def _log_odds(self) -> Float[np.ndarray, "joint level"]:
        """Each joint is as all are until its own detections tell, and all say nothing until they do."""
        of_all = self.counts.sum(axis=1, keepdims=True)
        usual = of_all.sum(axis=0, keepdims=True) / max(float(of_all.sum()), np.finfo(float).tiny)
        of_all = _shares(of_all, usual, PRIOR_MEASUREMENTS)
        visible, hidden = _shares(self.counts, of_all, PRIOR_MEASUREMENTS_OF_CAMERA)
        ratio = np.divide(visible, hidden, out=np.ones_like(visible), where=(visible > 0) & (hidden > 0))
        return np.log(ratio)


def _shares(
    counts: Float[np.ndarray, "2 joint level"], usual: Float[np.ndarray, "#2 1 level"], prior_measurements: float
) -> Float[np.ndarray, "2 joint level"]:
    """Of each level, of which so many measurements are usual (the mean of a Dirichlet distribution)."""
    return (counts + prior_measurements * usual) / (counts.sum(axis=2, keepdims=True) + prior_measurements)


def _at_level(confidence: Float[np.ndarray, "*frames camera joint"]) -> Int[np.ndarray, "*frames camera joint"]:
    """Number of the joint and of the level, one after the other."""
    levels = np.searchsorted(_LEVELS, confidence, side="right")
    return np.asarray((len(_LEVELS) + 1) * np.arange(confidence.shape[-1]) + levels)
