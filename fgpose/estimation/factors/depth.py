"""Depth: a view's own 3D is right along its ray."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import gtsam
import numpy as np
from jaxtyping import Float

from fgpose.config import DepthConfig
from fgpose.estimation.factors.point_prior import PointPriors
from fgpose.estimation.keys import Keys
from fgpose.estimation.noise import correlated_frames
from fgpose.estimation.segment import Segment
from fgpose_factors import depth_factor, depth_information


@dataclass(frozen=True, eq=False)
class Depths(PointPriors):
    """Of one view: the residual is the difference from the view's own 3D joint; only its part along the ray counts."""

    rays: Float[np.ndarray, "frame slot 3"]
    sigma_m: Float[np.ndarray, "frame slot"]
    """Along the ray; NaN where it is not used."""

    @classmethod
    def of(cls, segment: Segment) -> Iterator[Depths]:
        """One table per view that has a depth."""
        evidence, joints, config = segment.evidence, segment.joints, segment.config.depth
        if not np.isfinite(evidence.depth_sigma_m).any():
            return
        spread = depth_spread(segment.step_s, config)
        for view in range(evidence.views_m.shape[1]):
            sigma_m = spread[:, None] * evidence.depth_sigma_m[:, view, joints]
            sigma_m[~segment.active[:, joints]] = np.nan
            used, rays = np.isfinite(sigma_m), evidence.rays[:, view, joints]
            if used.any():
                information = np.zeros((*used.shape, 3, 3))
                information[used] = depth_information(rays[used], sigma_m[used])
                positions_m = np.where(used[..., None], evidence.views_m[:, view, joints], 0.0)
                yield cls(positions_m, information, config.kernel, config.kernel_scale, rays, sigma_m)

    def graph_factors(self, keys: Keys) -> Iterator[gtsam.NonlinearFactor]:
        for frame, slot in np.argwhere(np.isfinite(self.sigma_m)).tolist():
            measured_m, ray = self.positions_m[frame, slot], self.rays[frame, slot]
            sigma_m = float(self.sigma_m[frame, slot])
            yield depth_factor(keys.position(frame, slot), measured_m, ray, sigma_m, self.kernel, self.kernel_scale)


def depth_spread(step_s: Float[np.ndarray, " frame"], config: DepthConfig) -> Float[np.ndarray, " frame"]:
    """Factor on the standard deviation of a depth whose error is correlated in time: correlated frames count as one.

    Args:
        step_s: time since the frame before; inf for the first frame.
        config: has the time over which errors are correlated.
    """
    return np.sqrt(correlated_frames(step_s, config.correlation_s))
