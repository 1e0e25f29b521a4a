"""A whole body online: the body, then each hand and the face where they hang on it (see batch)."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from fgpose.config import Config
from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.evidence.gather import gather_frame
from fgpose.estimation.online.arrivals import with_image
from fgpose.estimation.online.clock_offsets import RunningOffsets
from fgpose.estimation.parts.holder import Holder
from fgpose.estimation.parts.part_estimator import PartEstimator
from fgpose.estimation.parts.place import alone, config_of
from fgpose.estimation.parts.rigid import RigidSet, of_whole, placed
from fgpose.estimation.parts.whole import of_all_joints, of_all_lengths
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.reprojection import reprojection_residual_px
from fgpose.observations import Observations
from fgpose.skeleton import BodyPart, Skeleton
from fgpose.trajectory import Estimate, Status, joint_status

_SHAPE_FRAMES = 60  # the last ones that tell the shape of a rigid set
_SHAPE_EVERY_S = 0.1  # one of so many is kept


class HungPart:
    """A part with the estimator of its own joints: all of them, or those that carry a rigid set.

    Args:
        part: of the skeleton.
        skeleton: of the whole body.
        rig, config: of the estimator.
        offsets: of the cameras, shared with the body.
    """

    def __init__(
        self, part: BodyPart, skeleton: Skeleton, rig: CameraRig, config: Config, offsets: RunningOffsets
    ) -> None:
        own = alone(part, skeleton)
        self.part, self._config, self._rig = part, config, rig
        self._skeleton = skeleton.of_joints(part.joints, own.name)
        self._holder = Holder(own.root[0], skeleton.body.index(part.hangs_on[0]), is_same=part.is_joined)
        of_part = rig, own, config_of(part, config), offsets, self._holder
        self.estimator = PartEstimator(*of_part, is_one_person=True)
        self._rigid: RigidSet | None = None
        self._frame = -1
        self._images: Observations | None = None  # of that frame, as far as they have come
        self._seen: Evidence | None = None
        self._shapes: deque[tuple[np.ndarray, np.ndarray]] = deque(maxlen=_SHAPE_FRAMES)
        self._shaped_s = -np.inf

    def take(self, images: Observations, taken_s: Float[np.ndarray, " camera"], body: Estimate) -> Estimate:
        """Images of all cameras and all joints, when the body was estimated from them."""
        self._holder.take(body)
        own = images.of_joints(self.estimator.skeleton, self.part.estimated)
        if self.part.is_joined:  # the estimate of the body has used the detections of the joint on which it hangs
            is_held = np.arange(own.skeleton.n_joints) == own.skeleton.root[0]
            own = own.without(np.broadcast_to(is_held, own.confidence.shape))
        estimate = self.estimator.take(own, taken_s)
        return self._carried(estimate, images, taken_s) if self.part.carried_by else estimate

    @property
    def newest(self) -> Estimate:
        """As the last update gave it."""
        estimate = self.estimator.newest
        assert estimate is not None  # it has taken all images that the body has
        return self._placed(estimate) if self.part.carried_by else estimate

    def _carried(self, carriers: Estimate, images: Observations, taken_s: Float[np.ndarray, " camera"]) -> Estimate:
        own = images.of_joints(self._skeleton, self.part.joints)
        if self._images is None or carriers.frame != self._frame:
            self._frame, self._images = carriers.frame, own
        else:
            # An image of an older frame is none of the newest.
            self._images = with_image(self._images, own, taken_s == self.estimator.newest_images_s)
        said = np.ones((1, self._skeleton.n_joints))
        self._seen, _ = gather_frame(self._images, self._rig, self._config, said, may_leave_out=False)
        if np.isfinite(carriers.positions_m).all():
            self._learn_shape(carriers, self._seen.guess_m[0])
        return self._placed(carriers)

    def _learn_shape(self, carriers: Estimate, points_m: Float[np.ndarray, "point 3"]) -> None:
        """From a frame, again when another image of it has come."""
        if self._shapes and carriers.time_s == self._shaped_s:
            self._shapes.pop()
        elif carriers.time_s < self._shaped_s + _SHAPE_EVERY_S:
            return
        self._shaped_s = carriers.time_s
        self._shapes.append((carriers.positions_m, points_m))
        carriers_m, all_points_m = (np.array(each) for each in zip(*self._shapes, strict=True))
        carried_by = [self.part.joints.index(joint) for joint in self.part.carried_by]
        self._rigid = RigidSet.of(carriers_m, all_points_m, carried_by)

    def _placed(self, carriers: Estimate) -> Estimate:
        """All points of the rigid set, where its carriers put them."""
        assert self._seen is not None
        smoothed = None if carriers.smoothed is None else self._points(carriers.smoothed, None)
        newly_smoothed = tuple(self._points(each, None) for each in carriers.newly_smoothed)
        return replace(self._points(carriers, self._seen), smoothed=smoothed, newly_smoothed=newly_smoothed)

    def _points(self, carriers: Estimate, seen: Evidence | None) -> Estimate:
        n_points, stated_m2 = self._skeleton.n_joints, carriers.covariance_m2
        of_frame = carriers.positions_m[None], None if stated_m2 is None else stated_m2[None]
        (positions_m,), covariance_m2 = placed(self._rigid, *of_frame, n_points)
        active = np.asarray(np.isfinite(positions_m).all(axis=-1))
        is_observed = bool((carriers.status == Status.OBSERVED).all())
        observed = np.full(n_points, is_observed) if seen is None else seen.observed[0]
        residual_px, visibility = None, None
        if seen is not None and carriers.visibility is not None:
            residual_px = reprojection_residual_px(seen.undistorted_px, self._rig, positions_m[None])[0]
            visibility = np.where(seen.detected[0], of_whole(carriers.visibility), np.nan)
        return replace(
            carriers,
            skeleton=self._skeleton,
            positions_m=positions_m,
            status=joint_status(active, observed),
            covariance_m2=None if covariance_m2 is None else covariance_m2[0],
            residual_px=residual_px,
            visibility=visibility,
            bone_lengths=None,
            smoothed=None,
            newly_smoothed=(),
        )


def of_whole_body(skeleton: Skeleton, body: Estimate, parts: Sequence[Estimate]) -> Estimate:
    """One estimate of all joints, from those of the body and of its parts."""
    # The body comes last: a joint on which parts hang is the body's.
    joints = [*(part.joints if part.carried_by else part.estimated for part in skeleton.parts), skeleton.body]
    found = list(zip(joints, [*parts, body], strict=True))
    smoothed = [(joints, each.smoothed) for joints, each in found if each.smoothed is not None]
    newly_smoothed = zip(*(each.newly_smoothed for _, each in found), strict=True)
    lengths = [(each.skeleton, each.bone_lengths) for _, each in found if each.bone_lengths is not None]
    return replace(
        _joined(found, skeleton),
        smoothed=_joined(smoothed, skeleton) if len(smoothed) == len(found) else None,
        newly_smoothed=tuple(_joined(list(zip(joints, frame, strict=True)), skeleton) for frame in newly_smoothed),
        n_repairs=sum(each.n_repairs for _, each in found),
        bone_lengths=of_all_lengths(skeleton, lengths) if lengths else None,
        other_bone=next((each.other_bone for _, each in found if each.other_bone is not None), None),
    )


def _joined(found: Sequence[tuple[Sequence[int], Estimate]], skeleton: Skeleton) -> Estimate:
    by_joint = ("positions_m", "status", "covariance_m2")
    arrays: dict[str, Any] = {name: of_all_joints(found, name, skeleton.n_joints, 0) for name in by_joint}
    arrays |= {name: of_all_joints(found, name, skeleton.n_joints, 1) for name in ("residual_px", "visibility")}
    return replace(found[-1][1], skeleton=skeleton, bone_lengths=None, smoothed=None, newly_smoothed=(), **arrays)
