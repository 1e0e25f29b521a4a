"""The people in a recording with several candidates in each image."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from fgpose.association.image_tracker import follow_in_images
from fgpose.association.midlines import midlines
from fgpose.association.person import NOBODY, Person
from fgpose.association.space_tracker import follow_in_space
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton


def track_people(
    points2d_px: Float[np.ndarray, "frame camera person joint 2"],
    confidence: Float[np.ndarray, "frame camera person joint"],
    time_s: Float[np.ndarray, " frame"],
    rig: CameraRig,
    skeleton: Skeleton,
) -> list[Int[np.ndarray, "frame camera"]]:
    """The people whom at least two cameras see, those seen most first.

    Where no two cameras agree on anybody, because there is one only or because the calibration is wrong, every camera
    follows those whom it sees for itself; the first person is then the one whom each of them sees most.

    Args:
        points2d_px: all candidates of every image in pixels of the original image; NaN = missing.
        confidence: in [0, 1], 0 = missing.
        time_s: of each frame.
        rig: the cameras, in the order of the camera axis.
        skeleton: the joints.

    Returns:
        For each of them the index into the person axis in each image, or NOBODY where they are not found.
    """
    known = (confidence > 0) & np.isfinite(points2d_px).all(axis=-1)
    undistorted_px = _undistorted(np.where(known[..., None], points2d_px, np.nan), rig)
    midlines_px, completeness = midlines(undistorted_px, skeleton), np.where(known, confidence, 0.0).mean(axis=-1)
    people = _most_seen_first(follow_in_space(midlines_px, completeness, time_s, rig))
    if people:
        return people
    views = [
        _most_seen_first(follow_in_images(undistorted_px[:, c], midlines_px[:, c], completeness[:, c], time_s))
        for c in range(rig.n_cameras)
    ]
    nobody = np.full((len(time_s), 1), NOBODY)
    n_people = max(map(len, views))
    return [np.hstack([view[k] if k < len(view) else nobody for view in views]) for k in range(n_people)]


def _most_seen_first(people: list[Person]) -> list[Int[np.ndarray, "frame camera"]]:
    return [person.chosen for person in sorted(people, key=lambda person: -person.score)]


def _undistorted(
    points2d_px: Float[np.ndarray, "frame camera person joint 2"], rig: CameraRig
) -> Float[np.ndarray, "frame camera person joint 2"]:
    n_frames, n_cameras, n_people, n_joints, _ = points2d_px.shape
    flat_px = points2d_px.reshape(n_frames, n_cameras, n_people * n_joints, 2)
    return rig.undistort(flat_px).reshape(points2d_px.shape)
