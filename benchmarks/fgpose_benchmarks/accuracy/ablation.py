"""The batch estimator with one part removed or replaced at a time, which shows the effect of each."""

from __future__ import annotations

from fgpose.config import Config, Sections
from fgpose_benchmarks.accuracy.methods import batch
from fgpose_benchmarks.comparison.recording import Method

# The best on the tuning clips, of 0.25 to 16 m^2/s^3.
_BEST_DENSITY = 1.0

_CHANGES: dict[str, Sections] = {
    "as it is": {},
    "no visibility": {"visibility": {"model": "none"}},
    "no bias": {"visibility": {"bias": "none"}},
    "no robust kernel": {"projection": {"kernel": "none"}},
    "weights: confidence alone": {"projection": {"weighting": "confidence"}},
    "weights: uniform": {"projection": {"weighting": "uniform"}},
    "no per-view depth": {"depth": {"use": "never"}},
    "per-view depth always": {"depth": {"use": "always"}},
    "no bone lengths": {"symmetry": {"form": "none"}},
    "symmetry within each frame": {"symmetry": {"form": "frame"}},
    "one process noise for all": {"motion": {"adaptive": False, "acceleration_density": _BEST_DENSITY}},
    "random walk": {"motion": {"model": "random_walk"}},
    "no motion model": {"motion": {"model": "none"}},
}


def ablations() -> list[Method]:
    """The estimator without a change, then with each change alone."""
    positions_only = Config(solver={"covariance": False})
    return [batch(name, positions_only.replace(**changes)) for name, changes in _CHANGES.items()]
