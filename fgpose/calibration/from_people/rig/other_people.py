"""Others than the walker, reconstructed in the rig that the walker gave: a stature may have been theirs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fgpose.calibration.from_people.body_size import INLIER_SHARE
from fgpose.calibration.from_people.rig.evidence import body_radius_px, reconstructed
from fgpose.calibration.from_people.rig.somebody_else import ELSEWHERE, offset_px
from fgpose.calibration.from_people.starts.starts import Starts
from fgpose.calibration.from_people.starts.together import seen_at
from fgpose.calibration.from_people.walk import Track, Walk
from fgpose.estimation.evidence.presence import MIN_JOINTS
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate
from fgpose.sampling import spread_evenly

_MOST_PIECES = 8  # of a camera, those seen longest: each is compared with those of all other cameras
# Of somebody who moves, by chance hardly anybody else is on the epipolar lines of all joints for so long.
_LEAST_S = 1.0
_COMPARED_FRAMES = 100


@dataclass(frozen=True, eq=False)
class OtherPerson:
    """Somebody beside the walker."""

    seen: Walk
    """In the frames of the walk."""
    joints_m: Float[np.ndarray, "frame joint 3"]
    """In the gauge of the rig; NaN = not determined, as of whom one camera alone sees."""


@dataclass(frozen=True, eq=False)
class _Piece:
    """A track in the frames of the walk, where it is not of the walker."""

    camera: int
    points2d_px: Float[np.ndarray, "frame joint 2"]
    confidence: Float[np.ndarray, "frame joint"]
    undistorted_px: Float[np.ndarray, "frame joint 2"]

    @property
    def shows(self) -> np.ndarray:
        return np.asarray((self.confidence > 0).sum(axis=-1) >= MIN_JOINTS)


def other_people(
    walk: Walk,
    tracks: Mapping[str, Sequence[Track]],
    starts: Starts,
    rig: CameraRig,
    joints_m: Float[np.ndarray, "frame joint 3"],
) -> list[OtherPerson]:
    """Who was seen beside the walker, those first whom a camera saw longest.

    Tracks of two cameras are of one person where all joints meet for a second or more.

    Args:
        walk: of the walker.
        tracks: of each camera, everybody.
        starts: the clocks of the cameras.
        rig: that the walk was calibrated to.
        joints_m: of the walk; NaN = not known.
    """
    pieces = [
        piece
        for c, name in enumerate(walk.camera_names)
        for piece in _pieces(walk, c, tracks[name], starts, rig, joints_m)
    ]
    pieces.sort(key=lambda piece: -int(piece.shows.sum()))
    found = []
    while pieces:
        group = _of_one_person(pieces, rig, max(round(_LEAST_S / max(walk.step_s, 1e-3)), 2))
        pieces = [piece for piece in pieces if piece not in group]
        seen = _together(group, walk)
        found.append(OtherPerson(seen, reconstructed(seen, rig)))
    return found


def _pieces(
    walk: Walk,
    c: int,
    tracks: Sequence[Track],
    starts: Starts,
    rig: CameraRig,
    joints_m: Float[np.ndarray, "frame joint 3"],
) -> list[_Piece]:
    """In one camera, those that are seen longest."""
    camera, found = rig.cameras[c], []
    there_px, radius_px = camera.project(joints_m), body_radius_px(walk.points2d_px[:, c])
    for track in tracks:
        points2d_px, confidence, _ = seen_at(track, starts.own_s(track.camera, walk.time_s))
        undistorted_px = camera.undistort(points2d_px)
        is_other = offset_px(undistorted_px, there_px) > ELSEWHERE * radius_px
        confidence = np.where(is_other[:, None], confidence, 0.0)
        found.append(_Piece(c, points2d_px, confidence, undistorted_px))
    long = [piece for piece in found if piece.shows.any()]
    return sorted(long, key=lambda piece: -int(piece.shows.sum()))[:_MOST_PIECES]


def _of_one_person(pieces: Sequence[_Piece], rig: CameraRig, least_frames: int) -> list[_Piece]:
    """The first, and all that fit it or one another that does; no two of one camera at once."""
    group, grows = [pieces[0]], True
    while grows:
        grows = False
        for piece in pieces:
            at_once = any(piece.camera == own.camera and (piece.shows & own.shows).any() for own in group)
            if piece in group or at_once:
                continue
            if any(_meet(piece, own, rig, least_frames) for own in group):
                group, grows = [*group, piece], True
    return group


def _meet(one: _Piece, other: _Piece, rig: CameraRig, least_frames: int) -> bool:
    """Whether the rays of two cameras to the same joints do."""
    frames = np.flatnonzero(one.shows & other.shows)
    if one.camera == other.camera or len(frames) < least_frames:
        return False
    frames = frames[spread_evenly(len(frames), _COMPARED_FRAMES)]
    pair = CameraRig((rig.cameras[one.camera], rig.cameras[other.camera]))
    points_px = np.stack([one.undistorted_px[frames], other.undistorted_px[frames]], axis=1)
    weights = np.stack([one.confidence[frames], other.confidence[frames]], axis=1)
    joints_m = triangulate(points_px.swapaxes(1, 2), weights.swapaxes(1, 2), pair.projection_matrices)
    off_px = np.linalg.norm(pair.project(joints_m) - points_px, axis=-1)
    radius_px = np.array([body_radius_px(points_px[:, c]) for c in (0, 1)])
    off = (off_px / radius_px[:, None])[(weights > 0).all(axis=1, keepdims=True).repeat(2, axis=1)]
    # Of points behind a camera there is no image.
    return bool(off.size) and float(np.median(np.nan_to_num(off, nan=np.inf))) < INLIER_SHARE


def _together(group: Sequence[_Piece], walk: Walk) -> Walk:
    points2d_px, confidence = np.full_like(walk.points2d_px, np.nan), np.zeros_like(walk.confidence)
    for piece in group:
        seen = piece.confidence > 0
        points2d_px[:, piece.camera][seen] = piece.points2d_px[seen]
        confidence[:, piece.camera][seen] = piece.confidence[seen]
    return replace(walk, points2d_px=points2d_px, confidence=confidence, points3d_m=None)
