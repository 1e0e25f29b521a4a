"""Finding and correcting views in which the network has exchanged the left and the right side of the body.

A flip is a state of one camera that begins and ends: a hidden Markov model over time, whose state says which cameras
are flipped. Three things tell how probable a state is: how well the limbs of all views meet in space when the sides of
the flipped views are exchanged; how far the joints of a camera jump between frames, exchanged or not; and that flips
are rare. The forward-backward algorithm (Rabiner 1989) gives the probability that a view is flipped, given the whole
recording. Where left and right coincide in the image there is no evidence of a flip, and none is found.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate, triangulate_robust
from fgpose.observations import Observations
from fgpose.skeleton import Skeleton

# Limbs of views that agree miss each other by 10 to 40 mm, calibration errors included; left and right are 200 to 400
# mm apart. A detection that misses by this or more makes a state less probable by the factor e, whatever its distance.
_AGREEMENT_M = 0.10
_INLIER_PX = 40.0  # see CameraRig.in_own_px
_STILL_M = 0.05
_SPEED_M_PER_S = 1.5
"""A joint is expected within _STILL_M + _SPEED_M_PER_S * dt of where it was; after 0.3 s this no longer tells the sides
apart."""
_BEGIN_PER_S = 0.2
_END_PER_S = 2.0
"""Rates at which flips begin and end: a flip lasts 0.5 s on average, and one view in eleven is flipped, as measured
with the poorest network."""
_SURE = 0.9
"""A view that is flipped with at least this probability is corrected; between its complement and this a view is
uncertain."""
_MIN_SHARE = 0.1
"""Smallest factor on the confidence of an uncertain view: its joints still show where the limbs are."""
# These bound time and memory, which grow with states, pairs of views and frames. In a rig of more than six cameras two
# flips are found in each round; 15 are all pairs of six cameras.
_MAX_FLIPPED_AT_ONCE = 2
_ROUNDS = 3
_MAX_PAIRS = 15
_FRAMES_AT_ONCE = 200


@dataclass(frozen=True, eq=False)
class FlipCorrection:
    """Observations in which left and right mean the same in all views."""

    observations: Observations
    """Sides exchanged where flipped; confidence lowered where uncertain."""
    flipped: Bool[np.ndarray, "frame camera"]
    """Views whose left and right were exchanged."""
    uncertain: Bool[np.ndarray, "frame camera"]
    """Views that may be flipped or not, as with two cameras that always contradict each other."""


def correct_flips(observations: Observations, rig: CameraRig) -> FlipCorrection:
    """Exchange left and right of the views that are flipped as a whole, and lower the confidence of uncertain ones.

    A camera can only be judged by others. With one camera nothing is done; with two that disagree, only the frames
    before and after tell which one is wrong. The confidence of an uncertain view is multiplied by |2 p - 1|, p the
    probability of a flip. A view in which only the legs or only the arms are exchanged counts as whichever fits better:
    that is rare (2 of 1,200 real views), and the robust kernels of the estimator cope with it.

    Raises:
        ValueError: the cameras of the observations and of the rig differ.
    """
    observations.check_cameras(rig.names)
    probability = flip_probability(observations, rig)
    flipped = np.zeros(probability.shape, dtype=bool)
    # Of a large rig only a few flipped cameras are considered at once; correcting them helps to find the others.
    for _ in range(_ROUNDS):
        found = probability > _SURE
        if not found.any():
            break
        observations, flipped = _exchanged(observations, found), flipped ^ found
        probability = flip_probability(observations, rig)
    uncertain = probability > 1.0 - _SURE
    share = np.where(uncertain, np.maximum(np.abs(2.0 * probability - 1.0), _MIN_SHARE), 1.0)
    observations = replace(observations, confidence=observations.confidence * share[..., None])
    return FlipCorrection(observations, flipped, uncertain)


def flip_probability(observations: Observations, rig: CameraRig) -> Float[np.ndarray, "frame camera"]:
    """Probability that each view has left and right exchanged; 0 where it sees nothing of the limbs."""
    pairs = _limb_joints(observations.skeleton)
    states = _states(rig.n_cameras)
    if not len(pairs) or len(states) == 1:
        return np.zeros((observations.n_frames, rig.n_cameras))
    points_px = rig.undistort(observations.points2d_px)[:, :, pairs]
    weights = np.where(np.isfinite(points_px).all(axis=-1), observations.confidence[:, :, pairs], 0.0)
    metres_per_px = _metres_per_px(points_px, weights, rig)
    cost = np.concatenate(
        [
            _disagreement(points_px[part], weights[part], metres_per_px[part], rig, states)
            for part in _parts(observations.n_frames)
        ]
    )
    change = _change(points_px, weights, metres_per_px, observations.frame_time_s)
    posterior = _forward_backward(-cost, change, states)
    return np.where(weights.any(axis=(2, 3)), posterior @ states, 0.0)


def _parts(n_frames: int) -> list[slice]:
    return [slice(start, start + _FRAMES_AT_ONCE) for start in range(0, n_frames, _FRAMES_AT_ONCE)]


def _limb_joints(skeleton: Skeleton) -> Int[np.ndarray, "pair side"]:
    """Left and right joints of the limbs, or of all pairs where a skeleton has no limbs. Faces and fingers are left
    out: their many joints would outweigh the limbs."""
    ends = [ends for left, right in skeleton.limb_pairs for ends in zip(left, right, strict=True)]
    return np.array(list(dict.fromkeys(ends)) or skeleton.left_right, dtype=int).reshape(-1, 2)


def _states(n_cameras: int) -> Int[np.ndarray, "state camera"]:
    """Which cameras may be flipped at once: a minority, or half. The first state is none."""
    at_most = n_cameras // 2 if n_cameras <= 6 else _MAX_FLIPPED_AT_ONCE
    chosen = [flipped for count in range(at_most + 1) for flipped in combinations(range(n_cameras), count)]
    states = np.zeros((len(chosen), n_cameras), dtype=int)
    for state, flipped in zip(states, chosen, strict=True):
        state[list(flipped)] = 1
    return states


def _metres_per_px(
    points_px: Float[np.ndarray, "frame camera pair side 2"],
    weights: Float[np.ndarray, "frame camera pair side"],
    rig: CameraRig,
) -> Float[np.ndarray, "frame camera"]:
    """Size of a pixel at the person, from the middles between left and right, which a flip does not move."""
    middle = triangulate_robust(points_px.mean(axis=3), weights.min(axis=3), rig, rig.in_own_px(_INLIER_PX)).positions_m
    depth_m = np.stack([camera.to_camera_frame(middle)[..., 2] for camera in rig.cameras], axis=1)
    depth_m = _median(np.where(depth_m > 0, depth_m, np.nan), axis=2)
    depth_m = np.where(np.isfinite(depth_m), depth_m, _median(depth_m, axis=0))
    return depth_m / np.array([camera.K[0, 0] for camera in rig.cameras])


def _median(values: Float[np.ndarray, "*shape"], axis: int) -> Float[np.ndarray, "*rest"]:
    """Median of what is known, NaN where nothing is."""
    ordered = np.sort(values, axis=axis)  # NaN comes last
    middle = np.maximum(np.isfinite(values).sum(axis=axis, keepdims=True) - 1, 0) // 2
    return np.take_along_axis(ordered, middle, axis=axis).squeeze(axis)


def _disagreement(
    points_px: Float[np.ndarray, "frame camera pair side 2"],
    weights: Float[np.ndarray, "frame camera pair side"],
    metres_per_px: Float[np.ndarray, "frame camera"],
    rig: CameraRig,
    states: Int[np.ndarray, "state camera"],
) -> Float[np.ndarray, "frame state"]:
    """Disagreement of the views in every state: the sum of the weights of the detections that do not fit. A detection
    that fits roughly counts in part.

    Every two views propose a point, with either side of each; the proposal with which most views agree counts (MSAC).
    """
    pairs = np.array(list(combinations(range(rig.n_cameras), 2)))
    pairs = pairs[:: -(-len(pairs) // _MAX_PAIRS)]
    missed = _missed(points_px, weights, metres_per_px, rig, pairs)
    proposal, camera = np.arange(len(pairs)), np.arange(rig.n_cameras)

    def of_side(side: Int[np.ndarray, " camera"]) -> Float[np.ndarray, " frame"]:
        by_proposal = missed[:, proposal, :, side[pairs[:, 0]], side[pairs[:, 1]]][..., camera, side].sum(axis=-1)
        best = by_proposal.min(axis=0)
        return np.where(np.isfinite(best), best, 0.0).sum(axis=-1)

    return np.stack([of_side(state) + of_side(1 - state) for state in states], axis=-1)


def _missed(
    points_px: Float[np.ndarray, "frame camera pair side 2"],
    weights: Float[np.ndarray, "frame camera pair side"],
    metres_per_px: Float[np.ndarray, "frame camera"],
    rig: CameraRig,
    pairs: Int[np.ndarray, "proposal 2"],
) -> Float[np.ndarray, "frame proposal pair side_a side_b camera side"]:
    """Cost of each detection if the joint were where two views, each with one of its sides, see it: from 0 to its
    weight. Infinite where the proposal is missing."""
    first, second = pairs.T
    shape = (len(points_px), len(pairs), points_px.shape[2], 2, 2)
    two_px = np.stack(
        [
            np.broadcast_to(points_px[:, first, :, :, None], (*shape, 2)),
            np.broadcast_to(points_px[:, second, :, None, :], (*shape, 2)),
        ],
        axis=-2,
    )
    proposals_m = triangulate(two_px, np.ones(two_px.shape[:-1]), rig.projection_matrices[pairs][:, None, None, None])
    projected_px = np.stack([camera.project(proposals_m) for camera in rig.cameras], axis=-2)
    seen_px = np.moveaxis(points_px, 1, 2)[:, None, :, None, None]
    error_px = np.linalg.norm(projected_px[..., None, :] - seen_px, axis=-1)
    cost = _truncated(error_px * metres_per_px[:, None, None, None, None, :, None] / _AGREEMENT_M)
    cost = cost * np.moveaxis(weights, 1, 2)[:, None, :, None, None]
    possible = np.asarray(np.isfinite(proposals_m).all(axis=-1))
    return np.where(possible[..., None, None], cost, np.inf)


def _truncated(ratio: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Square, at most 1; 1 also where nothing is known."""
    return np.where(ratio < 1.0, ratio**2, 1.0)


def _change(
    points_px: Float[np.ndarray, "frame camera pair side 2"],
    weights: Float[np.ndarray, "frame camera pair side"],
    metres_per_px: Float[np.ndarray, "frame camera"],
    time_s: Float[np.ndarray, " frame"],
) -> Float[np.ndarray, "frame camera before after"]:
    """Log probability that each camera is flipped or not, given whether it was in the frame before. It counts how often
    flips begin and end, and how far each joint has jumped since it was last seen, exchanged or not."""
    last = _last_seen(weights > 0)
    known, last = last >= 0, np.maximum(last, 0)
    before_px = np.take_along_axis(points_px, last[..., None], axis=0)
    before_weights = np.where(known, np.take_along_axis(weights, last, axis=0), 0.0)
    reach_m = _STILL_M + _SPEED_M_PER_S * (time_s.reshape(-1, 1, 1, 1) - time_s[last])

    def jump(exchanged: bool) -> Float[np.ndarray, "frame camera"]:
        side = [1, 0] if exchanged else [0, 1]
        distance_m = np.linalg.norm(points_px - before_px[..., side, :], axis=-1) * metres_per_px[..., None, None]
        counts = np.minimum(weights, before_weights[..., side])
        return np.sum(_truncated(distance_m / reach_m[..., side]) * counts, axis=(2, 3))

    step_s = np.diff(time_s, prepend=time_s[0])[:, None]
    begin, end = 1.0 - np.exp(-_BEGIN_PER_S * step_s), 1.0 - np.exp(-_END_PER_S * step_s)
    stay, switch = jump(exchanged=False), jump(exchanged=True)
    with np.errstate(divide="ignore"):
        none = [np.log(1.0 - begin) - stay, np.log(begin) - switch]
        flip = [np.log(end) - switch, np.log(1.0 - end) - stay]
    return np.stack([np.stack(none, axis=-1), np.stack(flip, axis=-1)], axis=-2)


def _last_seen(seen: Bool[np.ndarray, "frame camera pair side"]) -> Int[np.ndarray, "frame camera pair side"]:
    """The last frame before each in which something was seen; -1 where there is none."""
    frame = np.arange(len(seen))[:, None, None, None]
    latest = np.maximum.accumulate(np.where(seen, frame, -1), axis=0)
    return np.concatenate([np.full((1, *seen.shape[1:]), -1), latest[:-1]])


def _forward_backward(
    likelihood: Float[np.ndarray, "frame state"],
    change: Float[np.ndarray, "frame camera before after"],
    states: Int[np.ndarray, "state camera"],
) -> Float[np.ndarray, "frame state"]:
    """Probability of each state in each frame, given all frames; logarithms in, probabilities out."""
    share = _BEGIN_PER_S / (_BEGIN_PER_S + _END_PER_S)
    cameras = np.arange(states.shape[1])
    log_change = [of_frame[cameras, states[:, None], states[None]].sum(axis=-1) for of_frame in change]
    forward, backward = likelihood.copy(), np.zeros_like(likelihood)
    forward[0] += np.where(states == 1, np.log(share), np.log(1.0 - share)).sum(axis=-1)
    for t in range(1, len(likelihood)):
        forward[t] += np.logaddexp.reduce(forward[t - 1][:, None] + log_change[t], axis=0)
        after = len(likelihood) - t
        backward[after - 1] = np.logaddexp.reduce(log_change[after] + likelihood[after] + backward[after], axis=1)
    total = forward + backward
    total = np.exp(total - total.max(axis=1, keepdims=True))
    return total / total.sum(axis=1, keepdims=True)


def _exchanged(observations: Observations, flipped: Bool[np.ndarray, "frame camera"]) -> Observations:
    """The observations with left and right of these views exchanged in all that is known of the joints."""
    if not flipped.any():
        return observations
    mirror = np.arange(observations.skeleton.n_joints)
    for left, right in observations.skeleton.left_right:
        mirror[[left, right]] = right, left

    def exchanged(values: np.ndarray) -> np.ndarray:
        return np.where(flipped.reshape(*flipped.shape, *[1] * (values.ndim - 2)), values[:, :, mirror], values)

    return replace(observations, **observations.per_detection(exchanged))
