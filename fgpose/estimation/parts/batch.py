"""A whole body in batch: the body, then each hand and the face where they hang on it.

A matrix of the unknowns of a frame with 133 joints takes 480 times as long to factorise as one with 17. Hands and face
tell next to nothing of the body, which holds them: so the body is estimated first, without them, and then each of them
where it hangs, with the body's joint there as a prior (Held). Each has its own noise of detections, bone lengths and
motion, learned as those of the body are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Protocol, runtime_checkable

import numpy as np

from fgpose.config import Config
from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.evidence.gathered import Gathered
from fgpose.estimation.parts.place import alone, apart_m, config_of, place_covariance_m2
from fgpose.estimation.parts.rigid import RigidSet, of_whole, placed
from fgpose.estimation.parts.whole import of_all_joints, of_all_lengths, of_part
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.reprojection import reprojection_residual_px
from fgpose.sampling import usual_step_s
from fgpose.skeleton import BodyPart, BoneLengths, Skeleton
from fgpose.trajectory import Convergence, Trajectory, joint_status


@runtime_checkable
class Smooth(Protocol):
    """Smooths joints that are no whole body; see fgpose.estimation.smoother.smooth_evidence."""

    def __call__(self, evidence: Evidence | Gathered, skeleton: Skeleton, *, config: Config) -> Trajectory: ...


def smooth_whole_body(
    evidence: Evidence | Gathered,
    skeleton: Skeleton,
    rig: CameraRig,
    config: Config,
    smooth_part: Callable[..., Trajectory],
    progress: Callable[[int, int], None] | None,
    bones: BoneLengths | None,
) -> Trajectory:
    """The trajectory of a skeleton with parts; see fgpose.smooth.

    Args:
        smooth_part: of the body, and of each part: see Smooth; with progress and bones of the part.
    """
    smoothers = _smoothers_of_parts(smooth_part, len(evidence.time_s), skeleton, progress, bones)
    body = next(smoothers)(evidence.joints(skeleton.body), skeleton.of_joints(skeleton.body), config=config)
    found: list[tuple[Sequence[int], Trajectory]] = []
    for part in skeleton.parts:
        own = part.joints if part.carried_by else part.estimated
        found.append((own, _of_part(evidence, part, skeleton, body, rig, config, next(smoothers))))
    return _joined(skeleton, [*found, (skeleton.body, body)], config)


def _smoothers_of_parts(
    smooth_part: Callable[..., Trajectory],
    n_frames: int,
    skeleton: Skeleton,
    progress: Callable[[int, int], None] | None,
    bones: BoneLengths | None,
) -> Iterator[Smooth]:
    """One for the body and each part in turn, with its bones and the progress of all."""
    parts = skeleton.of_joints(skeleton.body), *(alone(part, skeleton) for part in skeleton.parts)

    def told(before: int, done: int, _: int) -> None:
        if progress:
            progress((before + done) // len(parts), n_frames)

    for number, part in enumerate(parts):
        own = bones and of_part(bones, skeleton, part)
        yield partial(smooth_part, progress=partial(told, number * n_frames), bones=own)


def _of_part(
    evidence: Evidence | Gathered,
    part: BodyPart,
    skeleton: Skeleton,
    body: Trajectory,
    rig: CameraRig,
    config: Config,
    smooth: Smooth,
) -> Trajectory:
    own, seen = alone(part, skeleton), evidence.joints(part.estimated)
    held_by, joint = skeleton.body.index(part.hangs_on[0]), own.root[0]
    body_m = body.positions_m[:, held_by]
    body_m2 = np.zeros((len(body_m), 3, 3)) if body.covariance_m2 is None else body.covariance_m2[:, held_by]
    apart = 0.0 if part.is_joined else apart_m(seen.guess_m[:, joint] - body_m)
    place_m2 = place_covariance_m2(body_m2, apart, usual_step_s(evidence.time_s))
    seen = seen.held(joint, body_m, place_m2, instead=part.is_joined)
    smoothed = smooth(seen, own, config=config_of(part, config))
    return _carried(evidence, part, skeleton, smoothed, rig) if part.carried_by else smoothed


def _carried(
    evidence: Evidence | Gathered, part: BodyPart, skeleton: Skeleton, carriers: Trajectory, rig: CameraRig
) -> Trajectory:
    """All points of a rigid set."""
    joints, whole = list(part.joints), evidence.frames(slice(None)).joints(part.joints)
    rigid = RigidSet.of(carriers.positions_m, whole.guess_m, [joints.index(joint) for joint in part.carried_by])
    positions_m, covariance_m2 = placed(rigid, carriers.positions_m, carriers.covariance_m2, len(joints))
    assert carriers.visibility is not None
    return Trajectory(
        skeleton=skeleton.of_joints(part.joints, carriers.skeleton.name, part.hangs_on[1]),
        time_s=carriers.time_s,
        positions_m=positions_m,
        status=joint_status(np.asarray(np.isfinite(positions_m).all(axis=-1)), whole.observed),
        covariance_m2=covariance_m2,
        residual_px=reprojection_residual_px(whole.undistorted_px, rig, positions_m),
        camera_names=carriers.camera_names,
        convergence=carriers.convergence,
        visibility=np.where(whole.detected, of_whole(carriers.visibility), np.nan),
    )


def _joined(skeleton: Skeleton, found: list[tuple[Sequence[int], Trajectory]], config: Config) -> Trajectory:
    """One trajectory of all: the parts, and the body, which comes last: a joint on which parts hang is the body's."""
    by_frame = ("positions_m", "status", "covariance_m2")
    arrays: dict[str, Any] = {name: of_all_joints(found, name, skeleton.n_joints, 1) for name in by_frame}
    arrays |= {name: of_all_joints(found, name, skeleton.n_joints, 2) for name in ("residual_px", "visibility")}
    lengths = [
        (each.skeleton, BoneLengths(each.bone_lengths_m, each.bone_length_sigma_m))
        for _, each in found
        if each.bone_lengths_m is not None and each.bone_length_sigma_m is not None
    ]
    known = of_all_lengths(skeleton, lengths)
    return replace(
        found[-1][1],
        skeleton=skeleton,
        bone_lengths_m=known.lengths_m,
        bone_length_sigma_m=known.sigma_m,
        other_bone=next((each.other_bone for _, each in found if each.other_bone is not None), None),
        convergence=Convergence.worst([each.convergence for _, each in found if each.convergence is not None]),
        config=config,
        **arrays,
    )
