"""Everybody whom a camera alone follows through its images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from fgpose.calibration.from_people.body_size import body_radius
from fgpose.calibration.from_people.left_right import with_steady_sides
from fgpose.calibration.from_people.walk import Track
from fgpose.people_observations import Detections, PeopleObservations
from fgpose.skeleton import Skeleton

# Distances in radii of the body (body_radius, about 0.5 m): a joint is expected within 0.2 of where it is predicted, as
# a wrist is from image to image at 25 Hz, and within 1.0 more for each second without an image of it.
_NEAR, _SPREAD_PER_S = 0.2, 1.0
# Mean of exp(-d^2 / 2) over the joints: half of them within 1.7 spreads.
_MIN_LIKENESS = 0.15
_LOST_S = 1.0
_MAX_PREDICTED_S = 0.5
_VELOCITY_MEMORY_S = 0.2
# False people of detectors seldom last longer.
_MIN_TRACK_S = 0.5


def find_tracks(people: PeopleObservations) -> dict[str, tuple[Track, ...]]:
    """Of each camera everybody whom it follows for half a second or more, in the order of their first images.

    Each image is matched with where those seen before are predicted (as an assignment), by the distances of the joints
    relative to the size of the body, like COCO's object keypoint similarity. Who was not seen for a second is lost, and
    begins a new track. Images in which left and right of the whole body are exchanged are put right (sides.py).
    """
    return {name: _tracks_of(people.by_camera[name], people.skeleton) for name in people.camera_names}


def no_track(camera: str, skeleton: Skeleton) -> Track:
    """Of a camera that shows nobody."""
    return Track(camera, np.zeros(0), np.zeros((0, skeleton.n_joints, 2)), np.zeros((0, skeleton.n_joints)))


def chained(tracks: Sequence[Track]) -> Track:
    """Tracks of one camera that follow each other in time, as one."""
    tracks = sorted(tracks, key=lambda track: track.time_s[0])
    in_3d = any(track.points3d_m is not None for track in tracks)
    return Track(
        tracks[0].camera,
        np.concatenate([track.time_s for track in tracks]),
        np.concatenate([track.points2d_px for track in tracks]),
        np.concatenate([track.confidence for track in tracks]),
        np.concatenate([_points3d_m(track) for track in tracks]) if in_3d else None,
    )


def _points3d_m(track: Track) -> Float[np.ndarray, "image joint 3"]:
    return np.full((*track.confidence.shape, 3), np.nan) if track.points3d_m is None else track.points3d_m


@dataclass(eq=False)
class _Followed:
    """Somebody who is followed."""

    joints_px: Float[np.ndarray, "joint 2"]
    """Where each joint was seen last, moved on with the body since."""
    radius_px: float
    time_s: float
    images: list[int]
    detections: list[int]
    velocity_pxps: Float[np.ndarray, " 2"] = field(default_factory=lambda: np.zeros(2))

    def predicted_px(self, time_s: float) -> Float[np.ndarray, "joint 2"]:
        return self.joints_px + self.velocity_pxps * min(time_s - self.time_s, _MAX_PREDICTED_S)

    def likeness(self, points2d_px: Float[np.ndarray, "person joint 2"], time_s: float) -> Float[np.ndarray, " person"]:
        """Of each detection, between 0 and 1."""
        spread_px = self.radius_px * (_NEAR + _SPREAD_PER_S * (time_s - self.time_s))
        square = np.sum((points2d_px - self.predicted_px(time_s)) ** 2, axis=-1) / (2 * spread_px**2)
        known = np.isfinite(square)
        return np.where(known, np.exp(-np.where(known, square, 0.0)), 0.0).sum(axis=-1) / np.maximum(
            known.sum(axis=-1), 1
        )

    def go_on(self, points2d_px: Float[np.ndarray, "joint 2"], image: int, detection: int, time_s: float) -> None:
        """Take a detection as the newest."""
        dt_s, predicted_px = time_s - self.time_s, self.predicted_px(time_s)
        moved_px = points2d_px - self.joints_px
        moved_px = moved_px[np.isfinite(moved_px).all(axis=-1)]
        if len(moved_px):
            gain = 1 - np.exp(-dt_s / _VELOCITY_MEMORY_S)
            self.velocity_pxps = self.velocity_pxps + gain * (np.median(moved_px, axis=0) / dt_s - self.velocity_pxps)
        seen = np.isfinite(points2d_px).all(axis=-1, keepdims=True)
        self.joints_px = np.where(seen, points2d_px, predicted_px)
        radius_px = float(body_radius(points2d_px))
        self.radius_px = radius_px if np.isfinite(radius_px) else self.radius_px
        self.time_s = time_s
        self.images.append(image)
        self.detections.append(detection)


def _tracks_of(images: Sequence[Detections], skeleton: Skeleton) -> tuple[Track, ...]:
    lasts_s = images[-1].time_s - images[0].time_s if images else 0.0
    tracks = [_track(followed, images, skeleton) for followed in _follow(images, skeleton)]
    # Of a recording that is hardly longer than that, a quarter.
    long = [track for track in tracks if np.ptp(track.time_s) >= min(_MIN_TRACK_S, lasts_s / 4)]
    return tuple(sorted(long, key=lambda track: track.time_s[0]))


def _follow(images: Sequence[Detections], skeleton: Skeleton) -> list[_Followed]:
    """Everybody, in the order in which they were lost."""
    followed: list[_Followed] = []
    lost: list[_Followed] = []
    for number, image in enumerate(images):
        lost += [person for person in followed if image.time_s - person.time_s > _LOST_S]
        followed = [person for person in followed if image.time_s - person.time_s <= _LOST_S]
        free = set(np.flatnonzero(np.isfinite(body_radius(image.points2d_px))).tolist())
        for person, detection in _matched(followed, image, skeleton):
            points2d_px = _as_before(person, image, detection, skeleton)
            person.go_on(points2d_px, number, detection, image.time_s)
            free.discard(detection)
        for detection in sorted(free):
            points2d_px = np.array(image.points2d_px[detection])
            radius_px = float(body_radius(points2d_px))
            followed.append(_Followed(points2d_px, radius_px, image.time_s, [number], [detection]))
    return lost + followed


def _matched(followed: Sequence[_Followed], image: Detections, skeleton: Skeleton) -> list[tuple[_Followed, int]]:
    from scipy.optimize import linear_sum_assignment

    if not followed or not image.n_people:
        return []
    exchanged_px = image.points2d_px[:, skeleton.mirror]
    likeness = np.array(
        [
            np.maximum(*(person.likeness(points_px, image.time_s) for points_px in (image.points2d_px, exchanged_px)))
            for person in followed
        ]
    )
    rows, columns = linear_sum_assignment(likeness, maximize=True)
    pairs = zip(rows.tolist(), columns.tolist(), strict=True)
    return [(followed[row], column) for row, column in pairs if likeness[row, column] >= _MIN_LIKENESS]


def _as_before(
    person: _Followed, image: Detections, detection: int, skeleton: Skeleton
) -> Float[np.ndarray, "joint 2"]:
    """The joints of a detection, left and right exchanged where that is more like what was seen before."""
    both_px = np.stack([image.points2d_px[detection], image.points2d_px[detection, skeleton.mirror]])
    return both_px[int(np.argmax(person.likeness(both_px, image.time_s)))]


def _track(followed: _Followed, images: Sequence[Detections], skeleton: Skeleton) -> Track:
    """Of all images from the first to the last that shows the person."""
    first, last = followed.images[0], followed.images[-1] + 1
    shape, rows = (last - first, skeleton.n_joints), np.array(followed.images) - first
    shown = list(zip(followed.images, followed.detections, strict=True))
    points2d_px, confidence = np.full((*shape, 2), np.nan), np.zeros(shape)
    points2d_px[rows] = [images[image].points2d_px[detection] for image, detection in shown]
    confidence[rows] = [images[image].confidence[detection] for image, detection in shown]
    points3d_m = None
    if any(images[image].points3d_m is not None for image in followed.images):
        points3d_m = np.full((*shape, 3), np.nan)
        for row, (image, detection) in zip(rows, shown, strict=True):
            in_image = images[image].points3d_m
            points3d_m[row] = np.nan if in_image is None else in_image[detection]
    time_s = np.array([image.time_s for image in images[first:last]])
    return with_steady_sides(Track(images[0].camera, time_s, points2d_px, confidence, points3d_m), skeleton)
