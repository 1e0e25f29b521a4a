"""Mirrors: a person seen in one, a video that was flipped, a reconstruction that is turned inside out."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.from_people.rig.procrustes import centred
from fgpose.calibration.from_people.world.anatomy import Anatomy
from fgpose.skeleton import Skeleton

# By how much the poses of two views have to correlate better with one of them mirrored. Views of one person correlate
# by 0.9 and more as they are; somebody who stands still, about equally well mirrored.
_CLEARLY = 0.05


def handedness(joints_m: Float[np.ndarray, "frame joint 3"], skeleton: Skeleton) -> float:
    """Whether a body is one that has its heart on the left: +1 if so in all frames, -1 if it is mirrored, around 0 if
    that is not known. Toes are in front of heels, the nose of the ears, and knees bend forwards.
    """
    anatomy = Anatomy(skeleton)
    up, left = anatomy.top_m(joints_m) - anatomy.bottom_m(joints_m), anatomy.left(joints_m)
    volumes = np.concatenate(
        [np.sum(np.cross(forward, left) * up, axis=-1) for forward in _forwards(joints_m, anatomy)]
    )
    known = volumes[np.isfinite(volumes)]
    total = float(np.abs(known).sum())
    return float(known.sum()) / total if total > 0 else 0.0


def _forwards(joints_m: Float[np.ndarray, "frame joint 3"], anatomy: Anatomy) -> list[Float[np.ndarray, "frame 3"]]:
    joints = set(anatomy.skeleton.joints)

    def of(*names: str) -> Float[np.ndarray, "frame 3"]:
        return anatomy.mean_m(joints_m, names)

    forwards = []
    for side in ("left", "right"):
        hip, knee, ankle = (f"{side}_{joint}" for joint in ("hip", "knee", "ankle"))
        forwards.append(of(knee) - of(hip, ankle))
        toes = [toe for toe in (f"{side}_big_toe", f"{side}_foot_index", f"{side}_foot") if toe in joints]
        forwards += [of(toe) - of(ankle) for toe in toes]
    if {"nose", "left_ear", "right_ear"} <= joints:
        forwards.append(of("nose") - of("left_ear", "right_ear"))
    return forwards


def mirrored_views(
    points3d_m: Float[np.ndarray, "frame camera joint 3"], skeleton: Skeleton
) -> Bool[np.ndarray, " camera"]:
    """Which cameras see the person mirrored, by the 3D of each view alone.

    In a mirrored image the detector calls the left hand right and sees turns to the left as turns to the right: the
    poses are those of the mirrored body, which no rotation takes to the poses of another view. A camera is mirrored if
    that is so against more than half of the others; of two cameras, either may be: both are named.
    """
    n_cameras = points3d_m.shape[1]
    votes, compared = np.zeros(n_cameras), np.zeros(n_cameras)
    for a in range(n_cameras):
        for b in range(a):
            better = _better_mirrored(points3d_m[:, a], points3d_m[:, b], skeleton)
            if np.isfinite(better):
                compared[[a, b]] += 1
                votes[[a, b]] += better > _CLEARLY
    return np.asarray(votes > compared / 2)


def _better_mirrored(
    first_m: Float[np.ndarray, "frame joint 3"], second_m: Float[np.ndarray, "frame joint 3"], skeleton: Skeleton
) -> float:
    """By how much the poses of two views correlate better with one mirrored; NaN if no frame has both."""
    known = np.asarray((np.isfinite(first_m) & np.isfinite(second_m)).all(axis=-1))
    # The other side of the body takes the place of a mirrored joint, so both have to be known.
    known = known & known[:, skeleton.mirror]
    if not known.any():
        return float("nan")
    first, second = (centred(points_m, known)[0] for points_m in (first_m, second_m))
    size = float(np.sqrt(np.sum(first**2) * np.sum(second**2)))
    as_it_is, mirrored = _correlation(first, second, 1.0), _correlation(first, second[:, skeleton.mirror], -1.0)
    return (mirrored - as_it_is) / size if size > 0 else float("nan")


def _correlation(
    first: Float[np.ndarray, "frame joint 3"], second: Float[np.ndarray, "frame joint 3"], determinant: float
) -> float:
    """Largest sum of products over the rotations (determinant 1) or reflections (-1) of the second (Kabsch)."""
    U, values, Vt = np.linalg.svd(np.einsum("tji,tjk->ik", first, second))
    values[2] *= np.sign(np.linalg.det(U @ Vt)) * determinant
    return float(values.sum())
