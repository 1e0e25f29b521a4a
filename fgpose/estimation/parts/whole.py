"""From the estimates of parts to those of a whole body, and back."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int

from fgpose.skeleton import BoneLengths, Skeleton


def of_all_joints(
    found: Sequence[tuple[Sequence[int], object]], name: str, n_joints: int, axis: int
) -> np.ndarray | None:
    """An array of all joints from those of parts; None where a part has none.

    Args:
        found: the joints of each part, and what has its array.
        name: of the array.
        n_joints: of the whole body.
        axis: of the array, of the joints.
    """
    arrays = [getattr(each, name) for _, each in found]
    if any(array is None for array in arrays):
        return None
    shape = [*arrays[0].shape]
    shape[axis] = n_joints
    whole = np.empty(shape, dtype=arrays[-1].dtype)
    for (joints, _), array in zip(found, arrays, strict=True):
        whole[(slice(None),) * axis + (list(joints),)] = array
    return whole


def of_all_lengths(skeleton: Skeleton, own: Sequence[tuple[Skeleton, BoneLengths]]) -> BoneLengths:
    """The lengths of all bones: one that both hands share is the mean of theirs, and no surer than that of one. Those
    of a rigid set are none of the skeleton's.

    Args:
        skeleton: of the whole body.
        own: skeletons of the parts, and their lengths.
    """
    of_length: dict[int, list[tuple[float, float]]] = {}
    for part, lengths in own:
        for number, mine in enumerate(_whole_lengths(skeleton, part).tolist()):
            if mine >= 0 and np.isfinite(lengths.lengths_m[number]):
                of_length.setdefault(mine, []).append((lengths.lengths_m[number], lengths.sigma_m[number]))
    unknown = BoneLengths.unknown(skeleton.n_lengths)
    lengths_m, sigma_m = unknown.lengths_m.copy(), unknown.sigma_m.copy()
    for length, known in of_length.items():
        lengths_m[length], sigma_m[length] = np.mean(known, axis=0)
    return BoneLengths(lengths_m, sigma_m)


def of_part(lengths: BoneLengths, skeleton: Skeleton, part: Skeleton) -> BoneLengths:
    """The lengths of a part, of those of the whole body; what it has of its own is not known."""
    mine = _whole_lengths(skeleton, part)
    lengths_m = np.where(mine >= 0, lengths.lengths_m[mine], np.nan)
    return BoneLengths(lengths_m, np.where(mine >= 0, lengths.sigma_m[mine], np.inf))


def _whole_lengths(skeleton: Skeleton, part: Skeleton) -> Int[np.ndarray, " own"]:
    """For each length of a part, its number in the whole body; -1: it has none."""
    number = {
        frozenset(skeleton.joints[joint] for joint in bone): length
        for bone, length in zip(skeleton.bones, skeleton.length_of_bone, strict=True)
    }
    mine = np.full(part.n_lengths, -1)
    for bone, length in zip(part.bones, part.length_of_bone, strict=True):
        mine[length] = number.get(frozenset(part.joints[joint] for joint in bone), -1)
    return mine
