"""Where somebody is a moment later."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.estimation.evidence.plausibility import known_medians
from fgpose.estimation.evidence.presence import MIN_JOINTS

_SMOOTHED_S, _LONGEST_S = 0.15, 0.5  # more than steps sway; and nobody goes on in a line for longer


@dataclass(frozen=True, eq=False)
class MovingBody:
    """Somebody who goes on as the whole body went."""

    positions_m: Float[np.ndarray, "joint 3"]
    """World frame; NaN: not known."""
    time_s: float
    """When they were there."""
    velocity_mps: Float[np.ndarray, " 3"]
    """World frame."""

    @staticmethod
    def nowhere(n_joints: int) -> MovingBody:
        """Before anybody was seen."""
        return MovingBody(np.full((n_joints, 3), np.nan), -np.inf, np.zeros(3))

    def at(self, time_s: float) -> Float[np.ndarray, "joint 3"]:
        """Where the joints are; NaN where that is not known."""
        passed_s = time_s - self.time_s
        return self.positions_m + (self.velocity_mps * passed_s if passed_s <= _LONGEST_S else np.nan)

    def seen(self, positions_m: Float[np.ndarray, "joint 3"], time_s: float) -> MovingBody:
        """After they were seen there; as it was where too few joints are known, or later ones are."""
        passed_s = time_s - self.time_s
        if passed_s <= 0 or np.count_nonzero(np.isfinite(positions_m[:, 0])) < MIN_JOINTS:
            return self
        moved_m, velocity_mps = known_medians((positions_m - self.positions_m)[None])[0], np.zeros(3)
        if passed_s <= _LONGEST_S and np.isfinite(moved_m).all():
            share = -np.expm1(-passed_s / _SMOOTHED_S)
            velocity_mps = self.velocity_mps + share * (moved_m / passed_s - self.velocity_mps)
        return MovingBody(positions_m, time_s, velocity_mps)
