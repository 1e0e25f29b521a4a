"""The other point on the ray of a camera that has the right distance from the joint that holds a joint.

It is as far behind that joint as the estimate is before it, or vice versa. Of a joint that one camera alone sees, the
motion since two saw it tells which one is right, unless the bone was across the ray in between: from there on it may
have gone either way. Of joints of a rigid part, as a head, the distances to its other joints tell it too.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.estimation.covariances.uncertainty import holders
from fgpose.estimation.evidence.evidence import Evidence
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.vectors import norm
from fgpose.sampling import parts_of
from fgpose.skeleton import Skeleton

# Joints of a head are as far from each other at all times as they are located, 10 to 20 mm; those that others join to
# them move by more. A second of a camera; and how far a distance is known at best, with errors that last.
_STEADY_M, _ENOUGH_FRAMES, _LEAST_M = 0.025, 30, 0.015
_FRAMES_AT_ONCE = 100  # of 133 joints they take 40 MB


def rays_to(
    positions_m: Float[np.ndarray, "frame joint 3"], rig: CameraRig
) -> Float[np.ndarray, "frame camera joint 3"]:
    """Unit vectors from each camera to the joints; 0 where they are not known."""
    rays = positions_m[:, None] - rig.positions_m[:, None]
    rays /= norm(rays)[..., None]
    return np.where(np.isnan(rays), 0.0, rays)  # np.nan_to_num takes four times as long


def other_side_m2(
    share: Float[np.ndarray, "frame joint"],
    ray: Float[np.ndarray, "frame joint 3"],
    positions_m: Float[np.ndarray, "frame joint 3"],
    skeleton: Skeleton,
) -> Float[np.ndarray, "frame joint 3 3"]:
    """Second moment of where joints may be at the other point, and of what they hold with them.

    Args:
        share: probability that they are; 0: what holds them does not matter either.
        ray: from the camera that tells of them, unit vectors.
        positions_m: of the joints.
        skeleton: for the bones.
    """
    moment_m2 = np.zeros((*positions_m.shape, 3))
    for joint, holder in holders(skeleton):
        if share[:, joint].any():
            off_m = 2 * _deep_m(joint, holder, ray, positions_m)[:, None] * ray[:, joint]
            own_m2 = share[:, joint, None, None] * np.nan_to_num(off_m[:, :, None] * off_m[:, None])
            moment_m2[:, joint] = np.where(share[:, joint, None, None] > 0, own_m2 + moment_m2[:, holder], 0.0)
    return moment_m2


class SteadyDistances:
    """How far joints are from each other, where that is the same at all times: within a head, and within a trunk."""

    def __init__(self, n_joints: int) -> None:
        self._count, self._sum_m, self._sum_m2 = np.zeros((3, n_joints, n_joints))

    def learn(self, positions_m: Float[np.ndarray, "frame joint 3"], sure: Bool[np.ndarray, "frame joint"]) -> None:
        """From the joints of some frames whose places are sure."""
        for part in parts_of(len(positions_m), _FRAMES_AT_ONCE):
            known = sure[part] & np.isfinite(positions_m[part]).all(axis=-1)
            both, at_m = known[:, :, None] & known[:, None], np.where(known[..., None], positions_m[part], 0.0)
            distance_m = np.where(both, norm(at_m[:, :, None] - at_m[:, None]), 0.0)
            self._count += both.sum(axis=0)
            self._sum_m += distance_m.sum(axis=0)
            self._sum_m2 += (distance_m**2).sum(axis=0)

    def log_odds(
        self,
        joint: int,
        there_m: Float[np.ndarray, "frame 3"],
        positions_m: Float[np.ndarray, "frame joint 3"],
        sure: Bool[np.ndarray, "frame joint"],
    ) -> Float[np.ndarray, " frame"]:
        """Of another place of a joint against its estimate, by the distance to a sure joint that tells them apart best
        (Student's distribution); 0 where none is known.

        Args:
            joint: its index.
            there_m: the other place.
            positions_m: the pose.
            sure: the joints that are where they are estimated.
        """
        count = np.maximum(self._count[joint], 1)
        mean_m = self._sum_m[joint] / count
        sigma_m = np.sqrt(np.maximum(self._sum_m2[joint] / count - mean_m**2, _LEAST_M**2))
        steady = (self._count[joint] >= _ENOUGH_FRAMES) & (sigma_m < _STEADY_M)
        steady[joint] = False
        off = np.stack([norm(at_m[:, None] - positions_m) for at_m in (positions_m[:, joint], there_m)])
        off = np.where(steady & sure & np.isfinite(off).all(axis=0), (off - mean_m) / sigma_m, 0.0)
        best = np.argmax(np.abs(off[1] - off[0]), axis=-1)
        here, there = np.take_along_axis(off, best[None, :, None], axis=-1)[..., 0]
        return 2 * (np.log1p(here**2 / 2) - np.log1p(there**2 / 2))


def other_points_m(
    joint: int, holder: int, ray: Float[np.ndarray, "frame joint 3"], positions_m: Float[np.ndarray, "frame joint 3"]
) -> Float[np.ndarray, "frame 3"]:
    """As far before the one that holds a joint as that is behind it, or vice versa."""
    return positions_m[:, joint] - 2 * _deep_m(joint, holder, ray, positions_m)[:, None] * ray[:, joint]


def sole_rays(
    evidence: Evidence, positions_m: Float[np.ndarray, "frame joint 3"], rig: CameraRig
) -> Float[np.ndarray, "frame joint 3"]:
    """Rays to the joints that one camera alone sees; 0 for the others. Its own 3D errs by as much as joints are before
    or behind each other."""
    if not evidence.sole_view.any():
        return np.zeros(positions_m.shape)
    return np.sum(np.where(evidence.sole_view[..., None], rays_to(positions_m, rig), 0.0), axis=1)


def other_sides_m2(
    evidence: Evidence,
    positions_m: Float[np.ndarray, "frame joint 3"],
    covariance_m2: Float[np.ndarray, "frame joint 3 3"],
    rig: CameraRig,
    skeleton: Skeleton,
) -> Float[np.ndarray, "frame joint 3 3"]:
    """other_side_m2 of all joints of a recording that one camera alone sees.

    Args:
        evidence, positions_m, covariance_m2: of its frames.
        rig, skeleton: of the evidence.
    """
    ray = sole_rays(evidence, positions_m, rig)
    if not ray.any():
        return np.zeros_like(covariance_m2)
    share = share_of_other_side(off_across(ray, positions_m, covariance_m2, skeleton), evidence.observed)
    return other_side_m2(share * ray.any(axis=-1), ray, positions_m, skeleton)


def off_across(
    ray: Float[np.ndarray, "frame joint 3"],
    positions_m: Float[np.ndarray, "frame joint 3"],
    covariance_m2: Float[np.ndarray, "frame joint 3 3"],
    skeleton: Skeleton,
) -> Float[np.ndarray, "frame joint"]:
    """By how many standard deviations each bone seems too short in the image to be across the ray of its end; inf
    without a ray.

    A bone of length L whose end is d deep seems to be d^2 / (2 L) shorter, which its ends tell across the ray.
    """
    off = np.full(positions_m.shape[:2], np.inf)
    along_m2 = np.einsum("tji,tjik,tjk->tj", ray, covariance_m2, ray)
    across_m2 = (np.trace(covariance_m2, axis1=-2, axis2=-1) - along_m2) / 2
    length_m = skeleton.bone_lengths(positions_m)
    for bone, (holder, joint) in enumerate(skeleton.bones):
        shorter_m = _deep_m(joint, holder, ray, positions_m) ** 2 / np.maximum(2 * length_m[:, bone], 1e-9)
        off[:, joint] = shorter_m / np.sqrt(across_m2[:, joint] + across_m2[:, holder])
    return np.where(np.isfinite(off) & ray.any(axis=-1), off, np.inf)


def share_of_other_side(
    off: Float[np.ndarray, "frame joint"], observed: Bool[np.ndarray, "frame joint"]
) -> Float[np.ndarray, "frame joint"]:
    """Probability that each joint of a recording is at the other point: it was across the ray since two cameras saw it
    last, and will be before two see it next.

    Args:
        off: off_across of all frames.
        observed: by two cameras.
    """

    def least(off: np.ndarray, observed: np.ndarray) -> np.ndarray:
        found = np.where(observed, np.inf, off)
        for frame in range(1, len(found)):
            found[frame] = np.where(observed[frame], np.inf, np.minimum(found[frame], found[frame - 1]))
        return found

    return may_have_crossed(np.maximum(least(off, observed), least(off[::-1], observed[::-1])[::-1]))


def may_have_crossed(least_off: Float[np.ndarray, "*joints"]) -> Float[np.ndarray, "*joints"]:
    """Probability that a joint was on the other side at the moment when it was nearest to being across the ray."""
    from scipy.special import ndtr

    return ndtr(-least_off)


def _deep_m(
    joint: int, holder: int, ray: Float[np.ndarray, "frame joint 3"], positions_m: Float[np.ndarray, "frame joint 3"]
) -> Float[np.ndarray, " frame"]:
    """How far a joint is behind the one that holds it."""
    return np.sum((positions_m[:, joint] - positions_m[:, holder]) * ray[:, joint], axis=-1)
