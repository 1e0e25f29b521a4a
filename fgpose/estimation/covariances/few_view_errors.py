"""Errors of which the graph does not know: of all cameras together, of joints that fewer than two see, and of those of
which cameras say different things."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.estimation.covariances.other_side import SteadyDistances, other_points_m, other_side_m2, rays_to
from fgpose.estimation.covariances.uncertainty import at_least, holders
from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.noise import ROUNDING
from fgpose.estimation.visibility.agreement import BONE_M, log_likelihood_of_bones
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate_robust
from fgpose.geometry.vectors import norm
from fgpose.skeleton import Skeleton

_AGREES = 3.0  # standard deviations of a detection from the place that it and others show
# Of joints that one camera alone shows, and that others contradict: behind occluders BlazePose hallucinates 3 to 9 % of
# those of which it seems to be sure.
_LEAST_DOUBT = 0.05
_ONE_PLACE_SIGMAS = 2.8  # two detections of one point are nearer to each other, 98 in 100 times


def widened(
    covariance_m2: Float[np.ndarray, "frame joint 3 3"],
    evidence: Evidence,
    positions_m: Float[np.ndarray, "frame joint 3"],
    lasting: Float[np.ndarray, " joint"],
    rig: CameraRig,
    skeleton: Skeleton,
    distances: SteadyDistances | None = None,
) -> Float[np.ndarray, "frame joint 3 3"]:
    """The covariance of the graph with what it does not know: what cameras that all stand a little wrong do, the errors
    of joints that fewer than two cameras surely see, and that others may be right than those that are believed.

    Args:
        covariance_m2: of the graph.
        evidence: what it was found from.
        positions_m: the pose.
        lasting: variance of the lasting errors of each joint's detections, in that of the graph.
        rig: the cameras.
        skeleton: for the bones.
        distances: what was learned of them; None: these frames tell.
    """
    covariance_m2 = at_least(covariance_m2, evidence.bias_m2)
    if not evidence.observed.all():
        least_m2 = sole_view_errors_m2(evidence, positions_m, lasting, rig)
        covariance_m2 = at_least(covariance_m2, least_m2) + other_explanations_m2(evidence, positions_m, rig, skeleton)
    covariance_m2 = covariance_m2 + contradicted_m2(evidence, positions_m, rig, skeleton)
    return covariance_m2 + taken_for_mirrored_m2(evidence, positions_m, rig, skeleton, distances)


def contradicted_m2(
    evidence: Evidence, positions_m: Float[np.ndarray, "frame joint 3"], rig: CameraRig, skeleton: Skeleton
) -> Float[np.ndarray, "frame joint 3 3"]:
    """Second moment of where each joint would be if the detections that were taken for hallucinated were right, where
    these agree on a place where the joint may be, and are as many as those that are believed: a network guesses alike
    in cameras that stand alike. 0 for all other joints, and for those that fewer than two cameras see."""
    moment_m2 = np.zeros((*positions_m.shape, 3))
    believed = evidence.believed
    rejected, n_believed = evidence.detected & ~believed, believed.sum(axis=1)
    frames, joints = np.nonzero(evidence.observed & (rejected.sum(axis=1) >= n_believed))
    if not len(frames):
        return moment_m2

    def of_points(array: np.ndarray) -> np.ndarray:
        return array[frames, :, joints][:, :, None]

    sigma_px = of_points(evidence.sigma_px)
    weights = of_points(rejected).astype(float)
    place = triangulate_robust(of_points(evidence.undistorted_px), weights, rig, _AGREES * sigma_px)
    agree = place.inliers.swapaxes(1, 2)
    as_many = agree[:, :, 0].sum(axis=1) >= n_believed[frames, joints]
    places_m, at = place.positions_m[as_many], (frames[as_many], joints[as_many])
    own_m2 = _place_m2(places_m, agree[as_many], sigma_px[as_many], _reach_m(positions_m, skeleton)[at], rig)
    sigma_m = np.sqrt(BONE_M**2 + np.trace(own_m2, axis1=1, axis2=2) / 3)[:, None]
    # Two hallucinated rays meet somewhere now and then, and seldom where a limb may be.
    likely = np.exp(log_likelihood_of_bones(places_m[:, 0], sigma_m, positions_m, at, skeleton))
    off_m = np.nan_to_num(places_m[:, 0] - positions_m[at])
    share = likely / (1 + likely)
    moment_m2[at] = share[:, None, None] * (off_m[:, :, None] * off_m[:, None] + own_m2)
    return moment_m2


def _place_m2(
    place_m: Float[np.ndarray, "point 1 3"],
    agree: Bool[np.ndarray, "point camera 1"],
    sigma_px: Float[np.ndarray, "point camera 1"],
    reach_m: Float[np.ndarray, " point"],
    rig: CameraRig,
) -> Float[np.ndarray, "point 3 3"]:
    """Covariance of a place that these views show, no larger than the reach."""
    rays = rays_to(place_m, rig)
    information = np.where(agree, (rig.px_per_m(place_m) / sigma_px) ** 2, 0.0)
    across = np.eye(3) - rays[..., :, None] * rays[..., None, :]
    least = np.eye(3) / np.maximum(reach_m, ROUNDING)[:, None, None] ** 2
    return np.linalg.inv(np.nan_to_num(np.einsum("pcj,pcjik->pik", information, across)) + least)


def sole_view_errors_m2(
    evidence: Evidence,
    positions_m: Float[np.ndarray, "frame joint 3"],
    lasting: Float[np.ndarray, " joint"],
    rig: CameraRig,
) -> Float[np.ndarray, "frame joint 3 3"]:
    """Covariance of the error of every joint that one camera alone sees: along the ray that of a depth that follows
    from bone lengths, across it that of a detection, for no other one averages its errors out. 0 for the others.

    The graph takes errors of consecutive frames for independent. Those of a depth from bone lengths last for seconds;
    those of a view's own 3D do not.
    """
    sigma_m = np.where(evidence.sole_view, evidence.detection_sigma_px / rig.px_per_m(positions_m), np.nan)
    across_m2 = np.nan_to_num(lasting * sigma_m**2)
    depth_m2 = np.zeros_like(across_m2)
    if evidence.depth_sigma_m.shape[1]:
        follows = (across_m2 > 0) & evidence.from_bones[:, None]
        depth_m2 = np.where(follows, np.nan_to_num(evidence.depth_sigma_m**2), 0.0)
    rays = rays_to(positions_m, rig)
    along = rays[..., :, None] * rays[..., None, :]
    errors_m2 = across_m2[..., None, None] * (np.eye(3) - along) + depth_m2[..., None, None] * along
    return np.asarray(errors_m2.sum(axis=1))


def other_explanations_m2(
    evidence: Evidence, positions_m: Float[np.ndarray, "frame joint 3"], rig: CameraRig, skeleton: Skeleton
) -> Float[np.ndarray, "frame joint 3 3"]:
    """Second moment of where each joint would be if the detections that were taken for hallucinated were right, while
    fewer than two others are believed: of views that contradict each other, it is known with the probability of the one
    that is believed which one is right. 0 for joints that two cameras see, or of which a view's own 3D tells it.

    A joint is not farther off than to where it may have swung around its neighbours.
    """
    undecided = ~evidence.observed & ~evidence.has_measured_depth
    rejected = evidence.detected & ~evidence.believed & undecided[:, None]
    off_m = np.zeros((*rejected.shape, 3))
    for number, camera in enumerate(rig.cameras):
        offset_m, ray = camera.position_m - positions_m, camera.ray(evidence.undistorted_px[:, number])
        to_ray_m = offset_m - np.sum(offset_m * ray, axis=-1, keepdims=True) * ray
        off_m[:, number] = np.where(rejected[:, number, :, None], to_ray_m, 0.0)
    off_m = np.nan_to_num(off_m)
    distance_m = norm(off_m)
    reach_m = _reach_m(positions_m, skeleton)[:, None]
    off_m *= np.divide(reach_m, distance_m, out=np.ones_like(distance_m), where=distance_m > reach_m)[..., None]
    # Nothing is more likely than the estimate.
    n_rejected = rejected.sum(axis=1)
    doubt = np.maximum(1 - np.max(evidence.visibility, axis=1, where=evidence.believed, initial=0.0), _LEAST_DOUBT)
    share = np.minimum(doubt / np.maximum(n_rejected, 1), 1 / (1 + n_rejected))
    return share[..., None, None] * np.einsum("tcji,tcjk->tjik", off_m, off_m)


def taken_for_mirrored_m2(
    evidence: Evidence,
    positions_m: Float[np.ndarray, "frame joint 3"],
    rig: CameraRig,
    skeleton: Skeleton,
    distances: SteadyDistances | None = None,
) -> Float[np.ndarray, "frame joint 3 3"]:
    """Second moment of where each joint would be if all views but one had taken the one on the other side of the body
    for it. That may be so where both are detected in one place, as every view from the side shows them: then it is as
    likely as the estimate, unless the distances within a head or a trunk tell. 0 for all other joints.

    Args:
        evidence, positions_m, rig, skeleton: as for widened.
        distances: what was learned of them; None: these frames tell.
    """
    mirror, in_one_place = skeleton.mirror, _in_one_place(evidence, skeleton)
    others = evidence.believed & ~in_one_place
    doubtful = in_one_place.any(axis=1) & (others.sum(axis=1) == 1)
    if not doubtful.any():
        return np.zeros((*positions_m.shape, 3))
    if distances is None:
        distances = SteadyDistances(skeleton.n_joints)
        distances.learn(positions_m, told_apart(evidence, skeleton))
    ray = np.sum(np.where(others[..., None], rays_to(positions_m, rig), 0.0), axis=1)
    share = np.zeros(doubtful.shape)
    for joint, holder in holders(skeleton):
        frames = np.flatnonzero(doubtful[:, joint])
        if len(frames):
            sure = evidence.observed[frames] & ~doubtful[frames]
            sure[:, mirror[joint]] = evidence.observed[frames, mirror[joint]]  # both are not taken for each other
            pose_m = positions_m[frames]
            odds = distances.log_odds(joint, other_points_m(joint, holder, ray[frames], pose_m), pose_m, sure)
            share[frames, joint] = 1 / (1 + np.exp(np.maximum(-odds, 0.0)))  # nothing is more likely than the estimate
    return other_side_m2(share, ray, positions_m, skeleton)


def told_apart(evidence: Evidence, skeleton: Skeleton) -> Bool[np.ndarray, "frame joint"]:
    """The joints that two cameras see, and not in one place with the one on the other side of the body."""
    return evidence.observed & ~_in_one_place(evidence, skeleton).any(axis=1)


def _in_one_place(evidence: Evidence, skeleton: Skeleton) -> Bool[np.ndarray, "frame camera joint"]:
    """Where both joints of a pair are detected so near to each other that they may be one."""
    mirror = skeleton.mirror
    apart_px = norm(evidence.undistorted_px - evidence.undistorted_px[:, :, mirror])
    return np.asarray((apart_px < _ONE_PLACE_SIGMAS * evidence.sigma_px) & (mirror != np.arange(len(mirror))))


def _reach_m(positions_m: Float[np.ndarray, "frame joint 3"], skeleton: Skeleton) -> Float[np.ndarray, "frame joint"]:
    """How far from its estimate a joint may have swung: twice the longest bone at it; 0 where there is none."""
    longest_m, length_m = np.zeros(positions_m.shape[:2]), np.nan_to_num(skeleton.bone_lengths(positions_m))
    for bone, ends in enumerate(skeleton.bones):
        for joint in ends:
            longest_m[:, joint] = np.maximum(longest_m[:, joint], length_m[:, bone])
    return 2 * longest_m
