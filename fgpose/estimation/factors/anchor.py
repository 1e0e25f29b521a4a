"""Anchors: a joint that cannot be triangulated stays near the fused per-view 3D.

With fewer than two rays, motion and bone factors alone would let the body shrink towards the camera: the smaller it
is, the smaller are all velocities and differences of length.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import gtsam
import numpy as np

from fgpose.estimation.factors.point_prior import PointPriors
from fgpose.estimation.keys import Keys
from fgpose.estimation.segment import Segment
from fgpose_factors import noise_model


@dataclass(frozen=True, eq=False)
class Anchors(PointPriors):
    """The residual is the distance from the fused point."""

    sigma_m: float

    @classmethod
    def of(cls, segment: Segment) -> Iterator[Anchors]:
        anchored = (segment.active & segment.evidence.anchored)[:, segment.joints]
        if anchored.any():
            positions_m = np.where(anchored[..., None], segment.evidence.guess_m[:, segment.joints], 0.0)
            sigma_m = segment.config.fusion.anchor_sigma_m
            information = anchored[..., None, None] * np.eye(3) / sigma_m**2
            # The depth of one view can be far off.
            depth = segment.config.depth
            yield cls(positions_m, information, depth.kernel, depth.kernel_scale, sigma_m)

    def graph_factors(self, keys: Keys) -> Iterator[gtsam.NonlinearFactor]:
        noise = noise_model(3, self.sigma_m, self.kernel, self.kernel_scale)
        for frame, slot in np.argwhere(self.information[..., 0, 0]).tolist():
            yield gtsam.PriorFactorPoint3(keys.position(frame, slot), self.positions_m[frame, slot], noise)
