"""One frame of all cameras as arrays, the pairs of its detections, and identity from frame to frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.association.founding import meeting
from fgpose.geometry.camera import CameraRig
from fgpose.people_observations import Detections

MIN_CONFIDENCE = 0.3
"""Joints below are not used: Pose2Sim's default, and usual in the code around the paper of Chen et al."""


@dataclass(frozen=True, eq=False)
class Frame:
    """At most one image of each camera, taken for simultaneous, and at most P detections in it; NaN: none."""

    cameras: CameraRig
    """Those that have an image."""
    points_px: Float[np.ndarray, "camera detection joint 2"]
    """Undistorted."""
    confidence: Float[np.ndarray, "camera detection joint"]

    @staticmethod
    def of(images: Sequence[Detections], rig: CameraRig) -> Frame:
        """Of these images, one at least."""
        cameras = rig.subset([image.camera for image in images])
        shape = (len(images), max(image.n_people for image in images), images[0].points2d_px.shape[1])
        frame = Frame(cameras, np.full((*shape, 2), np.nan), np.zeros(shape))
        for c, (camera, image) in enumerate(zip(cameras.cameras, images, strict=True)):
            used = image.confidence >= MIN_CONFIDENCE
            frame.points_px[c, : image.n_people] = np.where(
                used[..., None], camera.undistort(image.points2d_px), np.nan
            )
            frame.confidence[c, : image.n_people] = np.where(used, image.confidence, 0.0)
        return frame

    @property
    def known(self) -> Bool[np.ndarray, "camera detection joint"]:
        return np.asarray(np.isfinite(self.points_px).all(axis=-1))

    def pairs(self) -> Int[np.ndarray, "pair 2 2"]:
        """All pairs (camera, detection) of different views."""
        there = np.argwhere(self.known.any(axis=-1))
        chosen = [(a, b) for a, b in combinations(there.tolist(), 2) if a[0] != b[0]]
        return np.array(chosen, dtype=int).reshape(-1, 2, 2)

    def meetings(
        self, pairs: Int[np.ndarray, "pair 2 2"]
    ) -> tuple[Float[np.ndarray, "pair joint 3"], Float[np.ndarray, "pair joint"]]:
        """Where the rays of both detections are nearest to each other, and how near; NaN where one has no joint."""
        rays = np.stack([camera.ray(own) for camera, own in zip(self.cameras.cameras, self.points_px, strict=True)])
        eyes_m = self.cameras.positions_m
        (camera_a, detection_a), (camera_b, detection_b) = pairs[:, 0].T, pairs[:, 1].T
        a, b = rays[camera_a, detection_a], rays[camera_b, detection_b]
        return meeting(eyes_m[camera_a], a, eyes_m[camera_b], b)


@dataclass(eq=False)
class NearestInTime:
    """Identity over time: each pose is whoever was nearest in the frames before, the nearest pair first."""

    reach_m: float
    """Mean distance of the joints beyond which it is somebody new ..."""
    speed_mps: float
    """... which grows so fast while somebody is not found."""
    forget_s: float
    """Whoever is not found for longer is forgotten."""
    _last: dict[int, tuple[float, Float[np.ndarray, "joint 3"]]] = field(default_factory=dict)
    _n_people: int = 0

    def identified(
        self, time_s: float, poses_m: Sequence[Float[np.ndarray, "joint 3"]]
    ) -> dict[int, Float[np.ndarray, "joint 3"]]:
        """The poses of a frame by identity."""
        self._last = {person: seen for person, seen in self._last.items() if time_s - seen[0] <= self.forget_s}
        candidates = []
        for person, (seen_s, before_m) in self._last.items():
            reach_m = self.reach_m + self.speed_mps * (time_s - seen_s)
            for n, pose_m in enumerate(poses_m):
                distance_m = mean_distance_m(before_m, pose_m)
                if distance_m < reach_m:
                    candidates.append((distance_m, person, n))
        found: dict[int, Float[np.ndarray, "joint 3"]] = {}
        free = set(range(len(poses_m)))
        for _, person, n in sorted(candidates):
            if person not in found and n in free:
                found[person] = poses_m[n]
                free.remove(n)
        for n in sorted(free):
            found[self._n_people] = poses_m[n]
            self._n_people += 1
        self._last |= {person: (time_s, pose_m) for person, pose_m in found.items()}
        return found


def mean_distance_m(a_m: Float[np.ndarray, "joint 3"], b_m: Float[np.ndarray, "joint 3"]) -> float:
    """Over the joints that both have; infinite without any."""
    distance_m = np.linalg.norm(a_m - b_m, axis=-1)
    known = np.isfinite(distance_m)
    return float(distance_m[known].mean()) if known.any() else np.inf
