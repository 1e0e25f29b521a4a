"""Covariances that include what the graph does not model.

The graph takes the errors of detections as independent. The errors of a pose network are correlated in time, so many
frames together carry less information than the graph believes. And if some detections of a joint were taken for
hallucinated, others may be hallucinated too, so the covariance is widened. Online, where hallucinated detections keep
their weight, this effect is much larger.

A bone keeps an unseen joint on a sphere around the joint that holds it. Linearised, the sphere is a plane. As the plane
turns with the body, the bone seems to measure the joint in every direction, and the graph states centimetres although
the arm may have swung around. How far unseen joints swing was measured on motion capture (see SwingConfig); that much
is added across the bone.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import Float

from fgpose.config import SwingConfig
from fgpose.skeleton import Skeleton

# Share of the variance of a visible detection that is correlated in time (4 of 5 px), and the correlation time,
# measured on a monocular network.
_CORRELATED_SHARE, _CORRELATION_S = 0.64, 0.15
# Fitted to the errors on four motion capture clips, at their pace and twice as fast, with 2, 3 and 4 cameras, with and
# without occlusion. sigma_px is cautious (6 px, of which 5 px are there, would be 0.69), but errors have heavy tails.
# The information of the whole graph over that of one frame counts frames of unequal weight.
_CAUTION, _EQUAL_FRAMES, _TRUSTED_VIEWS = 0.8, 0.35, 1.5
# Fitted to the newest pose on the same recordings.
_CAUTION_ONLINE, _DISTRUST_ONLINE, _TRUSTED_VIEWS_ONLINE = 1.0, 20.0, 2.5
_MAX_FRAMES = 1e4
_MAX_STEP_S = 1e3
_SHORT = 1e-4  # there formula and series are both accurate to 1e-7


def with_correlated_errors(
    covariance_m2: Float[np.ndarray, "*joints 3 3"],
    frame_information: Float[np.ndarray, "*joints 3 3"],
    step_s: float,
) -> Float[np.ndarray, "*joints 3 3"]:
    """The covariance of the graph, scaled to what it would be with errors that are correlated in time.

    The mean of n frames, h apart, of which a share s of the variance is correlated as exp(-t / tau), has the variance
    (1 - s + s n g(n h / tau)) / n instead of 1 / n, with g(u) = 2 (u - 1 + exp(-u)) / u^2.

    Args:
        frame_information: of the detections of each frame alone, 1/m^2.
    """
    information = np.trace(np.linalg.inv(covariance_m2), axis1=-2, axis2=-1)
    alone = np.trace(frame_information, axis1=-2, axis2=-1)
    n_frames = np.clip(_EQUAL_FRAMES * information / np.maximum(alone, information / _MAX_FRAMES), 1e-3, None)
    step_s = min(step_s, _MAX_STEP_S)
    correlation = _mean_correlation(n_frames * step_s / _CORRELATION_S)
    widening = 1 - _CORRELATED_SHARE + _CORRELATED_SHARE * n_frames * correlation
    widening = np.maximum(widening, 1.0)  # less than one frame cannot be averaged
    return covariance_m2 * widening[..., None, None]


def distrust_factor(trust: Float[np.ndarray, "*joints"]) -> Float[np.ndarray, "*joints"]:
    """Factor on the covariance of the batch, larger where many detections were distrusted.

    Args:
        trust: weights of the detections of a joint, summed over the cameras; the factor grows below _TRUSTED_VIEWS.
    """
    return _CAUTION * (1.0 + np.clip(1.0 - trust / _TRUSTED_VIEWS, 0.0, 1.0) ** 2)


def distrust_factor_online(
    trust: Float[np.ndarray, "*joints"], weight: Float[np.ndarray, "*joints"]
) -> Float[np.ndarray, "*joints"]:
    """Factor on the covariance of the newest pose, larger where many detections have not fitted lately.

    Args:
        trust: weights of the detections of a joint that have fitted lately, summed over the cameras.
        weight: of all its detections; the factor grows with the share of it that is not in trust.
    """
    enough = np.maximum(np.minimum(weight, _TRUSTED_VIEWS_ONLINE), 1e-9)
    return _CAUTION_ONLINE * (1.0 + _DISTRUST_ONLINE * np.clip(1.0 - trust / enough, 0.0, 1.0) ** 2)


def _mean_correlation(duration: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Mean of exp(-|a - b|) over all a and b in [0, duration]."""
    # For a short duration the subtractions cancel all digits: take the series.
    exact = 2 * (duration - 1 + np.exp(-duration)) / np.maximum(duration, _SHORT) ** 2
    return np.where(duration > _SHORT, exact, 1 - duration / 3)


def with_swing(
    covariance_m2: Float[np.ndarray, "frame joint 3 3"],
    positions_m: Float[np.ndarray, "frame joint 3"],
    unseen_s: Float[np.ndarray, "frame joint"],
    skeleton: Skeleton,
    config: SwingConfig,
) -> Float[np.ndarray, "frame joint 3 3"]:
    """The covariance widened for the swing of every unseen joint and of those that hold it.

    A bone of length L that has turned by an angle a has moved its end by L a across and L a^2 / 2 along itself.
    """
    if not (unseen_s > 0).any():
        return covariance_m2
    swing_m2 = np.zeros_like(covariance_m2)
    for joint, holder in _holders(skeleton):
        bone_m = positions_m[:, joint] - positions_m[:, holder]
        length_m = np.linalg.norm(bone_m, axis=-1)
        direction = np.divide(bone_m, length_m[:, None], out=np.zeros_like(bone_m), where=length_m[:, None] > 0)
        angle = config.angle_rad * (1.0 - np.exp(-unseen_s[:, joint] / config.time_s))
        along = np.einsum("ti,tj->tij", direction, direction)
        across_m2 = (length_m * angle) ** 2 / 2
        along_m2 = (length_m * angle**2 / 2) ** 2
        own_m2 = across_m2[:, None, None] * (np.eye(3) - along) + along_m2[:, None, None] * along
        swung = (unseen_s[:, joint] > 0)[:, None, None] & np.isfinite(own_m2)
        swing_m2[:, joint] = np.where(swung, own_m2 + swing_m2[:, holder], 0.0)
    return covariance_m2 + swing_m2


@lru_cache(maxsize=16)  # asked for at every update of the online estimator that has an unseen joint
def _holders(skeleton: Skeleton) -> list[tuple[int, int]]:
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
