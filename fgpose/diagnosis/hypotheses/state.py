"""What cameras make of a scene: how well they agree, and on what body."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fgpose.diagnosis.hypotheses.consistency import STEADY, Consistency, consistency, unsteadiness
from fgpose.diagnosis.hypotheses.scene import SynchronousViews

# Half of the rays of each camera pass the joint by this: real recordings have 6 to 32 mm (embedded ones, with
# calibrations that are off by up to 60 mm), 53 mm where occluders hide a third of the joints.
NORMAL_M = 0.06
_STEADY_OF_MORE = 0.4  # unsteadiness of what three cameras and more see
# What occluders or a bumped camera do is looked at more closely.
_CLEAN_SHARE, _CLEAN_M = 0.85, 0.045


@dataclass(frozen=True, eq=False)
class SearchState:
    """A scene with what its cameras make of it."""

    scene: SynchronousViews

    @cached_property
    def consistency(self) -> Consistency:
        return consistency(self.scene)

    @cached_property
    def unsteadiness(self) -> float:
        return unsteadiness(self.consistency.positions_m, self.scene.limbs)

    @cached_property
    def cost(self) -> float:
        """Of the rays, on a body that is as large as the given one, and of the limbs: two cameras agree on much that is
        no body."""
        unsteady = min(self.unsteadiness, 1.0) if np.isfinite(self.unsteadiness) else float(self.scene.shows_limbs)
        rays = self.consistency.cost_if_larger(self.scene.shrunk)
        return (rays if np.isfinite(rays) else 1.0) + 0.5 * max(unsteady - STEADY / 2, 0.0)

    @cached_property
    def medians_m(self) -> np.ndarray:
        """Of the distances of each camera; NaN where nothing can be judged."""
        own = [np.sort(each[mask]) for each, mask in _of_cameras(self.consistency)]
        return np.array([each[len(each) // 2] if len(each) else np.nan for each in own])

    @property
    def is_normal(self) -> bool:
        """Whether it is as in recordings in which nothing is wrong."""
        medians_m = self.medians_m[~np.isnan(self.medians_m)]
        steady = not self.unsteadiness > (STEADY if self.scene.n_cameras == 2 else _STEADY_OF_MORE)
        return bool(medians_m.size) and bool((medians_m < NORMAL_M).all()) and steady

    @property
    def is_clean(self) -> bool:
        """Whether no cause need be looked for: nothing is hidden, and nothing wrong."""
        clean = (self.consistency.shares > _CLEAN_SHARE) | ~self.consistency.judged.any(axis=(0, 1))
        small = (self.medians_m < _CLEAN_M) | np.isnan(self.medians_m)
        steady = self.scene.n_cameras > 2 or not self.unsteadiness > STEADY
        return bool(self.consistency.judged.any() and clean.all() and small.all()) and steady


def _of_cameras(found: Consistency) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    for c in range(found.distance_m.shape[-1]):
        yield found.distance_m[..., c], found.judged[..., c]
