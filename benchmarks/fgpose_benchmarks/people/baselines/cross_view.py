"""Tracking across views, image by image, after Chen et al. (Cross-View Tracking for Multi-Human 3D Pose Estimation at
over 100 FPS, CVPR 2020) with the affinity and the life of tracks of Chu et al. (Part-Aware Measurement for Robust
Multi-View Multi-Human 3D Pose Estimation and Tracking, CVPR workshops 2021).

The detections of an image, at its own time, are given to the tracks by the Hungarian method; a track's joints are
triangulated from its newest detection in each view, older ones counting less; what is left over of the images of a
frame is grouped by epipolar distance and founds tracks. The grouping is greedy, not the papers' integer programme.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.triangulation import triangulate
from fgpose.people_observations import Detections
from fgpose_benchmarks.people.baselines.frame import MIN_CONFIDENCE
from fgpose_benchmarks.people.recording import PeopleRecording, Poses

# Weights and thresholds of the affinity in the image and of the ray in space; decays of the affinity and of the weights
# in the triangulation with time (Chen: w_2D, w_3D, lambda_a, lambda_t; Chu: alpha_2D, alpha_3D).
_IMAGE_WEIGHT, _RAY_WEIGHT = 0.4, 0.6
_IMAGE_PX, _RAY_M = 70.0, 0.15
_AFFINITY_DECAY_HZ, _VIEW_DECAY_HZ = 5.0, 10.0
# Detections of different views that may be of one person, and whole groups that found a track.
_PAIR_PX, _NEW_PX = 60.0, 30.0
_HITS, _MISSES = 3, 10  # frames
# Ours: newest detections of other views that still count, and how far back the velocity reaches.
_VIEWS_S, _VELOCITY_S = 0.2, 0.2
_MIN_JOINTS = 5


def cross_view(recording: PeopleRecording) -> list[Poses]:
    """Everybody in every frame of a recording: the confirmed tracks that an image of the frame has shown."""
    tracker = CrossViewTracker(recording.rig)
    return [tracker.update(time_s, images) for time_s, images in recording.images()]


@dataclass(frozen=True, eq=False)
class _Detection:
    camera: int
    time_s: float
    points_px: Float[np.ndarray, "joint 2"]
    """Undistorted; NaN: none."""


@dataclass(eq=False)
class _Track:
    number: int
    positions_m: Float[np.ndarray, "joint 3"]
    time_s: float
    views: dict[int, _Detection]
    """The newest detection in each camera."""
    n_hits: int = 0
    n_misses: int = 0
    history: list[tuple[float, Float[np.ndarray, "joint 3"]]] = field(default_factory=list)

    def predicted_m(self, time_s: float) -> Float[np.ndarray, "joint 3"]:
        """With the velocity of the last positions, a line of least squares; at rest where it is not known."""
        times_s = np.array([at_s for at_s, _ in self.history])
        lever_s = times_s - times_s.mean() if len(times_s) else times_s
        if not (lever_s**2).sum() > 0:
            return self.positions_m
        velocity_mps = np.einsum("t,tjc->jc", lever_s, np.stack([m for _, m in self.history])) / (lever_s**2).sum()
        return self.positions_m + np.nan_to_num(velocity_mps) * (time_s - self.time_s)

    def see(self, detection: _Detection, cameras: CameraRig) -> None:
        """Triangulate from the newest detections of all views; joints of fewer than two views are predicted."""
        self.views[detection.camera] = detection
        now_s = max(self.time_s, detection.time_s)
        own = [view for view in self.views.values() if now_s - view.time_s <= _VIEWS_S]
        points_px = np.stack([view.points_px for view in own], axis=1)
        weights = np.exp(-_VIEW_DECAY_HZ * np.array([now_s - view.time_s for view in own]))
        matrices = cameras.projection_matrices[[view.camera for view in own]]
        seen_m = triangulate(points_px, np.broadcast_to(weights, points_px.shape[:2]).copy(), matrices)
        self.positions_m = np.where(np.isfinite(seen_m), seen_m, self.predicted_m(now_s))
        self.time_s = now_s
        # All cameras at once make one position of the history, the last.
        recent = [(at_s, m) for at_s, m in self.history if now_s - _VELOCITY_S <= at_s < now_s - 1e-6]
        self.history = [*recent, (now_s, self.positions_m)]


class CrossViewTracker:
    """Follows everybody; see the module."""

    def __init__(self, rig: CameraRig) -> None:
        self._rig = rig
        self._tracks: list[_Track] = []
        self._n_tracks = 0

    def update(self, time_s: float, images: Sequence[Detections]) -> dict[int, Float[np.ndarray, "joint 3"]]:
        """The images of a frame, at most one of each camera, then everybody at the time of the frame, by identity."""
        seen: set[int] = set()
        left: list[_Detection] = []
        for image in sorted(images, key=lambda image: image.time_s):
            left += self._take(_detections(image, self._rig), seen)
        for track in self._tracks:
            found = track.number in seen
            track.n_hits += found
            track.n_misses = 0 if found else track.n_misses + 1
        # Who is not confirmed yet must be found in every frame.
        self._tracks = [track for track in self._tracks if track.n_misses <= (_MISSES if track.n_hits >= _HITS else 0)]
        self._found(left)
        shown = [track for track in self._tracks if track.n_hits >= _HITS and track.number in seen]
        return {track.number: track.predicted_m(time_s) for track in shown}

    def _take(self, detections: list[_Detection], seen: set[int]) -> list[_Detection]:
        """Give the detections of one image to the tracks; those that are left over."""
        from scipy.optimize import linear_sum_assignment

        if not detections or not self._tracks:
            return detections
        affinity = np.array([self._affinities(track, detections) for track in self._tracks])
        taken = set()
        for k, n in zip(*linear_sum_assignment(np.maximum(affinity, 0.0), maximize=True), strict=True):
            if affinity[k, n] > 0:
                self._tracks[k].see(detections[n], self._rig)
                seen.add(self._tracks[k].number)
                taken.add(n)
        return [detection for n, detection in enumerate(detections) if n not in taken]

    def _affinities(self, track: _Track, detections: list[_Detection]) -> Float[np.ndarray, " detection"]:
        """Mean over the joints; at most 1, negative beyond the thresholds."""
        time_s = detections[0].time_s
        camera = self._rig.cameras[detections[0].camera]
        points_px = np.stack([detection.points_px for detection in detections])
        expected_m = track.predicted_m(time_s)
        of_image = 1.0 - np.linalg.norm(points_px - camera.project(expected_m), axis=-1) / _IMAGE_PX
        to_joint_m, rays = expected_m - camera.position_m, camera.ray(points_px)
        of_ray = 1.0 - np.linalg.norm(np.cross(rays, to_joint_m), axis=-1) / _RAY_M
        affinity = _IMAGE_WEIGHT * of_image + _RAY_WEIGHT * of_ray
        known = np.isfinite(affinity)
        mean = np.where(known, affinity, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
        return np.asarray(mean * np.exp(-_AFFINITY_DECAY_HZ * max(time_s - track.time_s, 0.0)))

    def _found(self, left: list[_Detection]) -> None:
        """New tracks: groups of left-over detections of different views that agree with each other."""
        distance_px = np.array([[self._epipolar_px(a, b) for b in left] for a in left]).reshape(len(left), len(left))
        groups = [[n] for n in range(len(left))]
        pairs = [(distance_px[a, b], a, b) for a in range(len(left)) for b in range(a)]
        for apart_px, a, b in sorted(pairs):
            first, second = (next(group for group in groups if n in group) for n in (a, b))
            cameras = [left[n].camera for n in (*first, *second)]
            if apart_px >= _PAIR_PX or first is second or len(set(cameras)) < len(cameras):
                continue
            if distance_px[np.ix_(first, second)].mean() < _PAIR_PX:
                groups.remove(second)
                first += second
        for group in groups:
            among_px = distance_px[np.ix_(group, group)][~np.eye(len(group), dtype=bool)]
            if len(group) > 1 and among_px.mean() < _NEW_PX:
                self._begin([left[n] for n in group])

    def _begin(self, group: list[_Detection]) -> None:
        newest_s = max(detection.time_s for detection in group)
        nowhere_m = np.full((len(group[0].points_px), 3), np.nan)
        track = _Track(self._n_tracks, nowhere_m, newest_s, {each.camera: each for each in group}, n_hits=1)
        track.see(group[0], self._rig)
        if np.isfinite(track.positions_m).all(axis=-1).sum() >= _MIN_JOINTS:
            self._tracks.append(track)
            self._n_tracks += 1

    def _epipolar_px(self, a: _Detection, b: _Detection) -> float:
        """Mean distance of the joints of each from the epipolar lines of the other; infinite within a view."""
        if a.camera == b.camera:
            return np.inf
        first, second = self._rig.cameras[a.camera], self._rig.cameras[b.camera]
        distance_px = np.concatenate([_from_lines_px(first, second, a, b), _from_lines_px(second, first, b, a)])
        known = np.isfinite(distance_px)
        return float(distance_px[known].mean()) if known.sum() >= 2 * _MIN_JOINTS else np.inf


def _detections(image: Detections, rig: CameraRig) -> list[_Detection]:
    camera = rig.names.index(image.camera)
    points_px = rig.cameras[camera].undistort(image.points2d_px)
    points_px = np.where((image.confidence >= MIN_CONFIDENCE)[..., None], points_px, np.nan)
    return [_Detection(camera, image.time_s, own_px) for own_px in points_px if np.isfinite(own_px).any()]


def _from_lines_px(first: Camera, second: Camera, a: _Detection, b: _Detection) -> Float[np.ndarray, " joint"]:
    """Distance of the joints in the second view from the images of the rays of those in the first."""
    # The line through the images of the first camera's centre and of another point of the ray.
    projection = second.K @ second.camera_T_world[:3]
    centre = projection @ np.append(first.position_m, 1.0)
    along = first.ray(a.points_px) @ projection[:, :3].T
    line = np.cross(centre, along)
    homogeneous = np.concatenate([b.points_px, np.ones((len(b.points_px), 1))], axis=-1)
    return np.abs(np.sum(line * homogeneous, axis=-1)) / np.linalg.norm(line[:, :2], axis=-1)
