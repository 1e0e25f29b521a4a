"""One moment: the newest images of some cameras, and the people whom they show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.association.likelihood import Likelihood
from fgpose.association.matching import Matches, match
from fgpose.association.pose_filter import PoseFilters
from fgpose.geometry.camera import CameraRig
from fgpose.people import Detections


@dataclass(frozen=True, eq=False)
class Moment:
    """At most one image of each camera, and at most P detections in it; NaN: none."""

    cameras: CameraRig
    """Those that have an image."""
    times_s: Float[np.ndarray, " camera"]
    """When they took it."""
    points_px: Float[np.ndarray, "camera detection joint 2"]
    """Undistorted."""
    confidence: Float[np.ndarray, "camera detection"]
    """Mean over the joints."""

    @staticmethod
    def of(images: Sequence[Detections], rig: CameraRig) -> Moment:
        """Of these images, one at least."""
        names = [image.camera for image in images]
        cameras = rig if tuple(names) == rig.names else rig.subset(names)
        points_px = [camera.undistort(image.points2d_px) for camera, image in zip(cameras.cameras, images, strict=True)]
        confidence = [image.confidence.mean(axis=-1) for image in images]
        times_s = np.array([image.time_s for image in images]) + cameras.time_offsets_s
        return Moment.together(cameras, times_s, points_px, confidence)

    @staticmethod
    def together(
        cameras: CameraRig,
        times_s: Float[np.ndarray, " camera"],
        points_px: Sequence[Float[np.ndarray, "_ joint 2"]],
        confidence: Sequence[Float[np.ndarray, " _"]],
    ) -> Moment:
        """From the detections of each camera, which may be differently many."""
        most = max(map(len, points_px))
        moment = Moment(
            cameras,
            times_s,
            np.full((len(points_px), most, *points_px[0].shape[1:]), np.nan),
            np.zeros((len(points_px), most)),
        )
        for c, (points, sure) in enumerate(zip(points_px, confidence, strict=True)):
            moment.points_px[c, : len(points)], moment.confidence[c, : len(points)] = points, sure
        return moment

    @property
    def time_s(self) -> float:
        """Of the newest image."""
        return float(self.times_s.max())

    def without(self, taken: Bool[np.ndarray, "camera detection"]) -> Moment:
        """The same without some of the detections; the others keep their numbers."""
        return replace(self, points_px=np.where(taken[..., None, None], np.nan, self.points_px))


def follow(
    people: PoseFilters, priority: Int[np.ndarray, " person"], moment: Moment, mirror: Int[np.ndarray, " joint"]
) -> tuple[PoseFilters, Matches]:
    """Give the detections of a moment to the people whom they fit, and let these follow them.

    Args:
        people: as they are known so far.
        priority: people of a higher one choose first.
        moment: later than that, or of old images.
        mirror: the joint on the other side of each.
    """
    people = people.predicted(moment.time_s)
    expected = people.seen_by(moment.cameras, moment.times_s)
    as_detected = Likelihood.of(expected, moment.points_px, moment.cameras)
    likelihood, mirrored = as_detected.mirrored_where_better(expected, moment.points_px, moment.cameras, mirror)
    matches = match(likelihood, mirrored, priority, mirror)
    residual_px = matches.of(moment.points_px, np.nan) - expected.pixels
    return people.updated(residual_px, expected, matches.probability(likelihood)), matches
