"""Covariances that include what the graph does not model.

The graph takes the errors of detections as independent. The errors of a pose network are correlated in time, so many
frames together carry less information than the graph believes. And if some detections of a joint were taken for
hallucinated, others may be hallucinated too, so the covariance is widened. Online, where hallucinated detections lose
their weight only after a while, this effect is much larger.

A bone keeps an unseen joint on a sphere around the joint that holds it. Linearised, the sphere is a plane. As the plane
turns with the body, the bone seems to measure the joint in every direction, and the graph states centimetres although
the arm may have swung around. How far unseen joints swing was measured on motion capture (see SwingConfig); that much
is added across the bone. And somebody of whom no camera sees anything may go on as before, or as after.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.config import SwingConfig
from fgpose.estimation.noise import ROUNDING, surely_positive
from fgpose.geometry.vectors import norm
from fgpose.skeleton import Skeleton

LEAST_FACTOR = 0.02
"""What is left of a variance in that of the graph where nothing errs."""
_TRUSTED_VIEWS = 1.5
_AROUND_S = 0.3  # of a time without anybody seen; at its edges themselves smoothing has slowed the body down
# Fitted to the newest pose on the tuning clips of the benchmark, clean and occluded.
_DISTRUST_ONLINE, _TRUSTED_VIEWS_ONLINE = 15.0, 2.5


def distrust_factor(trust: Float[np.ndarray, "*joints"]) -> Float[np.ndarray, "*joints"]:
    """Factor on the covariance of the batch, larger where many detections were distrusted.

    Args:
        trust: weights of the detections of a joint, summed over the cameras; the factor grows below _TRUSTED_VIEWS.
    """
    return 1.0 + np.clip(1.0 - trust / _TRUSTED_VIEWS, 0.0, 1.0) ** 2


def distrust_factor_online(
    trust: Float[np.ndarray, "*joints"], weight: Float[np.ndarray, "*joints"]
) -> Float[np.ndarray, "*joints"]:
    """Factor on the covariance of the newest pose, larger where many detections are probably hallucinated.

    Args:
        trust: weights of the detections of a joint times the probability that they are of it, summed over the cameras.
        weight: of all its detections; the factor grows with the share of it that is not in trust.
    """
    enough = np.maximum(np.minimum(weight, _TRUSTED_VIEWS_ONLINE), 1e-9)
    return 1.0 + _DISTRUST_ONLINE * np.clip(1.0 - trust / enough, 0.0, 1.0) ** 2


def at_least(
    covariance_m2: Float[np.ndarray, "*joints 3 3"], least_m2: Float[np.ndarray, "*joints 3 3"]
) -> Float[np.ndarray, "*joints 3 3"]:
    """The covariances widened in the directions in which another one is larger.

    Args:
        covariance_m2: positive definite; NaN where a joint is not estimated.
        least_m2: the others; may be 0.
    """
    known = np.isfinite(covariance_m2).all(axis=(-1, -2)) & least_m2.any(axis=(-1, -2))
    if not known.any():
        return covariance_m2
    widened_m2 = covariance_m2.copy()
    variance_m2, own = np.linalg.eigh(surely_positive(covariance_m2[known]))
    sigma_m = np.sqrt(np.maximum(variance_m2, ROUNDING * variance_m2[..., -1:]))[..., None, :]
    own, whitening = own * sigma_m, own / sigma_m
    ratio, axes = np.linalg.eigh(whitening.swapaxes(-1, -2) @ least_m2[known] @ whitening)
    axes = own @ axes
    widened_m2[known] = np.einsum("jik,jk,jlk->jil", axes, np.maximum(ratio, 1.0), axes)
    return widened_m2


def with_swing(
    covariance_m2: Float[np.ndarray, "frame joint 3 3"],
    positions_m: Float[np.ndarray, "frame joint 3"],
    unseen_s: Float[np.ndarray, "frame joint"],
    skeleton: Skeleton,
    config: SwingConfig,
    of_seen_m2: Float[np.ndarray, "frame joint 3 3"] | None = None,
    doubt: Float[np.ndarray, "frame joint"] | float = 0.0,
    speed_mps: Float[np.ndarray, " frame"] | float = 0.0,
) -> Float[np.ndarray, "frame joint 3 3"]:
    """The covariance widened for the swing of every unseen joint and of those that hold it, for what is doubted, and
    for the way of somebody of whom no camera sees anything.

    Args:
        covariance_m2: of all joints.
        positions_m: of all joints.
        unseen_s: time to when any camera sees each joint.
        skeleton: for the bones.
        config: how far they swing.
        of_seen_m2: by how much the covariance of seen joints was widened already; that of those that they hold is too.
        doubt: probability that all detections of a joint are guesses; see fgpose.estimation.evidence.credibility.
        speed_mps: of the body, from around the time in which no camera sees it: it may go on, or stop.

    A bone of length L that has turned by an angle a has moved its end by L a across and L a^2 / 2 along itself.
    """
    doubt = np.broadcast_to(doubt, unseen_s.shape)
    swings = (unseen_s > 0) | (doubt > 0)
    if not swings.any():
        return covariance_m2
    swing_m2 = np.zeros_like(covariance_m2)
    gone_m = speed_mps * np.nan_to_num(unseen_s.min(axis=1), posinf=0.0)  # who was never seen does not go on
    held = [joint for joint, _ in holders(skeleton)]
    free = np.isin(np.arange(skeleton.n_joints), held, invert=True)
    swing_m2[:, free] = np.where(swings[:, free, None, None], (gone_m**2 / 3)[:, None, None, None] * np.eye(3), 0.0)
    bone_m = positions_m[:, held] - positions_m[:, [holder for _, holder in holders(skeleton)]]
    length_m = norm(bone_m)
    direction = np.divide(bone_m, length_m[..., None], out=np.zeros_like(bone_m), where=length_m[..., None] > 0)
    angle = config.angle_rad * (1.0 - np.exp(-unseen_s[:, held] / config.time_s))
    along = direction[..., None] * direction[..., None, :]
    across_m2 = (length_m * angle) ** 2 / 2
    along_m2 = (length_m * angle**2 / 2) ** 2
    # Anywhere on the sphere, as far as in doubt: two squared lengths in all, two thirds along each axis.
    anywhere_m2 = 2 / 3 * doubt[:, held] * length_m**2
    own_m2 = across_m2[..., None, None] * (np.eye(3) - along) + along_m2[..., None, None] * along
    own_m2 += anywhere_m2[..., None, None] * np.eye(3)
    swung = swings[:, held, None, None] & np.isfinite(own_m2)
    for number, (joint, holder) in enumerate(holders(skeleton)):
        of_holder_m2 = swing_m2[:, holder]
        if of_seen_m2 is not None:
            of_holder_m2 = of_holder_m2 + of_seen_m2[:, holder]
        swing_m2[:, joint] = np.where(swung[:, number], own_m2[:, number] + of_holder_m2, 0.0)
    return covariance_m2 + swing_m2


def speed_unseen_mps(
    positions_m: Float[np.ndarray, "all_frames joint 3"],
    frames: Int[np.ndarray, " frame"],
    time_s: Float[np.ndarray, " frame"],
    is_seen: Bool[np.ndarray, " frame"],
) -> Float[np.ndarray, " frame"]:
    """The highest speed of the body within 0.3 s before or after the time in which no camera sees it, m/s; 0 elsewhere.

    Args:
        positions_m: of all joints; NaN where not estimated.
        frames: numbers of those that are asked for.
        time_s: of these.
        is_seen: whether any camera sees any joint.
    """
    speed_mps = np.zeros(len(time_s))
    (seen,) = np.nonzero(is_seen)
    if is_seen.all() or len(seen) < 2:
        return speed_mps
    middle_s = (time_s[seen][1:] + time_s[seen][:-1]) / 2
    unseen = np.flatnonzero(~is_seen)
    after = np.searchsorted(seen, unseen)
    before_s = time_s[seen[np.maximum(after - 1, 0)]] - _AROUND_S
    after_s = time_s[seen[np.minimum(after, len(seen) - 1)]] + _AROUND_S
    first, last = np.searchsorted(middle_s, before_s), np.searchsorted(middle_s, after_s)
    # Of a long recording only the steps that are asked for.
    n_asking = np.bincount(first, minlength=len(seen)) - np.bincount(last, minlength=len(seen))
    steps = np.flatnonzero(np.cumsum(n_asking)[:-1])
    moved_m = positions_m[frames[seen[steps + 1]]] - positions_m[frames[seen[steps]]]
    known = np.isfinite(moved_m).all(axis=-1, keepdims=True)
    mean_m = np.where(known, moved_m, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    of_steps_mps = np.zeros(len(middle_s))
    of_steps_mps[steps] = norm(mean_m) / np.diff(time_s[seen])[steps]
    for frame, begin, end in zip(unseen.tolist(), first.tolist(), last.tolist(), strict=True):
        speed_mps[frame] = of_steps_mps[begin:end].max(initial=0.0)
    return speed_mps


@lru_cache(maxsize=16)  # asked for at every update of the online estimator that has an unseen joint
def holders(skeleton: Skeleton) -> list[tuple[int, int]]:
    """(joint, the joint that holds it), every holder before what it holds."""
    holder_of: dict[int, int] = {}
    for start, end in skeleton.bones:
        holder_of.setdefault(end, start)

    def depth(joint: int) -> int:
        steps = 0
        while joint in holder_of and steps <= skeleton.n_joints:
            joint, steps = holder_of[joint], steps + 1
        return steps

    return sorted(holder_of.items(), key=lambda pair: depth(pair[0]))
