"""New people: detections that belong to nobody, where several cameras agree on a body, or one tells how far it is."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.association.detectability import Blind, detection_probability
from fgpose.association.likelihood import Distances, log_ratio_of, score_of
from fgpose.association.matching import Moment
from fgpose.association.pose_filter import SIGMA_M, PoseFilters
from fgpose.correspondences import NOBODY
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.skeleton import Skeleton

# Rays of two views that meet under less than 3 degrees do not tell where.
_MIN_SIN2 = np.sin(np.deg2rad(3.0)) ** 2
# Unrelated rays miss each other by anything up to this.
_UNRELATED_M = 1.0
_MIN_JOINTS = 4
# No bone is longer than this; half of the joints of a body lie within these distances of their middle.
_LONGEST_BONE_M, _SMALLEST_BODY_M, _LARGEST_BODY_M = 0.75, 0.05, 1.3
# A joint that fewer than two cameras see is somewhere around the middle of the body.
_SOMEWHERE_M = 0.4
# Views that agree by chance once in a thousand moments are worth following for a while.
_MIN_SCORE = np.log(1e3)
MAX_GAIN = 2.0
"""One image does not tell more than this, however well it fits."""
# The diagonal of the box around somebody who stands is about as long as the person.
_BODY_M = 1.7
# Bound the time where an image has 200 candidates.
_MAX_PER_IMAGE, _MAX_PAIRS = 12, 12


@dataclass(frozen=True, eq=False)
class Founded:
    """Somebody new, and the detections that agree on them."""

    pose: PoseFilters
    chosen: Int[np.ndarray, " camera"]
    """Number of the detection in the image of each camera, or NOBODY."""
    score: float
    """Log of the ratio of probabilities, against that the detections have nothing to do with each other."""


def found(
    moment: Moment,
    known: PoseFilters | None,
    skeleton: Skeleton,
    blind: Blind | None = None,
    of_one_view: Bool[np.ndarray, "camera detection"] | None = None,
) -> list[Founded]:
    """People on whom at least two cameras agree, then those of whom one alone tells the distance; of each kind the most
    probable first. No detection is of two of them.

    Args:
        moment: the detections that are nobody's. A camera with an image that does not show somebody counts against
            them.
        known: those who are followed already; they may hide somebody.
        skeleton: the joints.
        blind: which cameras cannot be believed to see anybody; learns from what they show of those who are found.
        of_one_view: which detections are of somebody who is followed in this view alone: only with one that is nobody's
            do they make a body.
    """
    blind = blind or Blind(moment.cameras.names)
    people: list[Founded] = []
    free = _most_confident(np.asarray(np.isfinite(moment.points_px).all(axis=-1).any(axis=-1)), moment.confidence)
    of_one_view = np.zeros(free.shape, dtype=bool) if of_one_view is None else of_one_view
    for candidates, n_cameras, least, max_gain in ((_pairs, 2, _MIN_SCORE, np.inf), (_at_a_distance, 1, 0.0, MAX_GAIN)):
        while np.count_nonzero(free.any(axis=1)) >= n_cameras:
            rest = moment.without(~free)
            bodies = candidates(rest, free, of_one_view, skeleton)
            if not len(bodies.score):
                break
            best = _best_supported(bodies, rest, known, max_gain, blind)
            if best.score < least:
                break
            people.append(best)
            # What fits somebody is theirs, or of them once more.
            expected = best.pose.seen_by(rest.cameras, rest.times_s)
            free &= ~rest.likelihood(expected).fits[:, 0]
            camera = np.flatnonzero(best.chosen != NOBODY)
            free[camera, best.chosen[camera]] = False
    return people


def found_alone(moment: Moment) -> list[Founded]:
    """People in the image of the only camera there is: at the distance that it tells, else where their boxes are as
    large as a body."""
    (camera,) = moment.cameras.cameras
    people = []
    for number, points_px in enumerate(moment.points_px[0]):
        known = np.isfinite(points_px).all(axis=-1)
        if known.sum() < min(_MIN_JOINTS, len(known)):
            continue
        if moment.tells_distance[0, number].sum() >= min(_MIN_JOINTS, len(known)):
            joints_m, score = _joints_m(moment, 0, number), MAX_GAIN
        else:
            size_px = float(np.linalg.norm(np.ptp(points_px[known], axis=0)))
            rays = _rays(camera, points_px)
            # Along the axis of the camera a step of 1 for all joints, so that they lie in one plane.
            in_plane = rays / (rays @ camera.world_T_camera[:3, 2])[:, None]
            distance_m = np.sqrt(camera.K[0, 0] * camera.K[1, 1]) * _BODY_M / max(size_px, 1.0)
            joints_m, score = camera.position_m + distance_m * in_plane, 0.0
        pose = _first_guess(joints_m, moment.time_s)
        people.append(Founded(_updated(pose, np.array([[number]]), moment), np.array([number]), score))
    return people


def _most_confident(
    free: Bool[np.ndarray, "camera detection"], confidence: Float[np.ndarray, "camera detection"]
) -> Bool[np.ndarray, "camera detection"]:
    """As many of every image as can be tried."""
    rank = np.argsort(np.argsort(-np.where(free, confidence, -np.inf), axis=1), axis=1)
    return free & (rank < _MAX_PER_IMAGE)


@dataclass(frozen=True, eq=False)
class _Bodies:
    """Where there may be somebody."""

    chosen: Int[np.ndarray, "body camera"]
    """Number of the detection in the image of each camera that is taken for theirs, or NOBODY."""
    joints_m: Float[np.ndarray, "body joint 3"]
    score: Float[np.ndarray, " body"]
    """Of these detections, as of Founded."""
    preferred: Float[np.ndarray, " body"]
    """Which of two is right, as far as that tells nothing of whether any is: views that disagree on the distance may
    both be wrong about it."""


def _pairs(
    moment: Moment,
    free: Bool[np.ndarray, "camera detection"],
    of_one_view: Bool[np.ndarray, "camera detection"],
    skeleton: Skeleton,
) -> _Bodies:
    """Two detections of different cameras whose rays meet in a body; only the best."""
    candidates = np.argwhere(free)
    pairs = np.array(list(combinations(range(len(candidates)), 2)))
    of_one_camera = np.equal(*candidates[pairs, 0].T)
    both_are_followed = of_one_view[tuple(candidates.T)][pairs].all(axis=1)
    pairs = pairs[~of_one_camera & ~both_are_followed]
    rays = np.stack(
        [_rays(camera, points) for camera, points in zip(moment.cameras.cameras, moment.points_px, strict=True)]
    )
    origin_m = moment.cameras.positions_m
    camera, detection = np.moveaxis(candidates[pairs], -1, 0)
    (origin_a_m, origin_b_m), (a, b) = np.moveaxis(origin_m[camera], 1, 0), np.moveaxis(rays[camera, detection], 1, 0)
    joints_m, distance_m = meeting(origin_a_m, a, origin_b_m, b)
    n_known = np.isfinite(distance_m).sum(axis=1)
    spread_m = np.sqrt(2) * SIGMA_M
    peak = np.log(2 * _UNRELATED_M / (np.sqrt(2 * np.pi) * spread_m))
    score = score_of(peak - 0.5 * (distance_m / spread_m) ** 2)
    possible = np.flatnonzero((n_known >= min(_MIN_JOINTS, skeleton.n_joints)) & (score > 0))
    possible = possible[_is_body(joints_m[possible], skeleton)]
    preferred = np.zeros(len(pairs))
    if moment.distances is not None:
        off_m2 = 2 * SIGMA_M**2 / np.maximum(1 - np.sum(a * b, axis=-1) ** 2, _MIN_SIN2)
        for side in range(2):
            preferred += _fit_of_distance(
                moment.distances, moment.cameras, candidates[pairs[:, side]], joints_m, off_m2
            )
    best = possible[np.argsort(-(score + preferred)[possible], kind="stable")][:_MAX_PAIRS]
    chosen = np.full((len(best), moment.cameras.n_cameras), NOBODY)
    for side in range(2):
        chosen[np.arange(len(best)), camera[best, side]] = detection[best, side]
    return _Bodies(chosen, joints_m[best], score[best], preferred[best])


def _fit_of_distance(
    distances: Distances,
    cameras: CameraRig,
    candidates: Int[np.ndarray, "body 2"],
    joints_m: Float[np.ndarray, "body joint 3"],
    off_m2: Float[np.ndarray, "body joint"],
) -> Float[np.ndarray, " body"]:
    """Log of the ratio of probabilities that a detection is of a body, by the distance that its camera tells.

    Args:
        distances: of the detections.
        cameras: that have them.
        candidates: camera and detection, for each body.
        joints_m: of the bodies.
        off_m2: variance of the distances of these.
    """
    camera, detection = candidates.T
    position_m = np.stack([each.position_m for each in cameras.cameras])[camera]
    distance_m = np.linalg.norm(joints_m - position_m[:, None], axis=-1)
    told_m, variance_m2 = distances.distance_m[camera, detection], distances.variance_m2[camera, detection]
    return score_of(log_ratio_of(told_m - distance_m, variance_m2 + off_m2, distance_m)[..., None])


def _at_a_distance(
    moment: Moment,
    free: Bool[np.ndarray, "camera detection"],
    of_one_view: Bool[np.ndarray, "camera detection"],
    skeleton: Skeleton,
) -> _Bodies:
    """Detections of which the camera tells the distance, and which make a body there."""
    enough = moment.tells_distance.sum(axis=-1) >= min(_MIN_JOINTS, skeleton.n_joints)
    camera, detection = np.nonzero(free & ~of_one_view & enough)
    joints_m = np.full((len(camera), *moment.points_px.shape[2:3], 3), np.nan)
    for n, (c, number) in enumerate(zip(camera.tolist(), detection.tolist(), strict=True)):
        joints_m[n] = _joints_m(moment, c, number)
    body = np.flatnonzero(_is_body(joints_m, skeleton))
    chosen = np.full((len(body), moment.cameras.n_cameras), NOBODY)
    chosen[np.arange(len(body)), camera[body]] = detection[body]
    return _Bodies(chosen, joints_m[body], np.full(len(body), MAX_GAIN), np.zeros(len(body)))


def _joints_m(moment: Moment, camera: int, detection: int) -> Float[np.ndarray, "joint 3"]:
    """World frame, at the distances that the camera tells; NaN where it does not."""
    assert moment.distances is not None
    seen_by, points_px = moment.cameras.cameras[camera], moment.points_px[camera, detection]
    return seen_by.position_m + moment.distances.distance_m[camera, detection, :, None] * _rays(seen_by, points_px)


def _rays(camera: Camera, points_px: Float[np.ndarray, "*points 2"]) -> Float[np.ndarray, "*points 3"]:
    """Unit vectors in the world frame."""
    slope = (points_px - camera.K[:2, 2]) / np.diag(camera.K)[:2]
    ray = np.concatenate([slope, np.ones_like(slope[..., :1])], axis=-1) @ camera.world_T_camera[:3, :3].T
    return ray / np.linalg.norm(ray, axis=-1, keepdims=True)


def meeting(
    a_m: Float[np.ndarray, "pair 3"],
    a: Float[np.ndarray, "pair joint 3"],
    b_m: Float[np.ndarray, "pair 3"],
    b: Float[np.ndarray, "pair joint 3"],
) -> tuple[Float[np.ndarray, "pair joint 3"], Float[np.ndarray, "pair joint"]]:
    """Where two rays are nearest to each other, and how near; NaN where they are parallel or go apart.

    Args:
        a_m, b_m: where the rays of each pair start, world frame.
        a, b: unit vectors along them.
    """
    apart_m = (a_m - b_m)[:, None]
    cosine, along_a, along_b = np.sum(a * b, -1), np.sum(a * apart_m, -1), np.sum(b * apart_m, -1)
    sin2 = np.asarray(1 - cosine**2)
    parallel = ~(sin2 > _MIN_SIN2)
    sin2 = np.where(parallel, 1.0, sin2)
    on_a_m, on_b_m = (cosine * along_b - along_a) / sin2, (along_b - cosine * along_a) / sin2
    point_a_m, point_b_m = a_m[:, None] + on_a_m[..., None] * a, b_m[:, None] + on_b_m[..., None] * b
    bad = parallel | ~(on_a_m > 0) | ~(on_b_m > 0)
    middle_m = np.where(bad[..., None], np.nan, (point_a_m + point_b_m) / 2)
    return middle_m, np.where(bad, np.nan, np.linalg.norm(point_a_m - point_b_m, axis=-1))


def _is_body(joints_m: Float[np.ndarray, "pair joint 3"], skeleton: Skeleton) -> Bool[np.ndarray, " pair"]:
    """Whether most bones are as short, and half of the joints as near to their middle, as those of a body."""
    length_m = skeleton.bone_lengths(joints_m)
    n_long, n_bones = np.sum(length_m > _LONGEST_BONE_M, axis=1), np.isfinite(length_m).sum(axis=1)
    # Who has no joint at all was left out before: there is a median.
    middle_m = np.nanmedian(joints_m, axis=1, keepdims=True) if len(joints_m) else joints_m
    reach_m = np.nanmedian(np.linalg.norm(joints_m - middle_m, axis=-1), axis=1) if len(joints_m) else np.zeros(0)
    return np.asarray((n_long <= n_bones / 4) & (reach_m > _SMALLEST_BODY_M) & (reach_m < _LARGEST_BODY_M))


def _best_supported(
    bodies: _Bodies, moment: Moment, known: PoseFilters | None, max_gain: float, blind: Blind
) -> Founded:
    """The body of which the other cameras tell most, each at most max_gain in its favour."""
    people = PoseFilters.stacked([_first_guess(joints, moment.time_s) for joints in bodies.joints_m])
    chosen = bodies.chosen.copy()
    is_its_own = chosen != NOBODY
    people = _updated(people, chosen, moment)
    likelihood = moment.likelihood(people.seen_by(moment.cameras, moment.times_s))
    score_of = np.where(likelihood.fits_pixels, likelihood.score, -np.inf)
    best, gain = np.argmax(score_of, axis=-1).T, np.minimum(score_of.max(axis=-1).T, max_gain)
    supported = ~is_its_own & (gain > 0)
    chosen[supported] = best[supported]
    # Whom a camera shows there, but at another distance, is somebody else, or the distance is wrong.
    gain = np.where(likelihood.fits.any(axis=-1).T, gain, 0.0)
    names = moment.cameras.names
    probability = detection_probability(people, known, moment.cameras)
    missed = np.log1p(-blind.sees(names) * probability)
    total = bodies.score + np.where(is_its_own, 0.0, np.where(supported, gain, missed)).sum(axis=1)
    first = int(np.argmax(total + bodies.preferred))
    if bodies.score[first] >= _MIN_SCORE:
        blind.learn(names, moment.times_s, probability[first : first + 1], chosen[first : first + 1] != NOBODY)
    pose = _updated(_first_guess(bodies.joints_m[first], moment.time_s), chosen[first : first + 1], moment)
    return Founded(pose, chosen[first], float(total[first]))


def _first_guess(joints_m: Float[np.ndarray, "joint 3"], time_s: float) -> PoseFilters:
    """Hardly any information of its own: that comes from the detections."""
    known = np.asarray(np.isfinite(joints_m).all(axis=-1))
    covariance_m2 = np.where(known, 1.0, _SOMEWHERE_M**2)[:, None, None] * np.eye(3)
    return PoseFilters.at(time_s, np.where(known[:, None], joints_m, np.nanmedian(joints_m, axis=0)), covariance_m2)


def _updated(people: PoseFilters, chosen: Int[np.ndarray, "person camera"], moment: Moment) -> PoseFilters:
    expected, chosen = people.seen_by(moment.cameras, moment.times_s), chosen.T
    own = np.arange(len(chosen))[:, None], np.maximum(chosen, 0)

    def of_chosen(array: np.ndarray) -> np.ndarray:
        nothing = (chosen == NOBODY).reshape(*chosen.shape, *[1] * (array.ndim - 2))
        return np.where(nothing, np.nan, array[own])

    residual_px = of_chosen(moment.points_px) - expected.pixels
    distance = None if moment.distances is None else moment.distances.taken(of_chosen).against(expected)
    return people.updated(residual_px, expected, np.ones(residual_px.shape[:-1]), distance)
