"""The people that a network found in all images, and the observations of one of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int, Shaped

from fgpose.association.main_person import associate_somehow
from fgpose.frame_matching import NO_IMAGE, MatchedFrames, match_frames
from fgpose.geometry.camera import CameraRig
from fgpose.monocular.detection_cache import ViewDetections
from fgpose.monocular.sources import Sources
from fgpose.observations import Observations
from fgpose.people import NOBODY, Detections, PeopleObservations, Seen
from fgpose.skeleton import Skeleton

# The person of a region has at least this share of its joints in it.
_MIN_INSIDE = 0.5


@dataclass(frozen=True)
class PersonRegion:
    """Where the wanted person is in the first image of one camera."""

    camera: str
    x_px: float
    y_px: float
    width_px: float
    height_px: float

    def __str__(self) -> str:
        numbers = ",".join(f"{value:g}" for value in (self.x_px, self.y_px, self.width_px, self.height_px))
        return f"{self.camera}:{numbers}"

    def share_inside(self, points2d_px: Float[np.ndarray, "person joint 2"]) -> Float[np.ndarray, " person"]:
        """Share of each person's known joints that lie in the region."""
        corner_px, size_px = np.array([self.x_px, self.y_px]), np.array([self.width_px, self.height_px])
        inside = ((points2d_px >= corner_px) & (points2d_px <= corner_px + size_px)).all(axis=-1)
        known = np.isfinite(points2d_px).all(axis=-1)
        return inside.sum(axis=-1) / np.maximum(known.sum(axis=-1), 1)


@dataclass(frozen=True, eq=False)
class FollowedPerson:
    """One person in the images of all cameras."""

    observations: Observations
    """With per-view 3D and its covariance in the world frame."""
    problems: Shaped[np.ndarray, "frame camera"]
    """Why the 3D of a view is missing or uncertain, see People.problems; empty also where the person is not seen."""


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

    @cached_property
    def frames(self) -> MatchedFrames:
        """Which images belong together. Raises ValueError if no image was looked at."""
        pairs = zip(self.sources.clips, self.views, strict=True)
        return match_frames([clip.times_s(view.stamps_s) for clip, view in pairs])

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
            R = camera.world_T_camera[:3, :3]
            times_s = clip.times_s(view.stamps_s).tolist()
            for time_s, found in zip(times_s, view.unstacked(), strict=True):
                points3d_m, covariance_m2 = camera.to_world_frame(found.points3d_m), R @ found.covariance_m2 @ R.T
                has_3d, has_covariance = (bool(np.isfinite(array).any()) for array in (points3d_m, covariance_m2))
                images.append(
                    Detections(
                        camera.name,
                        time_s,
                        found.points2d_px,
                        np.clip(np.nan_to_num(found.confidence), 0.0, 1.0),
                        points3d_m if has_3d else None,
                        covariance_m2 if has_3d and has_covariance else None,
                    )
                )
        return PeopleObservations(self.skeleton, self.rig.names, tuple(images))

    def follow(self, person: int | PersonRegion = 0) -> FollowedPerson:
        """What the cameras saw of one person.

        People are followed through views and frames together, see associate; not needed where no image shows more than
        one.

        Args:
            person: 0 for the one who is seen most, 1 for the next, ...; or the one in a region.

        Raises:
            ValueError: there is no such person, or no image was looked at.
        """
        seen = self._seen(person)
        observations = self.people.of_person(self.frames, seen)
        return FollowedPerson(observations, self._problems(seen.main_detection))

    def _seen(self, person: int | PersonRegion) -> Seen:
        if person == 0 and all(image.n_people <= 1 for image in self.people.images):
            return self.people.only(self.frames)
        association = associate_somehow(self.people, self.rig, self.frames)
        n_frames = len(self.frames.image)
        everybody = [seen.in_frames(n_frames) for seen in association.people.values()]
        if isinstance(person, PersonRegion):
            frame, camera, candidate = self._in_region(person)
            wanted = [seen for seen in everybody if (seen.detection[frame, camera] == candidate).any()]
            if not wanted:
                raise ValueError(f"region {person}: no other camera agrees on the person who is there")
            return wanted[0]
        if not 0 <= person < len(everybody):
            raise ValueError(f"there is no person {person}: {len(everybody)} were found, counted from 0")
        return everybody[person]

    def _problems(self, chosen: Int[np.ndarray, "frame camera"]) -> Shaped[np.ndarray, "frame camera"]:
        problems = np.full(chosen.shape, "", dtype=object)
        people = [view.unstacked() for view in self.views]
        for t, c in np.argwhere(chosen != NOBODY).tolist():
            problems[t, c] = people[c][self.frames.image[t, c]].problems[chosen[t, c]]
        return problems

    def _in_region(self, region: PersonRegion) -> tuple[int, int, int]:
        """Frame, camera and detection that a region means. Raises ValueError if nobody is there."""
        self.rig.subset([region.camera])
        camera = self.rig.names.index(region.camera)
        with_image = np.flatnonzero(self.frames.image[:, camera] != NO_IMAGE)
        if not with_image.size:
            raise ValueError(f"region {region}: camera {region.camera} has no image")
        frame = int(with_image[0])
        points2d_px = self.people.by_camera[region.camera][self.frames.image[frame, camera]].points2d_px
        share = region.share_inside(points2d_px)
        best = int(np.argmax(share)) if len(share) else NOBODY
        if best == NOBODY or share[best] < _MIN_INSIDE:
            people = [points_px for points_px in points2d_px if np.isfinite(points_px).any()]
            places = "; ".join(",".join(f"{value:.0f}" for value in _box(points_px)) for points_px in people)
            raise ValueError(
                f"region {region}: nobody is there in the first image of {region.camera}; "
                + (f"people are at X,Y,W,H = {places}" if people else "nobody is in the whole image")
            )
        return frame, camera, best


def _box(points_px: Float[np.ndarray, "joint 2"]) -> tuple[float, float, float, float]:
    corner, size = np.nanmin(points_px, axis=0), np.nanmax(points_px, axis=0) - np.nanmin(points_px, axis=0)
    return float(corner[0]), float(corner[1]), float(size[0]), float(size[1])
