"""The people that a network found in all images, and the observations of one of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Int, Shaped

from fgpose.association.chosen_person import Chosen, PersonRegion, chosen_person
from fgpose.correspondences import NOBODY, MatchedFrames
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.monocular.detection_cache import ViewDetections
from fgpose.monocular.network import People
from fgpose.monocular.sources import Sources
from fgpose.observations import Observations
from fgpose.people_observations import Detections, PeopleObservations
from fgpose.skeleton import Skeleton


def refocused(people: People, before: Camera, after: Camera) -> People:
    """People whose absolute 3D was computed with one camera, as it is with other intrinsics of the same camera.

    The distance of a body follows from its size in the image, so it grows with the focal length; the differences of
    depth within the body are the network's and stay; across the ray each joint stays on its detection. First order in
    the depth of the body over its distance; detecting again would give the exact figures, at the price of the network.

    Args:
        people: in the frame of the camera.
        before: with which they were computed.
        after: the same camera with its focal length or distortion corrected.
    """
    if np.array_equal(before.K, after.K) and np.array_equal(before.distortion, after.distortion):
        return people
    ratio = float(np.sqrt(after.K[0, 0] * after.K[1, 1] / (before.K[0, 0] * before.K[1, 1])))
    depth_m = np.asarray(people.points3d_m[..., 2], dtype=float)
    known = np.isfinite(depth_m)
    count = np.maximum(known.sum(axis=1, keepdims=True), 1)
    distance_m = np.where(known, depth_m, 0.0).sum(axis=1, keepdims=True) / count
    depth_m = depth_m + (ratio - 1) * distance_m
    undistorted = after.undistort(np.asarray(people.points2d_px, dtype=float))
    on_ray = (undistorted - after.K[:2, 2]) / np.diag(after.K)[:2]
    points3d_m = np.concatenate([on_ray * depth_m[..., None], depth_m[..., None]], axis=-1)
    stretch = np.diag([1.0, 1.0, ratio])
    return replace(people, points3d_m=points3d_m, covariance_m2=stretch @ people.covariance_m2 @ stretch)


@dataclass(frozen=True, eq=False)
class FollowedPerson:
    """One person in the images of all cameras."""

    observations: Observations
    """With per-view 3D and its covariance in the world frame."""
    problems: Shaped[np.ndarray, "frame camera"]
    """Why the 3D of a view is missing or uncertain, see People.problems; empty also where the person is not seen."""
    chosen: Chosen
    """Who it is, of how many, and why."""


@dataclass(frozen=True, eq=False)
class Detected:
    """The people in all images of all cameras."""

    sources: Sources
    skeleton: Skeleton
    views: tuple[ViewDetections, ...]
    """Of each camera of the rig, in the camera frame."""
    n_new_images: int
    """How many images were run through the network this time; the others came from the cache."""

    @property
    def rig(self) -> CameraRig:
        return self.sources.rig

    @property
    def n_images(self) -> int:
        return sum(view.n_images for view in self.views)

    @property
    def frames(self) -> MatchedFrames:
        """Which images belong together. Raises ValueError if no image was looked at."""
        return self.people.frames

    def recalibrated(self, rig: CameraRig) -> Detected:
        """The same detections with these poses, clocks and intrinsics of the same cameras, see refocused; without those
        cameras that the rig lacks.

        Raises:
            ValueError: the rig has a camera that is not among them.
        """
        known = self.rig.subset(rig.names)
        kept = [self.rig.names.index(name) for name in rig.names]
        triples = zip((self.views[c] for c in kept), known.cameras, rig.cameras, strict=True)
        views = tuple(replace(view, people=refocused(view.people, *pair)) for view, *pair in triples)
        sources = Sources(rig, tuple(self.sources.clips[c] for c in kept)).on_common_clock()
        return Detected(sources, self.skeleton, views, self.n_new_images)

    def observations(self, person: int | PersonRegion = 0) -> Observations:
        """What the cameras saw of one person, see follow."""
        return self.follow(person).observations

    @cached_property
    def people(self) -> PeopleObservations:
        """Everybody in all images, with per-view 3D and its covariance in the world frame.

        Raises:
            ValueError: no image was looked at.
        """
        images = []
        for camera, clip, view in zip(self.rig.cameras, self.sources.clips, self.views, strict=True):
            times_s = clip.times_s(view.stamps_s).tolist()
            found = zip(times_s, view.unstacked(), strict=True)
            images += [detections_of(camera, time_s, people) for time_s, people in found]
        return PeopleObservations(self.skeleton, self.rig.names, tuple(images))

    def follow(self, person: int | PersonRegion = 0) -> FollowedPerson:
        """What the cameras saw of one person, see chosen_person.

        Args:
            person: 0 for the one who is seen most, 1 for the next, ...; or the one in a region.

        Raises:
            ValueError: there is no such person, or no image was looked at.
        """
        chosen = chosen_person(self.people, self.rig, person)
        seen = chosen.seen
        return FollowedPerson(self.people.of_person(seen), self._problems(seen.main_detection), chosen)

    def _problems(self, chosen: Int[np.ndarray, "frame camera"]) -> Shaped[np.ndarray, "frame camera"]:
        problems = np.full(chosen.shape, "", dtype=object)
        people = [view.unstacked() for view in self.views]
        for t, c in np.argwhere(chosen != NOBODY).tolist():
            problems[t, c] = people[c][self.frames.image[t, c]].problems[chosen[t, c]]
        return problems


def detections_of(camera: Camera, time_s: float, found: People) -> Detections:
    """What a network found in an image of a camera, with per-view 3D and its covariance in the world frame."""
    R = camera.world_T_camera[:3, :3]
    points3d_m, covariance_m2 = camera.to_world_frame(found.points3d_m), R @ found.covariance_m2 @ R.T
    has_3d, has_covariance = (bool(np.isfinite(array).any()) for array in (points3d_m, covariance_m2))
    return Detections(
        camera.name,
        time_s,
        found.points2d_px,
        np.clip(np.nan_to_num(found.confidence), 0.0, 1.0),
        points3d_m if has_3d else None,
        covariance_m2 if has_3d and has_covariance else None,
    )
