"""The other point on the ray of a camera that has the right distance from the joint that holds a joint.

It is as far behind that joint as the estimate is before it, or vice versa. Of a joint that one camera alone sees, the
motion since two saw it tells which one is right, unless the bone was across the ray in between: from there on it may
have gone either way.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.estimation.covariances.uncertainty import holders
from fgpose.estimation.evidence.evidence import Evidence
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton


def rays_to(
    positions_m: Float[np.ndarray, "frame joint 3"], rig: CameraRig
) -> Float[np.ndarray, "frame camera joint 3"]:
    """Unit vectors from each camera to the joints; 0 where they are not known."""
    rays = positions_m[:, None] - rig.positions_m[:, None]
    return np.nan_to_num(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


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
