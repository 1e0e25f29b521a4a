"""One moment: the newest images of some cameras, and the people whom they show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.association.distances import Distances, padded
from fgpose.association.likelihood import Likelihood
from fgpose.association.matching import Matches, match
from fgpose.association.pose_filter import Expected, PoseFilters
from fgpose.geometry.camera import CameraRig
from fgpose.people_observations import Detections


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
    distances: Distances | None = None
    """From the cameras, where there is per-view 3D."""

    @staticmethod
    def of(images: Sequence[Detections], rig: CameraRig) -> Moment:
        """Of these images, one at least."""
        names = [image.camera for image in images]
        cameras = rig if tuple(names) == rig.names else rig.subset(names)
        points_px = [camera.undistort(image.points2d_px) for camera, image in zip(cameras.cameras, images, strict=True)]
        confidence = [image.confidence.mean(axis=-1) for image in images]
        times_s = np.array([image.time_s for image in images]) + cameras.time_offsets_s
        return Moment(
            cameras, times_s, padded(points_px, np.nan), padded(confidence, 0.0), Distances.of(images, cameras)
        )

    @staticmethod
    def together(moments: Sequence[Moment], rig: CameraRig) -> Moment:
        """From moments of one camera each, in which detections may be differently many."""
        n_joints = moments[0].points_px.shape[2]
        return Moment(
            rig.subset([name for moment in moments for name in moment.cameras.names]),
            np.concatenate([moment.times_s for moment in moments]),
            padded([moment.points_px[0] for moment in moments], np.nan),
            padded([moment.confidence[0] for moment in moments], 0.0),
            Distances.together([(moment.distances, moment.points_px.shape[1]) for moment in moments], n_joints),
        )

    def of_camera(self, camera: int) -> Moment:
        """The image of one camera alone, by its number."""
        own = slice(camera, camera + 1)
        return Moment(
            self.cameras.subset([self.cameras.names[camera]]),
            self.times_s[own],
            self.points_px[own].copy(),
            self.confidence[own],
            None if self.distances is None else self.distances[own],
        )

    @property
    def time_s(self) -> float:
        """Of the newest image."""
        return float(self.times_s.max())

    @property
    def tells_distance(self) -> Bool[np.ndarray, "camera detection joint"]:
        """Of which joints the camera tells how far they are."""
        if self.distances is None:
            return np.zeros(self.points_px.shape[:3], dtype=bool)
        return np.asarray(np.isfinite(self.points_px).all(axis=-1)) & np.isfinite(self.distances.distance_m)

    def likelihood(self, expected: Expected) -> Likelihood:
        """Of the detections against people of whom this is expected, with their distances."""
        likelihood = Likelihood.of(expected, self.points_px, self.cameras)
        if self.distances is None:
            return likelihood
        return replace(likelihood, distance_log_ratio=self.distances.log_ratio(expected))

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
    as_detected = moment.likelihood(expected)
    likelihood, mirrored = as_detected.mirrored_where_better(expected, moment.points_px, moment.cameras, mirror)
    matches = match(likelihood, mirrored, priority, mirror)
    residual_px = matches.of(moment.points_px, np.nan) - expected.pixels
    weight = matches.probability(likelihood)
    distance = None if moment.distances is None else moment.distances.matched(matches).against(expected)
    return people.updated(residual_px, expected, weight, distance), matches
