"""Who is who: several people followed through all views and frames together.

A person is followed in space: the pose of the frame before is projected into every camera, each camera's candidates are
assigned to the people by their distance from it (Hungarian method, one camera after the other), and the pose is
triangulated anew from the candidates assigned. So a person who is hidden in one view, or whom a view confuses with a
neighbour, stays the same person. Candidates whom nobody claims make a new person where two views agree on a place; as
in Chen et al., "Cross-View Tracking for Multi-Human 3D Pose Estimation", 2020.

Of each candidate only the midline counts: the joints that have no side, and the midpoints of those that have. It is the
same whether or not a view has exchanged left and right, and arms and legs hardly move it.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate, triangulate_robust
from fgpose.io.people import NOBODY
from fgpose.skeleton import Skeleton

# A candidate belongs to a person whose midline is as near as this, and as much farther as people walk meanwhile: the
# midlines of two people side by side are about half a metre apart.
_NEAR_M = 0.4
_SPEED_M_PER_S = 2.0
_FARTHEST_M = 1.5
# Views that see the same person miss each other's midline by 50 mm, and by 100 to 150 when one is off by a degree.
_AGREEMENT_M = 0.2
# Nobody begins where somebody is already: a detector may find one person twice.
_SAME_PLACE_M = 0.3
_MIN_FEATURES = 2
_INLIER_DIAGONALS = 0.02
# Who was seen in fewer frames than this, and not for a second, was a chance agreement of views.
_MIN_FRAMES = 5
_FORGOTTEN_S = 1.0


def track_people(
    points2d_px: Float[np.ndarray, "frame camera person joint 2"],
    confidence: Float[np.ndarray, "frame camera person joint"],
    time_s: Float[np.ndarray, " frame"],
    rig: CameraRig,
    skeleton: Skeleton,
) -> list[Int[np.ndarray, "frame camera"]]:
    """The people whom at least two cameras see, those seen most first.

    Args:
        points2d_px: all candidates of every image in pixels of the original image; NaN = missing.
        confidence: in [0, 1], 0 = missing.
        time_s: of each frame.
        rig: the cameras, in the order of the camera axis.
        skeleton: the joints.

    Returns:
        For each of them the index into the person axis in each image, or NOBODY where they are not found.
    """
    features_px = _midlines(points2d_px, confidence, rig, skeleton)
    completeness = confidence.mean(axis=-1)
    tracker = _PeopleTracker(rig, confidence.shape[0])
    for frame in range(len(time_s)):
        tracker.see(frame, float(time_s[frame]), features_px[frame], completeness[frame])
    return [person.chosen for person in sorted(tracker.people, key=lambda person: -person.score)]


def _midlines(
    points2d_px: np.ndarray, confidence: np.ndarray, rig: CameraRig, skeleton: Skeleton
) -> Float[np.ndarray, "frame camera person feature 2"]:
    """Undistorted pixels of the joints without a side and of the midpoints between left and right; NaN = missing."""
    known = (confidence > 0) & np.isfinite(points2d_px).all(axis=-1)
    flat_px = np.where(known[..., None], points2d_px, np.nan)
    shape = flat_px.shape
    undistorted_px = np.stack(
        [
            view.undistort(flat_px[:, c].reshape(-1, 2)).reshape(*shape[:1], *shape[2:])
            for c, view in enumerate(rig.cameras)
        ],
        axis=1,
    )
    left, right = np.array(skeleton.left_right, dtype=int).reshape(-1, 2).T
    middle = [joint for joint in range(skeleton.n_joints) if joint not in {*left.tolist(), *right.tolist()}]
    halfway_px = (undistorted_px[..., left, :] + undistorted_px[..., right, :]) / 2
    return np.concatenate([undistorted_px[..., middle, :], halfway_px], axis=-2)


class _Person:
    """Somebody who is followed."""

    def __init__(self, position_m: Float[np.ndarray, "feature 3"], time_s: float, shape: tuple[int, int]) -> None:
        self.position_m = position_m
        self.time_s = time_s
        """When two views last agreed on the position; one alone does not tell the depth."""
        self.chosen = np.full(shape, NOBODY)
        self.score = 0.0
        self.n_frames = 0

    def reach_m(self, time_s: float) -> float:
        """How far they may be from where they were."""
        return min(_NEAR_M + _SPEED_M_PER_S * max(time_s - self.time_s, 0.0), _FARTHEST_M)


class _PeopleTracker:
    """Sees the candidates of all cameras frame by frame."""

    def __init__(self, rig: CameraRig, n_frames: int) -> None:
        self._rig = rig
        self._shape = n_frames, rig.n_cameras
        self._focal_px = np.array([camera.K[0, 0] for camera in rig.cameras])
        diagonals_px = [float(np.hypot(*camera.size_px)) for camera in rig.cameras]
        self._inlier_px = _INLIER_DIAGONALS * float(np.mean(diagonals_px))
        self.people: list[_Person] = []

    def see(
        self,
        frame: int,
        time_s: float,
        features_px: Float[np.ndarray, "camera person feature 2"],
        completeness: Float[np.ndarray, "camera person"],
    ) -> None:
        """Find everybody in the next frame."""
        n_known = np.isfinite(features_px).all(axis=-1).sum(axis=-1)
        free = np.asarray(n_known >= min(_MIN_FEATURES, features_px.shape[2]))
        self._assign(self.people, frame, time_s, features_px, free)
        while (found := self._somebody_new(features_px, free)) is not None:
            person = self._person_at(found, frame, time_s)
            if person is not None:
                self._assign([person], frame, time_s, features_px, free)
            # Nobody can begin twice at a place, and nobody at that of somebody else.
            free &= ~(self._distances_m(found[None], features_px)[0] <= _AGREEMENT_M)
        for person in self.people:
            cameras = np.flatnonzero(person.chosen[frame] != NOBODY)
            person.n_frames += len(cameras) > 0
            person.score += float(completeness[cameras, person.chosen[frame, cameras]].sum())
        self.people = [
            person for person in self.people if person.n_frames >= _MIN_FRAMES or person.time_s > time_s - _FORGOTTEN_S
        ]

    def _assign(
        self,
        people: list[_Person],
        frame: int,
        time_s: float,
        features_px: np.ndarray,
        free: Bool[np.ndarray, "camera person"],
    ) -> None:
        """Give each of these people at most one free candidate of each camera, and let them follow."""
        if not people or not free.any():
            return
        distance_m = self._distances_m(np.stack([person.position_m for person in people]), features_px)
        reach_m = np.array([person.reach_m(time_s) for person in people])
        for camera in range(self._shape[1]):
            allowed = (distance_m[:, camera] <= reach_m[:, None]) & free[camera]
            cost_m = np.where(allowed, distance_m[:, camera], 10 * _FARTHEST_M)
            for k, candidate in zip(*linear_sum_assignment(cost_m), strict=True):
                if allowed[k, candidate]:
                    people[k].chosen[frame, camera] = candidate
        for person in people:
            self._follow(person, frame, time_s, features_px)
            cameras = np.flatnonzero(person.chosen[frame] != NOBODY)
            free[cameras, person.chosen[frame, cameras]] = False

    def _follow(self, person: _Person, frame: int, time_s: float, features_px: np.ndarray) -> None:
        """Move a person to where the views see them, and drop the views that do not agree."""
        seen_px = np.full(features_px[:, 0].shape, np.nan)
        cameras = np.flatnonzero(person.chosen[frame] != NOBODY)
        seen_px[cameras] = features_px[cameras, person.chosen[frame, cameras]]
        position_m = triangulate_robust(
            seen_px, np.isfinite(seen_px).all(axis=-1).astype(float), self._rig, self._inlier_px
        ).positions_m
        known = np.asarray(np.isfinite(position_m).all(axis=-1))
        if known.any():
            # What is not seen moves along.
            step_m = _median(position_m - person.position_m)
            position_m = np.where(known[:, None], position_m, person.position_m + step_m)
            distance_m = self._distances_m(position_m[None], seen_px[:, None])[0, :, 0]
            person.chosen[frame, ~(distance_m <= _AGREEMENT_M)] = NOBODY
            person.position_m, person.time_s = position_m, time_s
        elif len(cameras):
            person.position_m = self._shifted(person.position_m, int(cameras[0]), seen_px[cameras[0]])

    def _shifted(self, position_m: np.ndarray, camera: int, seen_px: np.ndarray) -> np.ndarray:
        """Moved across the image to where one camera sees the person, at the same depth."""
        view = self._rig.cameras[camera]
        depth_m = view.to_camera_frame(position_m)[:, 2:]
        offset_m = _median((seen_px - view.project(position_m)) / self._focal_px[camera] * depth_m)
        return position_m + view.world_T_camera[:3, :2] @ offset_m

    def _distances_m(
        self, positions_m: Float[np.ndarray, "k feature 3"], features_px: Float[np.ndarray, "camera person feature 2"]
    ) -> Float[np.ndarray, "k camera person"]:
        """Median distance between the midline of each person and of each candidate, at the depth of the person.

        Infinite where they have too few features in common.
        """
        depth_m = np.stack([view.to_camera_frame(positions_m)[..., 2] for view in self._rig.cameras], axis=1)
        offset_px = np.linalg.norm(self._rig.project(positions_m)[:, :, None] - features_px, axis=-1)
        distance_m = offset_px * (depth_m / self._focal_px[:, None])[:, :, None]
        common = np.isfinite(distance_m).sum(axis=-1)
        enough = common >= min(_MIN_FEATURES, distance_m.shape[-1])
        # Sorting puts NaN last, so the median of what is known lies in the middle of the beginning.
        middle = np.maximum(common - 1, 0) // 2
        median_m = np.take_along_axis(np.sort(distance_m, axis=-1), middle[..., None], axis=-1)[..., 0]
        return np.where(enough, median_m, np.inf)

    def _somebody_new(
        self, features_px: np.ndarray, free: Bool[np.ndarray, "camera person"]
    ) -> Float[np.ndarray, "feature 3"] | None:
        """The place on which most cameras agree whose candidates belong to nobody yet."""
        candidates = np.argwhere(free)
        pairs = [(a, b) for a, b in combinations(candidates.tolist(), 2) if a[0] != b[0]]
        if not pairs:
            return None
        index = np.array(pairs)
        two_px = features_px[index[..., 0], index[..., 1]]
        projection = self._rig.projection_matrices[index[..., 0]]
        points_px = np.swapaxes(two_px, 1, 2)
        weights = np.isfinite(points_px).all(axis=-1).astype(float)
        positions_m = triangulate(points_px, weights, projection[:, None])
        distance_m = self._distances_m(positions_m, features_px)
        nearest_m = np.where(free, distance_m, np.inf).min(axis=-1, initial=np.inf)
        agreeing = np.asarray(nearest_m <= _AGREEMENT_M, dtype=bool)
        # More cameras first, then the smaller distance.
        quality = agreeing.sum(axis=1) - np.where(agreeing, nearest_m, 0.0).sum(axis=1) / self._shape[1]
        best = int(np.argmax(quality))
        return positions_m[best] if np.count_nonzero(agreeing[best]) >= 2 else None

    def _person_at(self, position_m: np.ndarray, frame: int, time_s: float) -> _Person | None:
        """Who is at a place: somebody who was lost near there, or somebody new; None if it is taken."""
        lost: list[tuple[float, _Person]] = []
        for person in self.people:
            distance_m = float(np.linalg.norm(_median(person.position_m - position_m)))
            if (person.chosen[frame] == NOBODY).all():
                lost.append((distance_m, person))
            elif distance_m < _SAME_PLACE_M:
                return None
        distance_m, person = min(lost, key=lambda each: each[0], default=(np.inf, None))
        if person is None or not distance_m <= person.reach_m(time_s):
            person = _Person(position_m, time_s, self._shape)
            self.people.append(person)
        person.position_m, person.time_s = position_m, time_s
        return person


def _median(offsets: Float[np.ndarray, "feature axis"]) -> Float[np.ndarray, " axis"]:
    """Over the features that are known; zero if none is."""
    known = offsets[np.isfinite(offsets).all(axis=-1)]
    return np.median(known, axis=0) if len(known) else np.zeros(offsets.shape[-1])
