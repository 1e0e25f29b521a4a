"""Lengths of the parts of a body, as shares of its stature."""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from fgpose.kinematics.proportions import FOREARM, HIPS, SHANK, SHOULDERS, THIGH, TRUNK, UPPER_ARM
from fgpose.skeleton import Skeleton

Point = tuple[str, ...]  # the mean of these joints


class BodyLength(NamedTuple):
    """A distance on the body that hardly changes."""

    start: Point
    end: Point
    share: float
    """Of the stature."""


_SHOULDERS, _HIPS = ("left_shoulder", "right_shoulder"), ("left_hip", "right_hip")
_OF_A_SIDE = (
    ("shoulder", "elbow", UPPER_ARM),
    ("elbow", "wrist", FOREARM),
    ("hip", "knee", THIGH),
    ("knee", "ankle", SHANK),
)
_ACROSS = (
    BodyLength(_SHOULDERS, _HIPS, TRUNK),
    BodyLength(_SHOULDERS[:1], _SHOULDERS[1:], SHOULDERS),
    BodyLength(_HIPS[:1], _HIPS[1:], HIPS),
)
_LIMBS = tuple(
    BodyLength((f"{side}_{start}",), (f"{side}_{end}",), share)
    for start, end, share in _OF_A_SIDE
    for side in ("left", "right")
)
_PARTS = (*_LIMBS, *_ACROSS)
# Of parts that are long: errors of joints are small shares of them.
_LONG = (*_LIMBS, _ACROSS[0])
_OF_LEGS = (THIGH, SHANK)  # shares, which no other long part has
_FEWEST_PARTS = 3
LEAST_FRAMES = 5
"""In fewer, the length of a bone is not judged."""


def lengths_m(
    positions_m: Float[np.ndarray, "frame joint 3"], skeleton: Skeleton, parts: tuple[BodyLength, ...] = _PARTS
) -> tuple[Float[np.ndarray, " part"], Float[np.ndarray, " part"], Float[np.ndarray, " part"]]:
    """Median length of the parts that the skeleton has and that are known in some frames, by how much each changes
    (median), both in the unit of the positions, and what share of the stature it is of other people."""
    found = []
    for part in parts:
        if not {*part.start, *part.end} <= set(skeleton.joints):
            continue
        ends = [positions_m[:, [skeleton.index(joint) for joint in end]].mean(axis=1) for end in (part.start, part.end)]
        length = np.linalg.norm(ends[0] - ends[1], axis=-1)
        length = length[np.isfinite(length)]
        if len(length) >= LEAST_FRAMES:
            usual = float(np.median(length))
            found.append((usual, float(np.median(np.abs(length - usual))), part.share))
    usual, change, share = np.array(found).reshape(-1, 3).T
    return usual, change, share


def stature_m(positions_m: Float[np.ndarray, "frame joint 3"], skeleton: Skeleton) -> float:
    """Median over the long parts of what each says; NaN with fewer than three, or without legs: by the arms alone of
    motion capture people of 1.6 to 1.8 m would be 1.2 to 1.5 m tall."""
    usual, _, share = lengths_m(positions_m, skeleton, _LONG)
    has_legs = np.isin(share, _OF_LEGS).any()
    return float(np.median(usual / share)) if len(usual) >= _FEWEST_PARTS and has_legs else np.nan


def rough_stature_m(positions_m: Float[np.ndarray, "frame joint 3"], skeleton: Skeleton) -> float:
    """The same by any long part, to half of it; NaN without any."""
    usual, _, share = lengths_m(positions_m, skeleton, _LONG)
    return float(np.median(usual / share)) if len(usual) else np.nan


def strangeness(positions_m: Float[np.ndarray, "frame joint 3"], skeleton: Skeleton) -> float:
    """How little joints are like those of a body: the mean over the parts of the deviation of their lengths from those
    of other people with the same stature, as a logarithm, and of by how much they change; 0.1 to 0.3 of a body, NaN
    with fewer than five parts."""
    usual, change, share = lengths_m(positions_m, skeleton)
    if len(usual) < 5:
        return np.nan
    return float(np.mean(_unlike(usual, share)) + np.mean(_changing(usual, change)))


def contradictions(positions_m: Float[np.ndarray, "frame joint 3"], skeleton: Skeleton) -> float:
    """The same as a sum over the parts, with what left and right limbs differ by, as a logarithm; NaN if some part of
    arms, legs and trunk is missing. Of two orders of the joints, the right one has less: what both share cancels."""
    usual, change, share = lengths_m(positions_m, skeleton)
    if len(usual) < len(_PARTS):
        return np.nan
    left, right = np.log(np.maximum(usual[: len(_LIMBS)], 1e-9)).reshape(-1, 2).T
    return float(np.sum(_unlike(usual, share)) + np.sum(_changing(usual, change)) + np.sum(np.abs(left - right)))


def _unlike(usual: Float[np.ndarray, " part"], share: Float[np.ndarray, " part"]) -> Float[np.ndarray, " part"]:
    statures = np.log(np.maximum(usual, 1e-9) / share)
    return np.minimum(np.abs(statures - np.median(statures)), 2.0)


def _changing(usual: Float[np.ndarray, " part"], change: Float[np.ndarray, " part"]) -> Float[np.ndarray, " part"]:
    return np.minimum(change / np.maximum(usual, 1e-9), 1.0)


def looseness(positions_m: Float[np.ndarray, "frame joint 3"]) -> float:
    """By how much each joint changes its distance to that other one to which it keeps it best, as a share of it; median
    over the joints. Of a body, whatever its joints are called, that is how well its bones are measured."""
    distance_m = np.linalg.norm(positions_m[:, :, None] - positions_m[:, None], axis=-1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of joints that are never known together
        usual_m = np.nanmedian(distance_m, axis=0)
        change = np.nanmedian(np.abs(distance_m - usual_m), axis=0) / np.where(usual_m > 0, usual_m, np.nan)
        return float(np.nanmedian(np.nanmin(change, axis=1)))
