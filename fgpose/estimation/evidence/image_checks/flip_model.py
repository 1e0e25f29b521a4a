"""How probable it is that a network has exchanged the left and the right side of a body in some views.

A flip is a state of one camera that begins and ends: a hidden Markov model over time, whose state says which cameras
are flipped. Three things tell how probable a state is: how well the limbs of all views meet in space when the sides of
the flipped views are exchanged; how far the joints of a camera jump between frames, exchanged or not; and that flips
are rare.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from jaxtyping import Float, Int

from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate, triangulate_robust
from fgpose.geometry.vectors import norm

# Limbs of views that agree miss each other by 10 to 40 mm, calibration errors included; left and right are 200 to 400
# mm apart. A detection that misses by this or more makes a state less probable by the factor e, whatever its distance.
_AGREEMENT_M = 0.10
INLIER_PX = 40.0
"""See CameraRig.in_own_px."""
_STILL_M = 0.05
_SPEED_M_PER_S = 1.5
"""A joint is expected within _STILL_M + _SPEED_M_PER_S * dt of where it was; after 0.3 s this no longer tells the sides
apart."""
_BEGIN_PER_S = 0.2
_END_PER_S = 2.0
"""Rates at which flips begin and end: a flip lasts 0.5 s on average, and one view in eleven is flipped, as measured
with the poorest network."""
_SHARE = _BEGIN_PER_S / (_BEGIN_PER_S + _END_PER_S)
# These bound time and memory, which grow with states and pairs of views; 15 are all pairs of six cameras.
_FEW, _MAX_FLIPPED_AT_ONCE = 6, 2
_MAX_PAIRS = 15


def possible_states(n_cameras: int) -> Int[np.ndarray, "state camera"]:
    """Which cameras may be flipped at once: any of a few, also most of them, as what they show next tells; of more two.
    The first state is none."""
    at_most = n_cameras if n_cameras <= _FEW else _MAX_FLIPPED_AT_ONCE
    chosen = [flipped for count in range(at_most + 1) for flipped in combinations(range(n_cameras), count)]
    states = np.zeros((len(chosen), n_cameras), dtype=int)
    for state, flipped in zip(states, chosen, strict=True):
        state[list(flipped)] = 1
    return states


def metres_per_px(
    points_px: Float[np.ndarray, "frame camera pair side 2"],
    weights: Float[np.ndarray, "frame camera pair side"],
    rig: CameraRig,
) -> Float[np.ndarray, "frame camera"]:
    """Size of a pixel at the person, from the middles between left and right, which a flip does not move."""
    middle = triangulate_robust(points_px.mean(axis=3), weights.min(axis=3), rig, rig.in_own_px(INLIER_PX)).positions_m
    depth_m = np.stack([camera.to_camera_frame(middle)[..., 2] for camera in rig.cameras], axis=1)
    depth_m = _median(np.where(depth_m > 0, depth_m, np.nan), axis=2)
    depth_m = np.where(np.isfinite(depth_m), depth_m, _median(depth_m, axis=0))
    return depth_m / np.array([camera.K[0, 0] for camera in rig.cameras])


def _median(values: Float[np.ndarray, "*shape"], axis: int) -> Float[np.ndarray, "*rest"]:
    """Median of what is known, NaN where nothing is."""
    ordered = np.sort(values, axis=axis)  # NaN comes last
    middle = np.maximum(np.isfinite(values).sum(axis=axis, keepdims=True) - 1, 0) // 2
    return np.take_along_axis(ordered, middle, axis=axis).squeeze(axis)


def disagreement(
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

    def of_side(side: tuple[int, ...]) -> Float[np.ndarray, " frame"]:
        first, second = (np.array(side)[views] for views in pairs.T)
        by_proposal = missed[:, proposal, :, first, second][..., camera, side].sum(axis=-1)
        best = by_proposal.min(axis=0)
        return np.where(np.isfinite(best), best, 0.0).sum(axis=-1)

    both = [(tuple(state.tolist()), tuple((1 - state).tolist())) for state in states]
    costs = {side: of_side(side) for side in {side for sides in both for side in sides}}
    return np.stack([costs[left] + costs[right] for left, right in both], axis=-1)


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
    error_px = norm(projected_px[..., None, :] - seen_px)
    cost = misfit_of(error_px * metres_per_px[:, None, None, None, None, :, None])
    cost = cost * np.moveaxis(weights, 1, 2)[:, None, :, None, None]
    possible = np.asarray(np.isfinite(proposals_m).all(axis=-1))
    return np.where(possible[..., None, None], cost, np.inf)


def misfit_of(off_m: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """How much a detection that is so far off does not fit: from 0 to 1."""
    return _truncated(off_m / _AGREEMENT_M)


def _truncated(ratio: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Square, at most 1; 1 also where nothing is known."""
    return np.where(ratio < 1.0, ratio**2, 1.0)


def log_change(
    points_px: Float[np.ndarray, "*frames camera pair side 2"],
    weights: Float[np.ndarray, "*frames camera pair side"],
    before_px: Float[np.ndarray, "*frames camera pair side 2"],
    before_weights: Float[np.ndarray, "*frames camera pair side"],
    passed_s: Float[np.ndarray, "*frames camera pair side"],
    step_s: Float[np.ndarray, "*frames 1"],
    metres_per_px: Float[np.ndarray, "*frames camera"],
) -> Float[np.ndarray, "*frames camera before after"]:
    """Log probability that each camera is flipped or not, given whether it was in the frame before. It counts how often
    flips begin and end, and how far each joint has jumped since it was last seen, exchanged or not.

    Args:
        points_px, weights: detections.
        before_px, before_weights: where each joint was seen last, undistorted; without weight: never.
        passed_s: since then.
        step_s: since the frame before.
        metres_per_px: at the person.
    """
    reach_m = _STILL_M + _SPEED_M_PER_S * passed_s

    def jump(side: list[int]) -> Float[np.ndarray, "*frames camera"]:
        distance_m = norm(points_px - before_px[..., side, :]) * metres_per_px[..., None, None]
        counts = np.minimum(weights, before_weights[..., side])
        return np.sum(_truncated(distance_m / reach_m[..., side]) * counts, axis=(-1, -2))

    # After a long step it is as in the first frame.
    changed = -np.expm1(-(_BEGIN_PER_S + _END_PER_S) * step_s)
    begin, end = _SHARE * changed, (1.0 - _SHARE) * changed
    stay, switch = jump([0, 1]), jump([1, 0])
    with np.errstate(divide="ignore"):
        none = [np.log(1.0 - begin) - stay, np.log(begin) - switch]
        flip = [np.log(end) - switch, np.log(1.0 - end) - stay]
    return np.stack([np.stack(none, axis=-1), np.stack(flip, axis=-1)], axis=-2)


def of_states(
    log_change: Float[np.ndarray, "camera before after"], states: Int[np.ndarray, "state camera"]
) -> Float[np.ndarray, "state state"]:
    """The same from each state to each."""
    return log_change[np.arange(states.shape[1]), states[:, None], states[None]].sum(axis=-1)


def log_prior(states: Int[np.ndarray, "state camera"]) -> Float[np.ndarray, " state"]:
    """Log probability of each state in the first frame."""
    return np.asarray(np.where(states == 1, np.log(_SHARE), np.log(1.0 - _SHARE)).sum(axis=-1))
