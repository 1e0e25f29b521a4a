"""Views in which a network has exchanged the left and the right side of the body, of the arms or of the legs alone.

The forward-backward algorithm (Rabiner 1989) gives the probability that a view is flipped, given the whole recording
(see flip_model). Where left and right coincide in the image there is no evidence of a flip, and none is found. A body
that is hallucinated fits neither way: a flip is believed only where the other views confirm it. Flips of the whole body
are corrected first; then each set of limbs is judged alone by the same model.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.estimation.evidence.image_checks.flip_model import (
    INLIER_PX,
    disagreement,
    log_change,
    log_prior,
    metres_per_px,
    misfit_of,
    of_states,
    possible_states,
)
from fgpose.estimation.evidence.image_checks.sides import (
    Sides,
    can_tell,
    exchanged,
    exchanged_joints,
    limbs,
    sides_of,
    with_sides_exchanged,
)
from fgpose.estimation.initial_guess import time_to_known_s
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate_robust
from fgpose.geometry.vectors import norm
from fgpose.observations import Observations
from fgpose.sampling import parts_of, stretches

SURE = 0.9
"""A view that is flipped with at least this probability is corrected. Detections of an uncertain one keep their weight:
errors are smaller with it than without."""
# Of the joints of a view whose sides are apart: so many more fit exchanged than as they are, by the other views. Of
# hallucinated bodies 0.05 and less, of exchanged ones 0.12 and more.
_CONFIRMED_SHARE, _APART_M, _FEWEST = 0.1, 0.08, 3
# With two cameras there is no other view: this share of the joints of the limbs has to be judged, and nearly all of
# them to fit. Of hallucinated bodies 0.32 and more do not, and hallucinated limbs meet by chance in the plane of both
# cameras.
_JUDGED_SHARE, _FITS_SHARE = 0.5, 0.25
_AROUND_S, _DOUBT = 0.5, 0.5  # of a suspicious frame: flips begin and end where left and right coincide
# Where more of the joints of limbs than these are where those of the other side were, all views are exchanged, or they
# were: in 55 images of 27 recordings with hallucinated bodies or two cameras, in none of 63 others. Which of the two it
# is tell the images around, for flips are rare and short.
_SWITCH_SHARE, _UNTIL_THEY_SWITCH_BACK_S = 0.3, 10.0
_ROUNDS = 3  # in a rig of more than six cameras two flips are found in each
TWO = 2
"""Cameras, without another one that could judge them."""
_FRAMES_AT_ONCE, _MOST_FRAMES = 200, 5000  # bound memory
_OVERLAP = 100  # frames, of flips that begin before such a part


def correct_flips(
    observations: Observations, rig: CameraRig
) -> tuple[Observations, Bool[np.ndarray, "frame camera joint"]]:
    """The observations with left and right exchanged where they are flipped (flips), and where that is. Raises
    ValueError: the cameras of the observations and of the rig differ."""
    flipped = flips(observations, rig)
    return with_sides_exchanged(observations, flipped) if flipped.any() else observations, flipped


def flips(observations: Observations, rig: CameraRig) -> Bool[np.ndarray, "frame camera joint"]:
    """The joints of each view that are exchanged with those of the other side.

    A camera can only be judged by others. With one camera nothing is found; with two that disagree, only the frames
    before and after tell which one is wrong.

    Raises:
        ValueError: the cameras of the observations and of the rig differ.
    """
    observations.check_cameras(rig.names)
    flipped = np.zeros(observations.confidence.shape, dtype=bool)
    if not can_tell(observations.skeleton, rig, TWO):
        return flipped
    for start, stop in _suspicious_parts(observations, rig):
        for part in parts_of(stop - start, _MOST_FRAMES):
            own = slice(start + part.start, start + part.stop)
            around = slice(max(own.start - _OVERLAP, start), min(own.stop + _OVERLAP, stop))
            found = _flips(observations.frames(around), rig)
            flipped[own] = found[own.start - around.start : own.stop - around.start]
    return flipped


def _flips(observations: Observations, rig: CameraRig) -> Bool[np.ndarray, "frame camera joint"]:
    points_px, weights = limbs(observations, rig)
    all_sides = sides_of(observations.skeleton)
    flipped = np.zeros((*weights.shape[:2], len(all_sides)), dtype=bool)
    for number, sides in enumerate(all_sides):
        own_px, own = points_px[:, :, sides.pairs], weights[:, :, sides.pairs]
        # Of a large rig only a few flipped cameras are considered at once; correcting them helps to find the others.
        for _ in range(_ROUNDS):
            found = _probability(own_px, own, observations.frame_time_s, rig) > SURE
            found = confirmed(own_px, own, found, rig)
            if not found.any():
                break
            own_px, own = exchanged(own_px, found), exchanged(own, found)
            flipped[..., number] ^= found
        points_px[:, :, sides.pairs], weights[:, :, sides.pairs] = own_px, own
    return exchanged_joints(flipped, observations.skeleton)


def _suspicious_parts(observations: Observations, rig: CameraRig) -> list[tuple[int, int]]:
    """The frames near those in which a camera fits the others better with its sides exchanged, in which no more than
    two show anybody, for one that is exchanged moves what they tell, or in which all views change sides together."""
    suspicious, switches = np.zeros((2, observations.n_frames), dtype=bool)
    last_m: np.ndarray | None = None
    for part in parts_of(observations.n_frames, _FRAMES_AT_ONCE):
        points_px, weights = limbs(observations.frames(part), rig)
        shows = weights.any(axis=(2, 3))
        met_m, all_sides = _met_m(points_px, weights, rig), sides_of(observations.skeleton)
        last_m = met_m[:1] if last_m is None else last_m
        suspicious[part] = (shows.sum(axis=1) == TWO) | suspicious_sides(points_px, met_m, rig, all_sides).any((1, 2))
        switches[part], last_m = _switch(np.concatenate([last_m, met_m])), met_m[-1:]
    suspicious |= time_to_known_s(switches[:, None], observations.frame_time_s)[:, 0] <= _UNTIL_THEY_SWITCH_BACK_S
    around_s = time_to_known_s(suspicious[:, None], observations.frame_time_s)[:, 0]
    return stretches(around_s <= _AROUND_S)


def _switch(
    positions_m: Float[np.ndarray, "frame pair side 3"],
) -> Bool[np.ndarray, " _frame"]:
    """In which frames but the first limbs are where those of the other side were just before, which nobody can do."""
    now_m, before_m = positions_m[1:], positions_m[:-1]
    own_m, other_m = (norm(now_m - side_m) for side_m in (before_m, before_m[:, :, ::-1]))
    n_known, n_switch = (of.sum(axis=(1, 2)) for of in (np.isfinite(own_m + other_m), own_m > other_m + _APART_M))
    return (n_known >= _FEWEST) & (n_switch > _SWITCH_SHARE * n_known)


def suspicious_sides(
    points_px: Float[np.ndarray, "frame camera pair side 2"],
    positions_m: Float[np.ndarray, "frame pair side 3"],
    rig: CameraRig,
    all_sides: Sequence[Sides],
) -> Bool[np.ndarray, "frame camera sides"]:
    """Which views fit limbs at these positions better with which of these sides exchanged."""
    misfit, other_way, _ = _misfits(points_px, positions_m, rig)
    better = misfit - other_way
    return np.stack([better[:, :, sides.pairs].sum(axis=2) > _DOUBT for sides in all_sides], axis=2)


def confirmed(
    points_px: Float[np.ndarray, "frame camera pair side 2"],
    weights: Float[np.ndarray, "frame camera pair side"],
    found: Bool[np.ndarray, "frame camera"],
    rig: CameraRig,
) -> Bool[np.ndarray, "frame camera"]:
    """Those of the flips, from their beginning to their end, whose views clearly fit the others when exchanged.

    Args:
        points_px, weights: of the limbs that are exchanged together; see limbs.
        found: the views that are flipped.
        rig: the cameras.
    """
    sure, others_px, others = np.zeros_like(found), exchanged(points_px, found), exchanged(weights, found)
    for camera in np.flatnonzero(found.any(axis=0)).tolist():
        frames = np.flatnonzero(found[:, camera])
        by_others = others[frames]
        if rig.n_cameras > TWO:
            by_others[:, camera] = 0.0
        met_m = _met_m(others_px[frames], by_others, rig)
        misfits = (each[:, camera].sum(axis=1) for each in _misfits(points_px[frames], met_m, rig))
        begins = np.flatnonzero(np.diff(frames, prepend=-TWO) > 1)
        misfit, other_way, judged = (np.add.reduceat(each, begins) for each in misfits)
        clear = (judged >= _FEWEST) & (misfit - other_way > _CONFIRMED_SHARE * judged)
        lengths = np.diff(begins, append=len(frames))
        if rig.n_cameras == TWO:
            n_joints = np.prod(weights.shape[2:])
            clear &= (judged >= _JUDGED_SHARE * n_joints * lengths) & (other_way < _FITS_SHARE * judged)
        sure[frames, camera] = np.repeat(clear, lengths)
    return sure


def _met_m(
    points_px: Float[np.ndarray, "frame camera pair side 2"],
    weights: Float[np.ndarray, "frame camera pair side"],
    rig: CameraRig,
) -> Float[np.ndarray, "frame pair side 3"]:
    """Where the views agree, by these weights; NaN where they do not."""
    shape = *weights.shape[:2], int(np.prod(weights.shape[2:]))
    met = triangulate_robust(points_px.reshape(*shape, 2), weights.reshape(shape), rig, rig.in_own_px(INLIER_PX))
    return met.positions_m.reshape(len(weights), *weights.shape[2:], 3)


def _misfits(
    points_px: Float[np.ndarray, "frame camera pair side 2"],
    positions_m: Float[np.ndarray, "frame pair side 3"],
    rig: CameraRig,
) -> tuple[
    Float[np.ndarray, "frame camera pair"], Float[np.ndarray, "frame camera pair"], Int[np.ndarray, "frame camera pair"]
]:
    """How many joints of each view do not fit limbs at these positions, as they are and with left and right exchanged;
    those that fit roughly count in part. And of how many, whose sides are apart in the image."""
    joints_m = positions_m.reshape(len(positions_m), -1, 3)
    projected_px, px_per_m = rig.project(joints_m).reshape(points_px.shape), rig.px_per_m(joints_m)
    px_per_m = px_per_m.reshape(points_px.shape[:-1])
    apart_m = norm(projected_px[..., 0, :] - projected_px[..., 1, :])[..., None] / px_per_m
    judged = np.asarray(np.isfinite(points_px).all(axis=(-1, -2)))[..., None] & (apart_m > _APART_M)

    def misfit(seen_px: np.ndarray) -> Float[np.ndarray, "frame camera pair"]:
        off_m = norm(projected_px - seen_px) / px_per_m
        return np.asarray(np.where(judged, misfit_of(off_m), 0.0).sum(axis=3))

    return misfit(points_px), misfit(points_px[..., ::-1, :]), judged.sum(axis=3)


def flip_probability(observations: Observations, rig: CameraRig) -> Float[np.ndarray, "frame camera"]:
    """Probability that each view has left and right of the whole body exchanged; 0 where it sees nothing of the
    limbs."""
    if not can_tell(observations.skeleton, rig, TWO):
        return np.zeros((observations.n_frames, rig.n_cameras))
    return _probability(*limbs(observations, rig), observations.frame_time_s, rig)


def _probability(
    points_px: Float[np.ndarray, "frame camera pair side 2"],
    weights: Float[np.ndarray, "frame camera pair side"],
    time_s: Float[np.ndarray, " frame"],
    rig: CameraRig,
) -> Float[np.ndarray, "frame camera"]:
    states = possible_states(rig.n_cameras)
    scale = metres_per_px(points_px, weights, rig)
    cost = np.concatenate(
        [
            disagreement(points_px[part], weights[part], scale[part], rig, states)
            for part in parts_of(len(points_px), _FRAMES_AT_ONCE)
        ]
    )
    last = _last_seen(weights > 0)
    known, last = last >= 0, np.maximum(last, 0)
    before_px = np.take_along_axis(points_px, last[..., None], axis=0)
    before_weights = np.where(known, np.take_along_axis(weights, last, axis=0), 0.0)
    passed_s, step_s = time_s.reshape(-1, 1, 1, 1) - time_s[last], np.diff(time_s, prepend=time_s[0])[:, None]
    change = log_change(points_px, weights, before_px, before_weights, passed_s, step_s, scale)
    posterior = _forward_backward(-cost, change, states)
    return np.where(weights.any(axis=(2, 3)), posterior @ states, 0.0)


def _last_seen(seen: Bool[np.ndarray, "frame camera pair side"]) -> Int[np.ndarray, "frame camera pair side"]:
    """The last frame before each in which something was seen; -1 where there is none."""
    frame = np.arange(len(seen))[:, None, None, None]
    latest = np.maximum.accumulate(np.where(seen, frame, -1), axis=0)
    return np.concatenate([np.full((1, *seen.shape[1:]), -1), latest[:-1]])


def _forward_backward(
    log_likelihood: Float[np.ndarray, "frame state"],
    change: Float[np.ndarray, "frame camera before after"],
    states: Int[np.ndarray, "state camera"],
) -> Float[np.ndarray, "frame state"]:
    """Probability of each state in each frame, given all frames; logarithms in, probabilities out."""
    forward, backward = log_likelihood.copy(), np.zeros_like(log_likelihood)
    forward[0] += log_prior(states)
    for t in range(1, len(forward)):
        forward[t] += np.logaddexp.reduce(forward[t - 1][:, None] + of_states(change[t], states), axis=0)
    for t in reversed(range(1, len(forward))):
        backward[t - 1] = np.logaddexp.reduce(of_states(change[t], states) + log_likelihood[t] + backward[t], axis=1)
    total = forward + backward
    total = np.exp(total - total.max(axis=1, keepdims=True))
    return total / total.sum(axis=1, keepdims=True)
