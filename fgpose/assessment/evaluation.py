"""One trajectory measured against another: joints matched by what their names mean, frames by time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from fgpose.assessment.alignment import CommonJoints, common_joints
from fgpose.assessment.metrics import (
    acceleration_error_mps2,
    coverage,
    jitter_mps3,
    joint_errors_m,
    mean_known,
    nees,
    pa_mpjpe_m,
    pck,
    share_missing,
)
from fgpose.sampling import at_times, usual_step_s
from fgpose.shown import Shown
from fgpose.shown.joint_meanings import meanings
from fgpose.shown.wrong_types import check_type
from fgpose.trajectory import Trajectory

# The usual threshold of 3D PCK (MPI-INF-3DHP).
PCK_THRESHOLD_M = 0.15
# Ellipsoids of this probability are compared with the share of joints inside them.
COVERAGE_PROBABILITY = 0.95
# Of rates that are nearly the same, as 29.97 and 30, the reference is interpolated: an estimate would be smoothed.
_CLEARLY_SHORTER = 0.9


@dataclass(frozen=True)
class JointScore:
    """Errors of one joint over the matched frames."""

    joint: str
    mpjpe_absolute_mm: float
    mpjpe_relative_mm: float
    pck: float
    share_missing: float


@dataclass(frozen=True, repr=False)
class Evaluation(Shown):
    """How far an estimate is from a reference, over the joints and frames that both have (fgpose.assessment.metrics).

    NaN: cannot be computed, as relative errors without a root or jitter of fewer than four frames.
    """

    mpjpe_absolute_mm: float
    mpjpe_relative_mm: float
    """Relative to the root: that of the estimate's skeleton, else of the reference's, else the two hips."""
    pa_mpjpe_mm: float
    pck: float
    """Share of the absolute errors of at most 150 mm."""
    acceleration_error_mps2: float
    jitter_estimate_mps3: float
    jitter_reference_mps3: float
    """Both over the matched frames, so that they compare."""
    n_joints: int
    n_frames: int
    """Joints and frames in common; what only one side has is not counted anywhere."""
    share_missing: float
    """Share of the common joints and frames that is NaN on either side and therefore in no mean."""
    joints: tuple[JointScore, ...]
    nees: float | None = None
    """Mean normalised error squared, 3 where the covariance is right. None: the estimate has no covariance."""
    coverage_95: float | None = None
    """Share of the errors inside the estimate's own 95 % ellipsoids."""


@dataclass(frozen=True, eq=False)
class _Match:
    """The same joints at the same times in two trajectories."""

    common: CommonJoints
    time_s: Float[np.ndarray, " frame"]
    estimate_m: Float[np.ndarray, "frame joint 3"]
    reference_m: Float[np.ndarray, "frame joint 3"]
    covariance_m2: Float[np.ndarray, "frame joint 3 3"] | None
    """Of the estimate."""


def align_by_name(
    estimate: Trajectory, reference: Trajectory, reference_offset_s: float = 0.0
) -> tuple[Float[np.ndarray, "frame joint 3"], Float[np.ndarray, "frame joint 3"], tuple[str, ...]]:
    """Positions of both at their common times, of their common joints, metres, and the names of these joints.

    Joints are the same when their names mean the same (RHip is right_hip), in the order of the estimate. The times are
    those of the estimate, or of the reference where that has clearly fewer frames a second. There the other one is
    interpolated linearly between two of its frames, never across a gap; where it has a frame at that time, it is that
    frame.

    Args:
        reference_offset_s: added to the reference's times, for a reference with a clock of its own.

    Raises:
        ValueError: no joint or no frame is in common; the message shows both sides.
    """
    match = _match(estimate, reference, reference_offset_s)
    return match.estimate_m, match.reference_m, match.common.names


def evaluate(estimate: Trajectory, reference: Trajectory, reference_offset_s: float = 0.0) -> Evaluation:
    """Measure an estimate against a reference. Joints and frames are matched as in align_by_name.

    The covariance of an estimate that is interpolated is interpolated too: errors of neighbouring frames are nearly the
    same.

    Raises:
        ValueError: no joint or no frame is in common.
        TypeError: one of them is no trajectory.
    """
    check_type("evaluate", "estimate", estimate, Trajectory)
    check_type("evaluate", "reference", reference, Trajectory)
    match = _match(estimate, reference, reference_offset_s)
    estimate_m, reference_m, joints, time_s = match.estimate_m, match.reference_m, match.common.names, match.time_s
    absolute_m = joint_errors_m(estimate_m, reference_m)
    root = _root(match.common, estimate, reference)
    relative_m = joint_errors_m(estimate_m, reference_m, root) if root else np.full_like(absolute_m, np.nan)
    uncertainty = {}
    if match.covariance_m2 is not None:
        errors_m = estimate_m - reference_m
        uncertainty = {
            "nees": float(mean_known(nees(errors_m, match.covariance_m2))),
            "coverage_95": coverage(errors_m, match.covariance_m2, COVERAGE_PROBABILITY),
        }
    return Evaluation(
        mpjpe_absolute_mm=1000 * float(mean_known(absolute_m)),
        mpjpe_relative_mm=1000 * float(mean_known(relative_m)),
        pa_mpjpe_mm=1000 * pa_mpjpe_m(estimate_m, reference_m),
        pck=pck(absolute_m, PCK_THRESHOLD_M),
        acceleration_error_mps2=acceleration_error_mps2(estimate_m, reference_m, time_s),
        jitter_estimate_mps3=jitter_mps3(estimate_m, time_s),
        jitter_reference_mps3=jitter_mps3(reference_m, time_s),
        n_joints=len(joints),
        n_frames=len(time_s),
        share_missing=share_missing(absolute_m),
        joints=_joint_scores(joints, absolute_m, relative_m),
        **uncertainty,
    )


def _joint_scores(
    joints: tuple[str, ...], absolute_m: Float[np.ndarray, "frame joint"], relative_m: Float[np.ndarray, "frame joint"]
) -> tuple[JointScore, ...]:
    return tuple(
        JointScore(
            joint=joint,
            mpjpe_absolute_mm=1000 * float(mean_known(absolute)),
            mpjpe_relative_mm=1000 * float(mean_known(relative)),
            pck=pck(absolute, PCK_THRESHOLD_M),
            share_missing=share_missing(absolute),
        )
        for joint, absolute, relative in zip(joints, absolute_m.T, relative_m.T, strict=True)
    )


def _root(common: CommonJoints, estimate: Trajectory, reference: Trajectory) -> tuple[int, ...] | None:
    """Indices among the common joints."""
    candidates: tuple[tuple[tuple[Any, ...], tuple[Any, ...]], ...] = (
        (common.estimate, estimate.skeleton.root),
        (common.reference, reference.skeleton.root),
        (meanings(common.names), ("left_hip", "right_hip")),
    )
    for joints, root in candidates:
        if set(root) <= set(joints):
            return tuple(joints.index(joint) for joint in root)
    return None


def _match(estimate: Trajectory, reference: Trajectory, reference_offset_s: float) -> _Match:
    common = common_joints(estimate.skeleton, reference.skeleton)
    estimate_s, reference_s = estimate.time_s, reference.time_s + reference_offset_s
    time_s = _common_times_s(estimate_s, reference_s)
    of_estimate, of_reference = list(common.estimate), list(common.reference)
    covariance_m2 = estimate.covariance_m2
    return _Match(
        common,
        time_s,
        at_times(estimate_s, estimate.positions_m[:, of_estimate], time_s),
        at_times(reference_s, reference.positions_m[:, of_reference], time_s),
        None if covariance_m2 is None else at_times(estimate_s, covariance_m2[:, of_estimate], time_s),
    )


def _common_times_s(
    estimate_s: Float[np.ndarray, " frame"], reference_s: Float[np.ndarray, " reference"]
) -> Float[np.ndarray, " common"]:
    """Those of the one that has fewer frames a second, where the other has a frame, or one before and one after.

    Raises:
        ValueError: there is none.
    """
    if len(estimate_s) == 0 or len(reference_s) == 0:
        raise ValueError("no frame in common: one of the two has none")
    own_s, other_s = estimate_s, reference_s
    if usual_step_s(estimate_s) < _CLEARLY_SHORTER * usual_step_s(reference_s):
        own_s, other_s = reference_s, estimate_s
    common_s = own_s[np.isfinite(at_times(other_s, np.zeros(len(other_s)), own_s))]
    if common_s.size == 0:
        raise ValueError(
            f"no frame in common: the estimate lasts from {estimate_s[0]:.6g} to {estimate_s[-1]:.6g} s, "
            f"the reference from {reference_s[0]:.6g} to {reference_s[-1]:.6g} s"
        )
    return common_s
