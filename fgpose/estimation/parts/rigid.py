"""A face: one rigid set of points, placed by some of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.geometry.rigid import nearest_rotation
from fgpose_factors.robust_statistics import SIGMA_OF_MEDIAN

_ROUNDS = 5  # of aligning all frames with their median shape; the third moves it by less than 0.1 mm
# A point that is never triangulated has no place.
_LEAST_FRAMES = 3


@dataclass(frozen=True, eq=False)
class RigidSet:
    """Points that keep their distances, in a frame of their own.

    The lips and the eyelids move: how far points are from where the set has them is in their covariance.
    """

    carriers_m: Float[np.ndarray, "carrier 3"]
    """The points that place the set; their mean is the origin."""
    points_m: Float[np.ndarray, "point 3"]
    """All points; NaN: not known."""
    sigma_m: Float[np.ndarray, "point 3"]
    """How far they move from there, by axis."""

    @staticmethod
    def of(
        carriers_m: Float[np.ndarray, "frame carrier 3"],
        points_m: Float[np.ndarray, "frame point 3"],
        carried_by: Sequence[int],
    ) -> RigidSet | None:
        """From how the points lie around the carriers, on the median over time; None where hardly any has all.

        Args:
            carriers_m: as estimated; NaN: not known.
            points_m: as triangulated, each frame and point alone; NaN: not known. How those of carriers scatter is what
                detections do; what others scatter more than they is their own motion.
            carried_by: which of the points are the carriers.
        """
        whole = np.isfinite(carriers_m).all(axis=(1, 2))
        if not whole.any():
            return None
        shape_m = _centred(carriers_m[whole][0])
        for _ in range(_ROUNDS):
            rotations, centres_m = _aligned(shape_m, carriers_m[whole])
            own_m = np.einsum("tba,tkb->tka", rotations, carriers_m[whole] - centres_m[:, None])
            shape_m = _centred(np.median(own_m, axis=0))
        rotations, centres_m = _aligned(shape_m, carriers_m[whole])
        own_m = np.einsum("tba,tpb->tpa", rotations, points_m[whole] - centres_m[:, None])
        enough = np.isfinite(own_m).all(axis=-1).sum(axis=0) >= _LEAST_FRAMES
        if not enough[list(carried_by)].any():
            return None
        median_m, sigma_m = np.full((2, *own_m.shape[1:]), np.nan)
        median_m[enough] = np.nanmedian(own_m[:, enough], axis=0)
        sigma_m[enough] = SIGMA_OF_MEDIAN * np.nanmedian(np.abs(own_m[:, enough] - median_m[enough]), axis=0)
        of_detections_m = np.nanmedian(sigma_m[list(carried_by)], axis=0)
        return RigidSet(shape_m, median_m, np.sqrt(np.maximum(sigma_m**2 - of_detections_m**2, 0.0)))

    def placed(
        self,
        carriers_m: Float[np.ndarray, "frame carrier 3"],
        covariance_m2: Float[np.ndarray, "frame carrier 3 3"],
    ) -> tuple[Float[np.ndarray, "frame point 3"], Float[np.ndarray, "frame point 3 3"]]:
        """All points where the carriers put them, and their covariances; NaN where a carrier is not known.

        Of the variance of a carrier, half is of the translation of the set and half of its rotation, which grows with
        the squared distance: so it is of a rigid set whose points are equally well known.
        """
        n_frames, n_points = len(carriers_m), len(self.points_m)
        positions_m = np.full((n_frames, n_points, 3), np.nan)
        covariances_m2 = np.full((n_frames, n_points, 3, 3), np.nan)
        whole = np.isfinite(carriers_m).all(axis=(1, 2))
        if whole.any():
            rotations, centres_m = _aligned(self.carriers_m, carriers_m[whole])
            positions_m[whole] = centres_m[:, None] + np.einsum("tab,pb->tpa", rotations, self.points_m)
            radius_m2 = np.mean(np.sum(self.carriers_m**2, axis=-1))
            grown = (1.0 + np.sum(self.points_m**2, axis=-1) / radius_m2) / 2
            of_set_m2 = covariance_m2[whole].mean(axis=1)[:, None] * grown[:, None, None]
            of_points_m2 = np.einsum("tac,pc,tbc->tpab", rotations, self.sigma_m**2, rotations)
            covariances_m2[whole] = of_set_m2 + of_points_m2
        return positions_m, covariances_m2


def placed(
    rigid: RigidSet | None,
    carriers_m: Float[np.ndarray, "frame carrier 3"],
    covariance_m2: Float[np.ndarray, "frame carrier 3 3"] | None,
    n_points: int,
) -> tuple[Float[np.ndarray, "frame point 3"], Float[np.ndarray, "frame point 3 3"] | None]:
    """As RigidSet.placed; NaN of a set that is not known, and without covariances if the carriers have none."""
    if rigid is None:
        nowhere_m = np.full((len(carriers_m), n_points, 3), np.nan)
        return nowhere_m, None if covariance_m2 is None else np.full((*nowhere_m.shape, 3), np.nan)
    stated_m2 = np.zeros((*carriers_m.shape, 3)) if covariance_m2 is None else covariance_m2
    positions_m, all_m2 = rigid.placed(carriers_m, stated_m2)
    return positions_m, None if covariance_m2 is None else all_m2


def of_whole(visibility: Float[np.ndarray, "*views carrier"]) -> Float[np.ndarray, "*views 1"]:
    """Of a set, which a view shows as a whole or not at all: the mean of the carriers that it detects; 0: none."""
    detected = np.isfinite(visibility)
    sums = np.where(detected, visibility, 0.0).sum(axis=-1, keepdims=True)
    return sums / np.maximum(detected.sum(axis=-1, keepdims=True), 1)


def _centred(points_m: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point 3"]:
    return points_m - points_m.mean(axis=0)


def _aligned(
    shape_m: Float[np.ndarray, "point 3"], points_m: Float[np.ndarray, "frame point 3"]
) -> tuple[Float[np.ndarray, "frame 3 3"], Float[np.ndarray, "frame 3"]]:
    """Rotation of a centred shape that fits the points best, and their mean."""
    centres_m = points_m.mean(axis=1)
    rotations, _ = nearest_rotation((points_m - centres_m[:, None]).swapaxes(1, 2) @ shape_m)
    return rotations, centres_m
