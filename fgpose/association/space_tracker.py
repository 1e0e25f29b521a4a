"""Following people in space, through all views and frames together.

The pose of the frame before is projected into every camera, each camera's candidates are assigned to the people by
their distance from it (Hungarian method, one camera after the other), and the pose is triangulated anew from the
candidates assigned. So a person who is occluded in one view, or confused with a neighbour in one view, keeps the
identity. Candidates whom nobody claims make a new person where two views agree on a place; as in Chen et al.,
"Cross-View Tracking for Multi-Human 3D Pose Estimation", 2020.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.association.midlines import comparable, median_distance, median_offset
from fgpose.association.person import NEAR_M, NOBODY, Person, matches
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate, triangulate_robust

# Views that see the same person miss each other's midline by 50 mm, and by 100 to 150 when one is off by a degree.
_AGREEMENT_M = 0.2
# Nobody begins where somebody is already: a detector may find one person twice.
_SAME_PLACE_M = 0.3
# Inlier threshold of triangulation, as a share of the diagonal of the image: 44 px at 1920 x 1080. Higher, midlines
# of different people are triangulated together; lower, a camera that is off by a degree (20 to 30 px) no longer
# agrees.
_INLIER_DIAGONALS = 0.02


def follow_in_space(
    midlines_px: Float[np.ndarray, "frame camera person feature 2"],
    completeness: Float[np.ndarray, "frame camera person"],
    time_s: Float[np.ndarray, " frame"],
    rig: CameraRig,
) -> list[Person]:
    """Everybody on whose place two cameras agree; places are metres in the world.

    Args:
        midlines_px: of all candidates, undistorted pixels; NaN = missing.
        completeness: mean confidence of each candidate.
        time_s: of each frame.
        rig: the cameras, in the order of the camera axis.
    """
    tracker = _SpaceTracker(rig, len(time_s))
    for frame, now_s in enumerate(time_s.tolist()):
        tracker.see(frame, now_s, midlines_px[frame], completeness[frame])
    tracker.turn_back()
    for frame in range(len(time_s) - 1, -1, -1):
        tracker.look_back(frame, float(time_s[frame]), midlines_px[frame], completeness[frame])
    return tracker.people


class _SpaceTracker:
    """Sees the candidates of all cameras frame by frame."""

    def __init__(self, rig: CameraRig, n_frames: int) -> None:
        self._rig = rig
        self._shape = n_frames, rig.n_cameras
        self._focal_px = np.array([camera.K[0, 0] for camera in rig.cameras])
        diagonals_px = [float(np.hypot(*camera.size_px)) for camera in rig.cameras]
        self._inlier_px = _INLIER_DIAGONALS * float(np.mean(diagonals_px))
        self.people: list[Person] = []

    def see(
        self,
        frame: int,
        time_s: float,
        midlines_px: Float[np.ndarray, "camera person feature 2"],
        completeness: Float[np.ndarray, "camera person"],
    ) -> None:
        """Find everybody in the next frame."""
        free = comparable(midlines_px)
        self._assign(self.people, frame, time_s, midlines_px, free)
        while (found := self._somebody_new(midlines_px, free)) is not None:
            person = self._person_at(found, frame, time_s)
            if person is not None:
                self._assign([person], frame, time_s, midlines_px, free)
            # Nobody can begin twice at a place, and nobody at that of somebody else.
            free &= ~(self._distances_m(found[None], midlines_px)[0] <= _AGREEMENT_M)
        for person in self.people:
            person.count(frame, completeness)
        self.people = [person for person in self.people if person.is_real(time_s)]

    def turn_back(self) -> None:
        """Put everybody where they began."""
        for person in self.people:
            person.place, person.time_s = person.first_place, person.first_time_s

    def look_back(
        self,
        frame: int,
        time_s: float,
        midlines_px: Float[np.ndarray, "camera person feature 2"],
        completeness: Float[np.ndarray, "camera person"],
    ) -> None:
        """Follow people backwards from the frame in which two views first agreed on them; one view is enough for
        that."""
        later = [person for person in self.people if person.first_time_s > time_s]
        if not later:
            return
        free = comparable(midlines_px)
        for person in self.people:
            free[person.images(frame)] = False
        self._assign(later, frame, time_s, midlines_px, free)
        for person in later:
            person.count(frame, completeness)

    def _assign(
        self,
        people: list[Person],
        frame: int,
        time_s: float,
        midlines_px: np.ndarray,
        free: Bool[np.ndarray, "camera person"],
    ) -> None:
        """Give each of these people at most one free candidate of each camera, and let them follow."""
        if not people or not free.any():
            return
        distance_m = self._distances_m(np.stack([person.place for person in people]), midlines_px)
        reach_m = np.array([person.reach_m(time_s) for person in people])
        for camera in range(self._shape[1]):
            for k, candidate in matches(distance_m[:, camera], reach_m, free[camera]):
                people[k].chosen[frame, camera] = candidate
        seen = [person for person in people if person.is_seen(frame)]
        if seen:
            self._follow(seen, frame, time_s, midlines_px)
        for person in seen:
            free[person.images(frame)] = False

    def _follow(self, people: list[Person], frame: int, time_s: float, midlines_px: np.ndarray) -> None:
        """Move people to where the views see them, and drop the views that do not agree."""
        seen_px = np.full((len(people), self._shape[1], *midlines_px.shape[2:]), np.nan)
        for k, person in enumerate(people):
            cameras, candidates = person.images(frame)
            seen_px[k, cameras] = midlines_px[cameras, candidates]
        weights = np.isfinite(seen_px).all(axis=-1).astype(float)
        positions_m = triangulate_robust(seen_px, weights, self._rig, self._inlier_px).positions_m
        for person, person_px, position_m in zip(people, seen_px, positions_m, strict=True):
            if np.isfinite(position_m).any():
                person.move(position_m, time_s)
                distance_m = self._distances_m(person.place[None], person_px[:, None])[0, :, 0]
                person.chosen[frame, ~(distance_m <= NEAR_M)] = NOBODY
            else:
                camera = int(person.images(frame)[0][0])
                person.place = self._shifted(person.place, camera, person_px[camera])

    def _shifted(self, position_m: np.ndarray, camera: int, seen_px: np.ndarray) -> np.ndarray:
        """Moved across the image to where one camera sees the person, at the same depth."""
        view = self._rig.cameras[camera]
        depth_m = view.to_camera_frame(position_m)[:, 2:]
        offset_m = median_offset((seen_px - view.project(position_m)) / self._focal_px[camera] * depth_m)
        return position_m + view.world_T_camera[:3, :2] @ offset_m

    def _distances_m(
        self, positions_m: Float[np.ndarray, "k feature 3"], midlines_px: Float[np.ndarray, "camera person feature 2"]
    ) -> Float[np.ndarray, "k camera person"]:
        """Median distance between the midline of each person and of each candidate, at the depth of the person.

        Infinite where they have too few features in common.
        """
        depth_m = np.stack([view.to_camera_frame(positions_m)[..., 2] for view in self._rig.cameras], axis=1)
        offset_px = np.linalg.norm(self._rig.project(positions_m)[:, :, None] - midlines_px, axis=-1)
        return median_distance(offset_px * (depth_m / self._focal_px[:, None])[:, :, None])

    def _somebody_new(
        self, midlines_px: np.ndarray, free: Bool[np.ndarray, "camera person"]
    ) -> Float[np.ndarray, "feature 3"] | None:
        """The place on which most cameras agree whose candidates belong to nobody yet."""
        candidates = np.argwhere(free)
        pairs = [(a, b) for a, b in combinations(candidates.tolist(), 2) if a[0] != b[0]]
        if not pairs:
            return None
        index = np.array(pairs)
        two_px = midlines_px[index[..., 0], index[..., 1]]
        projection = self._rig.projection_matrices[index[..., 0]]
        points_px = np.swapaxes(two_px, 1, 2)
        weights = np.isfinite(points_px).all(axis=-1).astype(float)
        positions_m = triangulate(points_px, weights, projection[:, None])
        distance_m = self._distances_m(positions_m, midlines_px)
        nearest_m = np.where(free, distance_m, np.inf).min(axis=-1, initial=np.inf)
        agreeing = np.asarray(nearest_m <= _AGREEMENT_M, dtype=bool)
        # More cameras first, then the smaller distance.
        quality = agreeing.sum(axis=1) - np.where(agreeing, nearest_m, 0.0).sum(axis=1) / self._shape[1]
        best = int(np.argmax(quality))
        return positions_m[best] if np.count_nonzero(agreeing[best]) >= 2 else None

    def _person_at(self, position_m: np.ndarray, frame: int, time_s: float) -> Person | None:
        """Who is at a place: somebody who was lost near there, or somebody new; None if it is taken."""
        lost: list[tuple[float, Person]] = []
        for person in self.people:
            distance_m = float(median_distance(np.linalg.norm(person.place - position_m, axis=-1)))
            if not person.is_seen(frame):
                lost.append((distance_m, person))
            elif distance_m < _SAME_PLACE_M:
                return None
        distance_m, person = min(lost, key=lambda each: each[0], default=(np.inf, None))
        if person is None or not distance_m <= person.reach_m(time_s):
            person = Person(position_m, time_s, self._shape)
            self.people.append(person)
        person.place, person.time_s = position_m, time_s
        return person
