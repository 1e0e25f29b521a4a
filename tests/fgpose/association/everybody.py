"""Who is who in arrays of candidates, as arrays."""

from __future__ import annotations

import numpy as np

from fgpose.association.chosen_person import associate_or_each_camera
from fgpose.correspondences import NOBODY
from fgpose.geometry.camera import CameraRig
from fgpose.people_observations import PeopleObservations
from fgpose.skeleton import Skeleton


def track_people(
    points2d_px: np.ndarray, confidence: np.ndarray, time_s: np.ndarray, rig: CameraRig, skeleton: Skeleton
) -> list[np.ndarray]:
    """For each person the place in the arrays of the detection in each image, (T, C), or NOBODY."""
    is_there = (confidence > 0).any(axis=-1)
    people = PeopleObservations.of_frames(skeleton, rig.names, time_s, points2d_px, confidence)
    places = np.argsort(~is_there, axis=-1, kind="stable")
    found = []
    for seen in associate_or_each_camera(people, rig).people.values():
        chosen = seen.in_frames(len(time_s)).main_detection
        place = np.take_along_axis(places, np.maximum(chosen, 0)[..., None], axis=-1)[..., 0]
        found.append(np.where(chosen == NOBODY, NOBODY, place))
    return found
