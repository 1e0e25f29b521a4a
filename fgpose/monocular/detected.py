"""The people that a network found in all images, and the observations of one of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from fgpose.association.people import track_people
from fgpose.association.person import NOBODY
from fgpose.geometry.camera import CameraRig
from fgpose.monocular.detection_cache import ViewDetections
from fgpose.monocular.frame_matching import NO_IMAGE, MatchedFrames, match_frames
from fgpose.monocular.network import People
from fgpose.monocular.sources import Sources
from fgpose.observations import Observations
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

    def follow(self, person: int | PersonRegion = 0) -> FollowedPerson:
        """What the cameras saw of one person.

        People are followed through views and frames together, see track_people; not needed where no image shows more
        than one.

        Args:
            person: 0 for the one who is seen most, 1 for the next, ...; or the one in a region.

        Raises:
            ValueError: there is no such person, or no image was looked at.
        """
        people = [view.unstacked() for view in self.views]
        chosen = _chosen(self._candidates(people), self, person)
        points3d_m, covariance_m2 = self._of(chosen, people, "points3d_m"), self._of(chosen, people, "covariance_m2")
        for c, camera in enumerate(self.rig.cameras):
            R = camera.world_T_camera[:3, :3]
            points3d_m[:, c] = camera.to_world_frame(points3d_m[:, c])
            covariance_m2[:, c] = R @ covariance_m2[:, c] @ R.T
        has_3d, has_covariance = (bool(np.isfinite(array).any()) for array in (points3d_m, covariance_m2))
        observations = Observations(
            skeleton=self.skeleton,
            time_s=self.frames.time_s,
            points2d_px=self._of(chosen, people, "points2d_px"),
            confidence=np.clip(np.nan_to_num(self._of(chosen, people, "confidence")), 0.0, 1.0),
            points3d_m=points3d_m if has_3d else None,
            covariance3d_m2=covariance_m2 if has_3d and has_covariance else None,
            camera_names=self.rig.names,
        )
        return FollowedPerson(observations, self._problems(chosen, people))

    def _of(self, chosen: Int[np.ndarray, "frame camera"], people: list[list[People]], name: str) -> np.ndarray:
        """(T, C, ...) one of the arrays of People for the chosen ones, in the camera frame; NaN where nobody is."""
        array = np.full((*chosen.shape, *getattr(self.views[0].people, name).shape[1:]), np.nan)
        for t, c in np.argwhere(chosen != NOBODY):
            array[t, c] = getattr(people[c][self.frames.image[t, c]], name)[chosen[t, c]]
        return array

    def _problems(
        self, chosen: Int[np.ndarray, "frame camera"], people: list[list[People]]
    ) -> Shaped[np.ndarray, "frame camera"]:
        problems = np.full(chosen.shape, "", dtype=object)
        for t, c in np.argwhere(chosen != NOBODY):
            problems[t, c] = people[c][self.frames.image[t, c]].problems[chosen[t, c]]
        return problems

    def _candidates(self, people: list[list[People]]) -> _Candidates:
        image = self.frames.image
        most = max(int(view.n_people.max(initial=0)) for view in self.views)
        shape = (*image.shape, max(most, 1), self.skeleton.n_joints)
        candidates = _Candidates(np.full((*shape, 2), np.nan), np.zeros(shape))
        for t, c in np.argwhere(image != NO_IMAGE):
            there = people[c][image[t, c]]
            candidates.points2d_px[t, c, : there.n_people] = there.points2d_px
            candidates.confidence[t, c, : there.n_people] = there.confidence
        return candidates


@dataclass(frozen=True, eq=False)
class _Candidates:
    """Everybody in the images of every frame; NaN = missing, then with confidence 0."""

    points2d_px: Float[np.ndarray, "frame camera person joint 2"]
    confidence: Float[np.ndarray, "frame camera person joint"]

    @property
    def present(self) -> Bool[np.ndarray, "frame camera person"]:
        return np.asarray((self.confidence > 0).any(axis=-1))


def _chosen(candidates: _Candidates, detected: Detected, person: int | PersonRegion) -> Int[np.ndarray, "frame camera"]:
    """Index of the person in each image, NOBODY where it is not there."""
    present = candidates.present
    if person == 0 and present.shape[2] == 1:
        return np.where(present[:, :, 0], 0, NOBODY)
    points2d_px, confidence = candidates.points2d_px, candidates.confidence
    people = track_people(points2d_px, confidence, detected.frames.frame_time_s, detected.rig, detected.skeleton)
    if isinstance(person, PersonRegion):
        frame, camera, candidate = _in_region(candidates, detected, person)
        wanted = [chosen for chosen in people if chosen[frame, camera] == candidate]
        if not wanted:
            raise ValueError(f"region {person}: no other camera agrees on the person who is there")
        return wanted[0]
    if not 0 <= person < len(people):
        raise ValueError(f"there is no person {person}: {len(people)} were found, counted from 0")
    return people[person]


def _in_region(candidates: _Candidates, detected: Detected, region: PersonRegion) -> tuple[int, int, int]:
    """Frame, camera and candidate that a region means. Raises ValueError if nobody is there."""
    detected.rig.subset([region.camera])
    camera = detected.rig.names.index(region.camera)
    with_image = np.flatnonzero(detected.frames.image[:, camera] != NO_IMAGE)
    if not with_image.size:
        raise ValueError(f"region {region}: camera {region.camera} has no image")
    frame = int(with_image[0])
    points2d_px = candidates.points2d_px[frame, camera]
    share = region.share_inside(points2d_px)
    best = int(np.argmax(share))
    if share[best] < _MIN_INSIDE:
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
