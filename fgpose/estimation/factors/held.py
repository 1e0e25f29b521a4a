"""Held joints: a part of the body hangs where an estimate of the rest of it says."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import gtsam
import numpy as np

from fgpose.estimation.factors.point_prior import PointPriors
from fgpose.estimation.keys import Keys
from fgpose.estimation.segment import Segment


@dataclass(frozen=True, eq=False)
class Held(PointPriors):
    """The residual is the distance from the estimate, without a robust kernel: it is no measurement that may be
    another's."""

    @classmethod
    def of(cls, segment: Segment) -> Iterator[Held]:
        if not segment.evidence.held_information.any():
            return
        information = segment.evidence.held_information[:, segment.joints]
        held = segment.active[:, segment.joints] & information.any(axis=(-1, -2))
        if held.any():
            positions_m = np.where(held[..., None], segment.evidence.held_m[:, segment.joints], 0.0)
            yield cls(positions_m, np.where(held[..., None, None], information, 0.0), "none", 1.0)

    def graph_factors(self, keys: Keys) -> Iterator[gtsam.NonlinearFactor]:
        for frame, slot in np.argwhere(self.information.any(axis=(-1, -2))).tolist():
            noise = gtsam.noiseModel.Gaussian.Information(self.information[frame, slot])
            yield gtsam.PriorFactorPoint3(keys.position(frame, slot), self.positions_m[frame, slot], noise)
