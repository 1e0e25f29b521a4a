"""Whose every detection of a camera is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fgpose.association.recording import Association
from fgpose.association.tracked import Tracked
from fgpose.frame_matching import NO_IMAGE
from fgpose.people import NOBODY, Detections


@dataclass(frozen=True, eq=False)
class OwnedDetections:
    """Everybody whom one camera detected, image by image."""

    frame: Int[np.ndarray, " detection"]
    """In which frame of the recording the detection is; increasing."""
    points2d_px: Float[np.ndarray, "detection joint 2"]
    """Pixels of the original image; NaN: not detected."""
    owner: Int[np.ndarray, "detection joint"]
    """Whose joint it is, or NOBODY."""

    @staticmethod
    def of(association: Association, camera: int) -> OwnedDetections:
        """Of one camera of the association, in all of its frames."""
        image_of = association.frames.image[:, camera]
        images = association.observations.by_camera[association.rig.names[camera]]
        shown = [(t, images[image_of[t]]) for t in np.flatnonzero(image_of != NO_IMAGE).tolist()]
        n_joints = association.observations.skeleton.n_joints
        points2d_px = np.concatenate([np.zeros((0, n_joints, 2)), *(image.points2d_px for _, image in shown)])
        frame = np.repeat([t for t, _ in shown], [image.n_people for _, image in shown]).astype(int)
        owner = np.full(points2d_px.shape[:2], NOBODY)
        for person, seen in association.people.items():
            number = seen.detection[:, camera]
            t, j = np.nonzero(number != NOBODY)
            first = np.searchsorted(frame, seen.first_frame + t)
            owner[first + number[t, j], seen.joint[t, camera, j]] = person
        return OwnedDetections(frame, points2d_px, owner)

    @staticmethod
    def nothing(n_joints: int) -> OwnedDetections:
        """Of a camera that detected nobody."""
        return OwnedDetections(np.zeros(0, dtype=int), np.zeros((0, n_joints, 2)), np.zeros((0, n_joints), dtype=int))

    @staticmethod
    def of_image(image: Detections, people: Sequence[Tracked]) -> OwnedDetections:
        """Of one image, the newest of its camera; it is in frame 0."""
        owner = np.full(image.confidence.shape, NOBODY)
        for each in people:
            if image.camera in each.seen:
                detection, joint = each.seen[image.camera]
                known = detection != NOBODY
                owner[detection[known], joint[known]] = each.person
        return OwnedDetections(np.zeros(image.n_people, dtype=int), image.points2d_px, owner)

    def n_unused(self, n_frames: int) -> Int[np.ndarray, " frame"]:
        """How many detections of each frame belong to nobody."""
        return np.bincount(self.frame[(self.owner == NOBODY).all(axis=1)], minlength=n_frames)
