"""How the bones of a person usually point, learned from the frames in which several cameras determine them.

One camera shows how long a bone looks. How far away the bone is follows from its length, if it is known how much it
points towards the camera. A person turns around an axis, upright for most, so directions are taken as equally likely
around it: somebody who faced the camera may be seen from the side later. The axis is the one along which the bones are
longest.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float

from fgpose.geometry.vectors import norm
from fgpose.skeleton import Skeleton

# Directions are independent after about this time: half a stride.
_INDEPENDENT_S = 0.5
# The last direction that was seen counts as so many independent ones, with this variation. Measured on motion capture
# (CMU walking, dancing, balancing), bones of trunk and thigh vary by 0.1 to 0.25, all by less than 0.45.
_PRIOR_DIRECTIONS, _PRIOR_SIGMA = 2.0, 0.2
_LEAST_SIGMA = 0.05


@dataclass(frozen=True, eq=False)
class Posture:
    """Sums over time of the directions of each bone, from its start to its end."""

    duration_s: Float[np.ndarray, " bone"]
    """For how long each bone was seen."""
    first: Float[np.ndarray, "bone 3"]
    """Integral of the direction, s."""
    second: Float[np.ndarray, "bone 3 3"]
    """Integral of its outer product, s."""
    along_m: Float[np.ndarray, "3 3"]
    """The same of all bones together, times their lengths, m s."""

    @staticmethod
    def none(skeleton: Skeleton) -> Posture:
        n = len(skeleton.bones)
        return Posture(np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((3, 3)))

    @staticmethod
    def of(positions_m: Float[np.ndarray, "frame joint 3"], step_s: float, skeleton: Skeleton) -> Posture:
        """Of some frames.

        Args:
            positions_m: NaN where several cameras do not determine a joint.
            step_s: time that a frame stands for.
            skeleton: for the bones.
        """
        direction, length_m = bone_directions(positions_m, skeleton)
        known = np.isfinite(length_m)
        direction, length_m = np.where(known[..., None], direction, 0.0), np.where(known, length_m, 0.0)
        outer = step_s * direction[..., :, None] * direction[..., None, :]
        along_m = np.einsum("tb,tbij->ij", length_m, outer)
        return Posture(step_s * known.sum(axis=0), step_s * direction.sum(axis=0), outer.sum(axis=0), along_m)

    def plus(self, others: Posture) -> Posture:
        sums = {each.name: getattr(self, each.name) + getattr(others, each.name) for each in fields(self)}
        return Posture(**sums)

    def towards(
        self, ray: Float[np.ndarray, " 3"], last: Float[np.ndarray, "bone 3"]
    ) -> tuple[Float[np.ndarray, " bone"], Float[np.ndarray, " bone"]]:
        """Mean and variance of the component of each direction along a ray, when enough time has passed.

        Args:
            ray: unit vector.
            last: the directions when they were seen last; NaN if they never were.
        """
        seen = self.duration_s > 0
        total_s = np.where(seen, self.duration_s, 1.0)
        axis = np.linalg.eigh(self.along_m)[1][:, -1]
        on_axis, of_axis = float(ray @ axis), self.first @ axis / total_s
        square_of_axis = np.einsum("i,bij,j->b", axis, self.second, axis) / total_s
        mean = on_axis * of_axis
        square = on_axis**2 * square_of_axis + (1 - on_axis**2) * (1 - square_of_axis) / 2
        own = np.maximum(square - mean**2, 0.0) + _LEAST_SIGMA**2
        last_known = np.isfinite(last).all(axis=-1)
        last_mean = np.where(last_known, np.nan_to_num(last) @ ray, 0.0)
        # A component of a unit vector of which nothing is known has a variance of 1/3.
        last_variance = np.where(last_known, _PRIOR_SIGMA**2, 1 / 3)
        n, prior = np.where(seen, self.duration_s / _INDEPENDENT_S, 0.0), _PRIOR_DIRECTIONS
        mixed = (n * mean + prior * last_mean) / (n + prior)
        apart = n * prior / (n + prior) ** 2 * (mean - last_mean) ** 2
        return mixed, (n * own + prior * last_variance) / (n + prior) + apart


def bone_directions(
    positions_m: Float[np.ndarray, "*frames joint 3"], skeleton: Skeleton
) -> tuple[Float[np.ndarray, "*frames bone 3"], Float[np.ndarray, "*frames bone"]]:
    """Unit vectors from the start of each bone to its end, and its length; NaN where it has none."""
    start, end = skeleton.bone_ends
    bone_m = positions_m[..., end, :] - positions_m[..., start, :]
    length_m = norm(bone_m)
    length_m = np.where(length_m > 0, length_m, np.nan)
    return bone_m / length_m[..., None], length_m
