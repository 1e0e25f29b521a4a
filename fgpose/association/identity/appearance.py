"""Recognising people by vectors that say how they look, as networks for re-identification make them.

How alike the vectors of the same person are, and those of different people, depends on the network, the light and the
clothes. So it is learned, from those who are followed: the same person at different times, and people who are there at
the same time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from jaxtyping import Float

# The crops of a second show nearly the same: they are one sample.
_PERIOD_S = 1.0
# Clothes may be alike, and light changes while somebody is away: no resemblance tells more than this.
_MOST = np.log(100.0)
# Similarities from about so many seconds of people count: what was learned on another day fades.
_REMEMBERED = 1000
_LEAST_SCALE = 1e-3  # vectors that are the same in every image


@dataclass(eq=False)
class Samples:
    """Similarities, and from how many people or pairs they are."""

    n: int = 0
    n_sources: int = 0
    mean: float = 0.0
    variance: float = 0.0

    def add(self, value: float, *, is_new_source: bool) -> None:
        self.n, self.n_sources = min(self.n + 1, _REMEMBERED), self.n_sources + is_new_source
        change = value - self.mean
        self.mean += change / self.n
        self.variance += (change * (value - self.mean) - self.variance) / self.n

    def log_density(self, value: float) -> float:
        """Predicted, of the next value: Student's t distribution (Gelman et al., Bayesian Data Analysis, section 3.2)
        with as many degrees of freedom as there are sources, whose values are alike. -inf: too little is known."""
        from scipy.stats import t

        if self.n < 2:
            return -np.inf
        scale = np.sqrt(self.variance * self.n / (self.n - 1) * (1 + 1 / self.n_sources))
        return float(t.logpdf(value, self.n_sources, self.mean, max(scale, _LEAST_SCALE)))


@dataclass(eq=False)
class Resemblance:
    """How alike people are to themselves and to others."""

    same: Samples = field(default_factory=Samples)
    different: Samples = field(default_factory=Samples)
    period_began_s: float = -np.inf

    def log_ratio(self, similarity: float) -> float:
        """Log of the ratio of probabilities that two are the same person, against that they are two."""
        same, different = self.same.log_density(similarity), self.different.log_density(similarity)
        return float(np.clip(same - different, -_MOST, _MOST)) if np.isfinite(same + different) else 0.0

    def learn(self, present: Sequence[MeanAppearance], now_s: float) -> None:
        """From those who are there, once in a period."""
        if now_s < self.period_began_s + _PERIOD_S:
            return
        self.period_began_s = now_s
        seen = [(own, own.recent) for own in present if own.recent is not None]
        for own, recent in seen:
            if own.total is not None:
                self.same.add(_cosine(recent, own.total), is_new_source=own.n_periods == 1)
        for (one, recent), (other, others) in combinations(seen, 2):
            self.different.add(_cosine(recent, others), is_new_source=0 in (one.n_periods, other.n_periods))
        for own, _ in seen:
            own.total, own.recent = own.all, None
            own.n_periods += 1


@dataclass(eq=False)
class MeanAppearance:
    """How somebody looks: the sum of their vectors, each of length 1."""

    resemblance: Resemblance = field(default_factory=Resemblance)
    """Of all who are followed."""
    n_periods: int = 0
    total: np.ndarray | None = None
    """Of all periods that have ended."""
    recent: np.ndarray | None = None
    """Of the period that has not."""

    def add(self, vector: Float[np.ndarray, " dimension"]) -> None:
        """A vector of any length; NaN or 0: unknown."""
        length = float(np.linalg.norm(vector))
        if np.isfinite(length) and length > 0:
            self.recent = vector / length + (0.0 if self.recent is None else self.recent)

    def join(self, before: MeanAppearance) -> None:
        """How the same person looked before."""
        self.n_periods += before.n_periods
        if before.all is not None:
            self.total = before.all + (0.0 if self.total is None else self.total)

    @property
    def all(self) -> np.ndarray | None:
        if self.total is None or self.recent is None:
            return self.recent if self.total is None else self.total
        return self.total + self.recent

    def log_ratio(self, other: MeanAppearance) -> float:
        """Log of the ratio of probabilities that two are the same person, against that they are two of many."""
        if self.all is None or other.all is None:
            return 0.0
        return self.resemblance.log_ratio(_cosine(self.all, other.all))


def _cosine(a: np.ndarray, b: np.ndarray) -> float:
    return float(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)))
