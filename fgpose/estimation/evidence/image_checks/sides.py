"""Joints whose left and right a network exchanges together: of the whole body, of the arms or of the legs alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.skeleton import Skeleton
from fgpose_factors.robust_statistics import medians

Limbs = tuple[Float[np.ndarray, "frame camera pair side 2"], Float[np.ndarray, "frame camera pair side"]]


@dataclass(frozen=True, eq=False)
class Sides:
    """What is exchanged at once."""

    pairs: Int[np.ndarray, " pair"]
    """Of limb_joints, those by which it is seen."""
    joints: Bool[np.ndarray, " joint"]
    """Those that are exchanged: of limbs also what hangs on them, as hands on arms."""


@lru_cache(maxsize=16)
def sides_of(skeleton: Skeleton) -> tuple[Sides, ...]:
    """The whole body, then the limbs that are joined: the arms, and the legs."""
    first, sets = limb_joints(skeleton)[:, 0], [sorted(limbs) for limbs in _joined_limbs(skeleton)]
    whole = Sides(np.arange(len(first)), skeleton.mirror != np.arange(skeleton.n_joints))
    alone = [
        Sides(np.flatnonzero(np.isin(first, limbs)), whole.joints & np.isin(of_limb(skeleton), limbs)) for limbs in sets
    ]
    return whole, *(alone if len(alone) > 1 else ())


def _joined_limbs(skeleton: Skeleton) -> list[set[int]]:
    """The joints of limbs of both sides that are joined on each side."""
    sets = list[set[int]]()
    for both in skeleton.limb_pairs:
        joints = {joint for bone in both for joint in bone}
        joined = [each for each in sets if each & joints]
        sets = [each for each in sets if not each & joints] + [joints.union(*joined)]
    return sets


@lru_cache(maxsize=16)
def of_limb(skeleton: Skeleton) -> Int[np.ndarray, " joint"]:
    """The joint of limb_joints that each joint is or hangs on, as fingers on a wrist; -1: none."""
    limbs = set(limb_joints(skeleton).ravel().tolist())
    ends = limbs - {a for a, b in skeleton.bones if a in limbs and b in limbs}
    links = [*skeleton.bones, *((part.hangs_on[0], joint) for part in skeleton.parts for joint in part.joints)]
    on = np.full(skeleton.n_joints, -1)
    on[list(limbs)] = list(limbs)
    for end in ends:
        beyond = {end}
        while more := {b for a, b in links if a in beyond} - beyond - limbs:
            beyond |= more
        on[list(beyond)] = end
    return on


@lru_cache(maxsize=16)
def limb_joints(skeleton: Skeleton) -> Int[np.ndarray, "pair side"]:
    """Left and right joints of the limbs, or of all pairs where a skeleton has no limbs. Faces and fingers are left
    out: their many joints would outweigh the limbs."""
    ends = [ends for left, right in skeleton.limb_pairs for ends in zip(left, right, strict=True)]
    return np.array(list(dict.fromkeys(ends)) or skeleton.left_right, dtype=int).reshape(-1, 2)


def can_tell(skeleton: Skeleton, rig: CameraRig, n_cameras: int) -> bool:
    """Whether there are limbs with two sides, and at least so many cameras that see them."""
    return rig.n_cameras >= n_cameras and len(limb_joints(skeleton)) > 0


def limbs(observations: Observations, rig: CameraRig) -> Limbs:
    """The undistorted detections of the limbs (see limb_joints), and their weights: the confidence, as a share of what
    is usual; zero where there is none."""
    pairs = limb_joints(observations.skeleton)
    points_px = rig.undistort(observations.points2d_px[:, :, pairs.ravel()])
    confidence = observations.confidence[:, :, pairs]
    return _weighted(points_px.reshape(*confidence.shape, 2), confidence)


def limbs_of(undistorted_px: Float[np.ndarray, "frame camera joint 2"], observations: Observations) -> Limbs:
    """The same of detections of all joints that are undistorted already."""
    pairs = limb_joints(observations.skeleton)
    return _weighted(undistorted_px[:, :, pairs], observations.confidence[:, :, pairs])


def _weighted(
    points_px: Float[np.ndarray, "frame camera pair side 2"], confidence: Float[np.ndarray, "frame camera pair side"]
) -> Limbs:
    seen = np.isfinite(points_px).all(axis=-1)
    usual = float(medians(confidence[seen])) if seen.any() else 1.0
    return points_px, np.where(seen, np.minimum(confidence / usual, 1.0), 0.0)


def exchanged(
    of_limbs: Float[np.ndarray, "frame camera pair side *rest"], flipped: Bool[np.ndarray, "frame camera"]
) -> Float[np.ndarray, "frame camera pair side *rest"]:
    """With the sides of these views exchanged."""
    return _in_views(flipped, of_limbs[:, :, :, ::-1], of_limbs)


def exchanged_joints(flipped: Bool[np.ndarray, "*views sides"], skeleton: Skeleton) -> Bool[np.ndarray, "*views joint"]:
    """The joints that are exchanged where these of sides_of are, one after the other. Those of no limb, as of the face,
    are where all limbs are: too near to each other to be judged."""
    whole, *alone = sides_of(skeleton)
    if not alone:
        return flipped & whole.joints
    of_limbs = flipped[..., :1] ^ flipped[..., 1:]
    joints = of_limbs.all(axis=-1, keepdims=True) & whole.joints
    for number, limb in enumerate(alone):
        joints |= of_limbs[..., number, None] & limb.joints
    return joints


def with_sides_exchanged(observations: Observations, joints: Bool[np.ndarray, "frame camera joint"]) -> Observations:
    """The observations with all that is known of these joints in place of what is known of those of the other side."""
    mirror = observations.skeleton.mirror

    def of_other_side(values: np.ndarray) -> np.ndarray:
        return _in_views(joints, values[:, :, mirror], values)

    return replace(observations, **observations.per_detection(of_other_side))


def _in_views(
    there: Bool[np.ndarray, "*where"], values: Shaped[np.ndarray, "*shape"], elsewhere: Shaped[np.ndarray, "*shape"]
) -> Shaped[np.ndarray, "*shape"]:
    return np.where(there.reshape(*there.shape, *[1] * (elsewhere.ndim - there.ndim)), values, elsewhere)
