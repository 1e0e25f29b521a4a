"""Joints that a network has put on the limb of the other side: both legs on one.

Such detections look like good ones, and two views that show the same agree. They are found where left and right are at
one place in an image, other views agree on a joint, and only that of the other side fits. Where few frames in a row
say so, it is noise of limbs that cover each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.estimation.evidence.image_checks.flip_model import INLIER_PX, metres_per_px
from fgpose.estimation.evidence.image_checks.sides import Limbs, Sides, can_tell, limb_joints, limbs, of_limb, sides_of
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate, triangulate_robust
from fgpose.geometry.vectors import norm
from fgpose.observations import Observations
from fgpose.sampling import nearest, parts_of, stretches
from fgpose.skeleton import Skeleton

# In metres at the person: limbs are 0.1 m thick, and views that agree miss each other by 10 to 40 mm.
_ONE_PLACE_M, _OFF_M, _USUAL_M, _TIMES = 0.06, 0.1, 0.025, 2.0
# Of the frames in a row, and more than one, unless it is alone. Limbs that cover each other say so in fewer; 0.15 finds
# a fifth less with three cameras.
_SAID_SHARE = 0.05
_FRAMES_AT_ONCE = 200  # bounds memory
_FEWEST = 3  # cameras: with two no others can agree


def on_other_side(observations: Observations, rig: CameraRig) -> Bool[np.ndarray, "frame camera joint"]:
    """The detections that are of the joint on the other side of the body."""
    found, all_limbs = np.zeros(observations.confidence.shape, dtype=bool), _limbs_of(observations.skeleton)
    if not can_tell(observations.skeleton, rig, _FEWEST):
        return found
    parts = list[tuple[np.ndarray, np.ndarray]]()
    for part in parts_of(observations.n_frames, _FRAMES_AT_ONCE):
        points_px, weights = limbs(observations.frames(part), rig)
        m_per_px = metres_per_px(points_px, weights, rig)
        at_one_place = _at_one_place(points_px, m_per_px)
        parts.append((at_one_place, _said(points_px, weights, at_one_place, m_per_px, all_limbs, rig)))
    at_one_place, said = (np.concatenate(each) for each in zip(*parts, strict=True))
    for number, limb in enumerate(all_limbs):
        own = np.zeros((*said.shape[:2], 2), dtype=bool)
        for camera in np.flatnonzero(said[:, :, number].any(axis=(0, 2))).tolist():
            for start, stop in stretches(np.asarray(at_one_place[:, camera, limb.pairs].any(axis=-1))):
                own[start:stop, camera] = _in_row(said[start:stop, camera, number])
        found |= _of_joints(own, at_one_place, limb, observations.skeleton)
    return found


@dataclass(frozen=True, eq=False)
class RunningOtherSide:
    """The same, image by image: of each limb, in how many frames in a row its joints are at one place."""

    n_frames: Int[np.ndarray, "camera limb"]
    n_said: Int[np.ndarray, "camera limb side"]
    """In how many of them it was said of a side."""
    last: Bool[np.ndarray, "camera limb side"]
    """Of which side it was said last."""

    @staticmethod
    def none(n_cameras: int, skeleton: Skeleton) -> RunningOtherSide:
        """Before the first image."""
        shape = n_cameras, len(_limbs_of(skeleton)), 2
        return RunningOtherSide(np.zeros(shape[:2], dtype=int), np.zeros(shape, dtype=int), np.zeros(shape, dtype=bool))

    def after(
        self, images: Observations, of_limbs: Limbs, expected_m: Float[np.ndarray, "joint 3"], rig: CameraRig
    ) -> tuple[Bool[np.ndarray, "camera joint"], RunningOtherSide]:
        """The same of the next images, and what is known after them.

        Args:
            images: of one frame; those that come one by one are not judged.
            of_limbs: what they show of the limbs; see limbs.
            expected_m: where the joints are expected, world frame; NaN where that is not known. Joints that all
                cameras detect where they are expected are not judged.
            rig: the cameras.
        """
        found = np.zeros(images.confidence.shape, dtype=bool)
        if not can_tell(images.skeleton, rig, _FEWEST) or images.seen[0].any(axis=-1).sum() < _FEWEST:
            return found[0], self
        all_limbs, limbs_m = _limbs_of(images.skeleton), expected_m[limb_joints(images.skeleton)].reshape(-1, 3)
        points_px, weights = of_limbs
        known = np.isfinite(limbs_m).all(axis=-1)
        if known.any():
            m_per_px = 1.0 / rig.px_per_m(limbs_m[known].mean(axis=0, keepdims=True)).T
        else:
            m_per_px = metres_per_px(points_px, weights, rig)
        at_one_place = doubtful = _at_one_place(points_px, m_per_px)
        if known.any() and at_one_place.any():
            off_px = norm(rig.project(limbs_m).reshape(points_px.shape) - points_px)
            is_off = ~(off_px * m_per_px[..., None, None] < _OFF_M) & (weights > 0)
            doubtful = at_one_place & np.asarray(is_off.any(axis=(1, 3)))[:, None]
        (said,) = _said(points_px, weights, doubtful, m_per_px, all_limbs, rig)
        goes_on = np.stack([at_one_place[0][:, limb.pairs].any(axis=-1) for limb in all_limbs], axis=-1)
        n_frames = np.where(goes_on, self.n_frames + 1, 0)
        n_said = np.where(goes_on[..., None], self.n_said + said, 0)
        last = np.where(said.any(axis=-1, keepdims=True), said, self.last & goes_on[..., None])
        enough = np.maximum(_SAID_SHARE * n_frames, 1)
        own = last & (n_said.sum(axis=-1) > enough)[..., None]
        for number, limb in enumerate(all_limbs):
            found |= _of_joints(own[None, :, number], at_one_place, limb, images.skeleton)
        return found[0], RunningOtherSide(n_frames, n_said, last)


def _limbs_of(skeleton: Skeleton) -> tuple[Sides, ...]:
    """The arms and the legs; the whole body where it has only one of them."""
    together = sides_of(skeleton)
    return together[1:] or together


def _of_joints(
    sides: Bool[np.ndarray, "frame camera side"],
    at_one_place: Bool[np.ndarray, "frame camera pair"],
    limb: Sides,
    skeleton: Skeleton,
) -> Bool[np.ndarray, "frame camera joint"]:
    """The joints of these sides of a limb that are at one place with those of the other side, and what hangs on
    them."""
    found = np.zeros((*sides.shape[:2], skeleton.n_joints), dtype=bool)
    found[:, :, limb_joints(skeleton)[limb.pairs]] = at_one_place[:, :, limb.pairs, None] & sides[:, :, None]
    return found[:, :, of_limb(skeleton)] & (of_limb(skeleton) >= 0)


def _in_row(said: Bool[np.ndarray, "frame side"]) -> Bool[np.ndarray, "frame side"]:
    """Of each of the frames in a row by the nearest one that says anything, if enough do."""
    (frames,) = np.nonzero(said.any(axis=-1))
    if len(frames) < len(said) and len(frames) <= max(_SAID_SHARE * len(said), 1):
        return np.zeros_like(said)
    return said[frames[nearest(np.arange(float(len(said))), frames.astype(float))]]


def _at_one_place(
    points_px: Float[np.ndarray, "frame camera pair side 2"], m_per_px: Float[np.ndarray, "frame camera"]
) -> Bool[np.ndarray, "frame camera pair"]:
    apart_px = norm(points_px[..., 0, :] - points_px[..., 1, :])
    return np.asarray(apart_px * m_per_px[..., None] < _ONE_PLACE_M)


def _said(
    points_px: Float[np.ndarray, "frame camera pair side 2"],
    weights: Float[np.ndarray, "frame camera pair side"],
    doubtful: Bool[np.ndarray, "frame camera pair"],
    m_per_px: Float[np.ndarray, "frame camera"],
    all_limbs: tuple[Sides, ...],
    rig: CameraRig,
) -> Bool[np.ndarray, "frame camera limb side"]:
    """The sides of limbs that are said to be on the other one by more of their doubtful joints than the contrary."""
    more = np.zeros(weights.shape, dtype=int)
    frames, pairs = np.nonzero(doubtful.any(axis=1))
    if len(frames):
        of_pairs = points_px[frames, :, pairs], weights[frames, :, pairs], doubtful[frames, :, pairs]
        only_other = _only_other(*of_pairs, m_per_px[frames], rig)
        more[frames, :, pairs] = only_other.astype(int) - only_other[..., ::-1]
    return np.stack([more[:, :, limb.pairs].sum(axis=2) > 0 for limb in all_limbs], axis=2)


def _only_other(
    points_px: Float[np.ndarray, "point camera side 2"],
    weights: Float[np.ndarray, "point camera side"],
    doubtful: Bool[np.ndarray, "point camera"],
    m_per_px: Float[np.ndarray, "point camera"],
    rig: CameraRig,
) -> Bool[np.ndarray, "point camera side"]:
    """Which doubtful detections miss those of the other views, of which most agree, by so much more than these miss
    each other, where the detection of the other side fits. Where only two opposite cameras agree, on any point of the
    line between them, little is missed."""
    others, by_side_px = np.where(doubtful[..., None], 0.0, weights), points_px.swapaxes(1, 2)
    agree = triangulate_robust(points_px, others, rig, rig.in_own_px(INLIER_PX)).inliers
    most = np.asarray(2 * agree.sum(axis=-1) > (others > 0).sum(axis=1))
    missed_m = np.full(weights.shape, np.nan)
    for camera in np.flatnonzero(doubtful.any(axis=0)).tolist():
        with_it = agree.copy()
        with_it[..., camera] = True
        of_all_m = _missed_m(by_side_px, with_it, m_per_px, rig)
        missed_m[:, camera] = np.where(doubtful[:, camera, None] & most, of_all_m, np.nan)
    by_others_m, by_other_side_m = _missed_m(by_side_px, agree, m_per_px, rig)[:, None], missed_m[..., ::-1]
    usual_m = np.maximum(np.maximum(by_others_m, by_other_side_m), _USUAL_M)
    return np.asarray((missed_m > _TIMES * usual_m) & (by_other_side_m < _TIMES * _USUAL_M))


def _missed_m(
    points_px: Float[np.ndarray, "point side camera 2"],
    used: Bool[np.ndarray, "point side camera"],
    m_per_px: Float[np.ndarray, "point camera"],
    rig: CameraRig,
) -> Float[np.ndarray, "point side"]:
    """By how much these views miss the point that they tell together: root mean square by degrees of freedom, in metres
    at the person."""
    joint_m = triangulate(points_px, used.astype(float), rig.projection_matrices)
    off_m = norm(rig.project(joint_m).swapaxes(1, 2) - points_px) * m_per_px[:, None]
    freedom = np.maximum(2 * used.sum(axis=-1) - 3, 1)
    return np.sqrt(np.where(used, off_m**2, 0.0).sum(axis=-1) / freedom)
