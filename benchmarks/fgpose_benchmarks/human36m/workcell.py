"""The paper's protocol for workcells: evaluation against a suit of inertial sensors whose position drifts.

Section "Human-Robot Workcell" of the paper: the reference is the whole-body pose of a suit of 17 inertial measurement
units (Xsens MVN Awinda). Its shape is right, its absolute position drifts; this is corrected "by aligning the
inertial-based 3D pose with the 3D position of the neck joint detected by OpenPTrack". Section "Evaluation Metrics":
the absolute error measures localisation, the relative one requires aligning the pelvis of estimate and ground truth.

So in every frame the reference is translated, never turned, until its neck is at the neck of another tracker, the
anchor. Where no other tracker ran, the estimate's own neck is the anchor: the error of the neck itself is then zero,
and the absolute error says nothing about where the neck is. Axes of the reference must be those of the estimate.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from fgpose.assessment.evaluation import Evaluation, evaluate
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status, Trajectory

# The suit delivers 60 Hz or more: within this a linear interpolation is off by millimetres, beyond it by centimetres.
_MAX_GAP_S = 0.1

# Human3.6M's joint at the seventh cervical vertebra, which MMPose calls thorax, is the neck of other skeletons.
_NECKS = ({"neck", "thorax"}, {"neck_base"})
_SHOULDERS = ("left_shoulder", "right_shoulder")

# Segments of Xsens MVN as joints, by the names that fgpose.load_trajectory gives them: each has its origin at the joint
# nearer to the pelvis (MVN User Manual, segment axes). Its segment Shoulder begins at the breast bone.
_MVN_SEGMENTS = {
    "upper_arm": "shoulder",
    "fore_arm": "elbow",
    "forearm": "elbow",
    "hand": "wrist",
    "upper_leg": "hip",
    "lower_leg": "knee",
    "foot": "ankle",
}


def evaluate_workcell(
    estimate: Trajectory,
    reference: Trajectory,
    anchor: Trajectory | None = None,
    *,
    reference_offset_s: float = 0.0,
    neck: str | None = None,
) -> Evaluation:
    """Measure an estimate against an inertial reference by the paper's protocol.

    The reference is interpolated at the times of the estimate and translated to the anchor's neck in every frame.
    Joints are the same when their names are; segments of Xsens MVN count as the joints at which they begin. All of them
    are in the means, the neck included. Frames without the neck of reference and anchor are not scored.

    Args:
        estimate: what is measured.
        reference: of the suit.
        anchor: a trajectory of the neck by another tracker, with the clock of the estimate; None: the estimate itself.
        reference_offset_s: added to the reference's times, for a suit with a clock of its own.
        neck: name of the joint that is aligned. By default neck or thorax, else neck_base, else the middle of the
            shoulders: the first that both reference and anchor have.

    Raises:
        ValueError: no joint or no time is in common, or there is no joint to align at.
    """
    aligned = aligned_reference(estimate, reference, anchor, reference_offset_s=reference_offset_s, neck=neck)
    return evaluate(estimate, aligned)


def aligned_reference(
    estimate: Trajectory,
    reference: Trajectory,
    anchor: Trajectory | None = None,
    *,
    reference_offset_s: float = 0.0,
    neck: str | None = None,
) -> Trajectory:
    """The reference at the times of the estimate, its neck where the anchor's is. Arguments as of evaluate_workcell."""
    renamed = replace(reference, skeleton=with_joint_names(reference.skeleton))
    moved = at_times(renamed, estimate.time_s, reference_offset_s)
    anchors = estimate if anchor is None else at_times(anchor, estimate.time_s)
    there, here = _neck_joints((anchors.skeleton, moved.skeleton), neck)
    shift_m = _middle_m(anchors, there) - _middle_m(moved, here)
    if not np.isfinite(shift_m).any():
        raise ValueError("no frame has the neck of both the reference and the anchor, so nothing can be aligned")
    return _trajectory(moved.skeleton, moved.time_s, moved.positions_m + shift_m[:, None])


def at_times(trajectory: Trajectory, time_s: Float[np.ndarray, " frame"], offset_s: float = 0.0) -> Trajectory:
    """Positions at other times, linear between the two frames around each; NaN outside and in gaps above 0.1 s.

    Args:
        trajectory: of at least two frames.
        time_s: wanted.
        offset_s: added to the times of the trajectory.

    Raises:
        ValueError: none of the times lies within the trajectory.
    """
    own_s = trajectory.time_s + offset_s
    inside = (time_s >= own_s[0]) & (time_s <= own_s[-1]) if len(own_s) else np.zeros(len(time_s), dtype=bool)
    if len(own_s) < 2 or not inside.any():
        lasts = f"from {own_s[0]:.6g} to {own_s[-1]:.6g} s" if len(own_s) else "no time"
        wanted = f"{time_s[0]:.6g} to {time_s[-1]:.6g} s" if len(time_s) else "none"
        raise ValueError(f"no time in common: one trajectory lasts {lasts}, wanted are {wanted}")
    right = np.searchsorted(own_s, time_s, side="left").clip(1, len(own_s) - 1)
    gap_s = own_s[right] - own_s[right - 1]
    share = ((time_s - own_s[right - 1]) / gap_s)[:, None, None]
    before_m, after_m = trajectory.positions_m[right - 1], trajectory.positions_m[right]
    # A frame exactly at a wanted time is known whatever its neighbour.
    positions_m = np.where(share == 0, before_m, np.where(share == 1, after_m, before_m + share * (after_m - before_m)))
    on_frame = (share[:, 0, 0] == 0) | (share[:, 0, 0] == 1)
    positions_m[~(inside & (on_frame | (gap_s <= _MAX_GAP_S)))] = np.nan
    return _trajectory(trajectory.skeleton, time_s, positions_m)


def _trajectory(
    skeleton: Skeleton, time_s: Float[np.ndarray, " frame"], positions_m: Float[np.ndarray, "frame joint 3"]
) -> Trajectory:
    known = np.asarray(np.isfinite(positions_m).all(axis=-1))
    return Trajectory(
        skeleton=skeleton,
        time_s=time_s.copy(),
        positions_m=np.where(known[..., None], positions_m, np.nan),
        status=np.where(known, int(Status.OBSERVED), int(Status.UNOBSERVABLE)),
    )


def with_joint_names(skeleton: Skeleton) -> Skeleton:
    """A skeleton whose joints are segments of Xsens MVN, with the names of the joints at which they begin; others as
    they are."""
    if "right_upper_arm" not in skeleton.joints:
        return skeleton
    return replace(skeleton, joints=tuple(map(_joint_of_segment, skeleton.joints)))


def _joint_of_segment(name: str) -> str:
    side, _, segment = name.partition("_")
    if segment == "shoulder":
        return f"{name}_segment"  # leaves the name to the joint, at which the upper arm begins
    return f"{side}_{_MVN_SEGMENTS[segment]}" if segment in _MVN_SEGMENTS else name


def _neck_joints(skeletons: tuple[Skeleton, ...], neck: str | None) -> list[tuple[int, ...]]:
    """Of each skeleton the joints whose middle is aligned."""
    if neck is not None:
        return [(skeleton.index(neck),) for skeleton in skeletons]
    for names in _NECKS:
        found = [[joint for joint in skeleton.joints if joint in names] for skeleton in skeletons]
        if all(found):
            return [(skeleton.index(joints[0]),) for skeleton, joints in zip(skeletons, found, strict=True)]
    if all(set(_SHOULDERS) <= set(skeleton.joints) for skeleton in skeletons):
        return [tuple(skeleton.index(joint) for joint in _SHOULDERS) for skeleton in skeletons]
    sides = "; ".join(", ".join(skeleton.joints) for skeleton in skeletons)
    raise ValueError(
        f"there is no neck (neck, thorax, neck_base or two shoulders) that reference and anchor both have: {sides}"
    )


def _middle_m(trajectory: Trajectory, joints: tuple[int, ...]) -> Float[np.ndarray, "frame 3"]:
    return trajectory.positions_m[:, list(joints)].mean(axis=1)
