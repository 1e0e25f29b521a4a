"""The Markov chain of one joint in one camera: visible or hidden."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from fgpose.parameters import VisibilityConfig

# So much time of one joint in one camera outweighs what is usual.
_PRIOR_S = 30.0
# With three occluded cameras after an hour of none, errors on a tuning clip are 22.1 mm, as with 10 s; 23.0 for ever.
_MEMORY_S = 60.0
_LONGEST_STEP_S = 0.25  # over a longer one a joint may have come and gone
_MOST_LOG_ODDS = 30.0  # keeps the exponential finite


class Stays(NamedTuple):
    """For how long joints were visible and hidden, and how often they became so, summed over joints and cameras."""

    visible_s: float = 0.0
    hidden_s: float = 0.0
    to_hidden: float = 0.0
    to_visible: float = 0.0

    @staticmethod
    def of(
        probability: Float[np.ndarray, "frame camera joint"],
        step_s: Float[np.ndarray, " frame"],
        detected: Bool[np.ndarray, "frame camera joint"],
    ) -> Stays:
        """Expected from the probabilities of visible; a change of the probability is so much of a transition.

        Args:
            probability: given the detections of all frames.
            step_s: time since the frame before.
            detected: where there is a detection; only two that follow each other soon tell anything.
        """
        before, change = probability[:-1], np.diff(probability, axis=0)
        step_s = step_s[1:, None, None]
        known = detected[1:] & detected[:-1] & (step_s < _LONGEST_STEP_S)

        def total(values: np.ndarray) -> float:
            return float(np.sum(values, where=known))

        lost, found = np.maximum(-change, 0.0), np.maximum(change, 0.0)
        return Stays(total(step_s * before), total(step_s * (1 - before)), total(lost), total(found))

    @staticmethod
    def usual(config: VisibilityConfig) -> Stays:
        """What counts as seen before anything is."""
        turns = _PRIOR_S / (config.visible_s + config.hidden_s)
        return Stays(turns * config.visible_s, turns * config.hidden_s, turns, turns)

    def plus(self, others: Stays) -> Stays:
        return Stays(*(own + other for own, other in zip(self, others, strict=True)))

    def then(self, others: Stays, passed_s: float) -> Stays:
        """With these, which came so much later: a stream forgets, for a camera may see well for an hour and then no
        more."""
        keep = float(np.exp(-passed_s / _MEMORY_S))
        return Stays(*(keep * own for own in self)).plus(others)


class Chain:
    """The Markov chain of one joint in one camera: it stays visible or hidden for exponentially distributed times."""

    def __init__(self, config: VisibilityConfig, stays: Stays | None = None) -> None:
        stays = (stays or Stays()).plus(Stays.usual(config))
        visible_s, hidden_s = stays.visible_s / stays.to_hidden, stays.hidden_s / stays.to_visible
        self._rate = 1 / visible_s + 1 / hidden_s
        self.usual = visible_s / (visible_s + hidden_s)
        """Probability of visible before anything is known."""

    def predicted(self, probability: np.ndarray, step_s: float | np.ndarray) -> np.ndarray:
        """Of visible, this time later."""
        return self.usual + (probability - self.usual) * np.exp(-self._rate * step_s)

    def updated(self, probability: float | np.ndarray, log_odds: np.ndarray) -> np.ndarray:
        """Of visible, given these odds too (Bayes)."""
        likelihood = _odds(log_odds)
        return probability * likelihood / (probability * likelihood + 1 - probability)

    def filtered(
        self,
        log_odds: Float[np.ndarray, "frame camera joint"],
        step_s: Float[np.ndarray, " frame"],
        before: Float[np.ndarray, "camera joint"] | None = None,
    ) -> Float[np.ndarray, "frame camera joint"]:
        """Probability of visible, given the odds of each frame and of those before it.

        Args:
            log_odds: what each frame alone says.
            step_s: time since the frame before.
            before: the same of the frame before the first.
        """
        filtered = np.empty_like(log_odds)
        probability = np.full(log_odds.shape[1:], self.usual) if before is None else before
        for t, (odds, step) in enumerate(zip(log_odds, step_s.tolist(), strict=True)):
            filtered[t] = probability = self.updated(self.predicted(probability, step), odds)
        return filtered

    def smoothed(
        self,
        filtered: Float[np.ndarray, "frame camera joint"],
        log_odds: Float[np.ndarray, "frame camera joint"],
        step_s: Float[np.ndarray, " frame"],
    ) -> Float[np.ndarray, "frame camera joint"]:
        """Probability of visible, given the odds of all frames."""
        smoothed = np.empty_like(filtered)
        # What later frames say for visible against hidden, as the odds of a detection.
        later = np.zeros(log_odds.shape[1:])
        for t in reversed(range(len(log_odds))):
            smoothed[t] = self.updated(filtered[t], later)
            likelihood = _odds(log_odds[t] + later)
            from_visible, from_hidden = self.predicted(np.array([1.0, 0.0]), step_s[t])
            later = np.log(from_visible * likelihood + 1 - from_visible)
            later -= np.log(from_hidden * likelihood + 1 - from_hidden)
        return smoothed


def _odds(log_odds: np.ndarray) -> np.ndarray:
    return np.exp(np.clip(log_odds, -_MOST_LOG_ODDS, _MOST_LOG_ODDS))
