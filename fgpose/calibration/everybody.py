"""Calibrating on everybody in a recording: who is who depends on the cameras, and the cameras on who is who."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
from jaxtyping import Int

from fgpose.association.chosen_person import each_camera_alone
from fgpose.association.recording import Association, associate
from fgpose.calibration.moved_views import moved_with_cameras
from fgpose.calibration.used_parts import Adjusted
from fgpose.config import Config
from fgpose.correspondences import NOBODY
from fgpose.estimation.evidence.plausibility import without_clipped
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.people_observations import PeopleObservations

# In simulated halls with cameras that are off by up to 2 degrees, a third changed nothing.
_MAX_ROUNDS = 2
# The kernel of the reprojection errors takes so many outliers. In simulated halls what was less than that turned no
# camera by more than a third of its prior's sigma.
_NEGLIGIBLE_SHARE = 0.05


Found = TypeVar("Found", bound=Adjusted)
Calibrate = Callable[[Sequence[Observations], CameraRig, Config], Found]
"""From the observations of each person, the rig as it was given and the parameters."""


def on_everybody(
    observations: Observations | PeopleObservations, rig: CameraRig, config: Config, calibrate: Calibrate[Found]
) -> tuple[Found, tuple[float, ...]]:
    """Calibrate on the one person, or on everybody who can be told apart with the rig.

    With the calibrated rig people are told apart again. If that gives detections to others, the calibration, still from
    the given rig, is repeated with them, twice at most.

    Returns:
        What was found, and after each calibration the share of the detected joints that belonged to somebody else with
        the new rig; none for one person.

    Raises:
        ValueError: the cameras of observations and rig differ, or as calibrate.
    """
    observations.check_cameras(rig.names)
    if isinstance(observations, Observations):
        return calibrate([without_clipped(observations, rig)], rig, config), ()
    association = _told_apart(observations, rig, config)
    found, reassigned = calibrate(_each_measured(observations, association, rig), rig, config), []
    while len(reassigned) < _MAX_ROUNDS and observations.n_most > 1:
        moved = moved_with_cameras(observations, rig, found.rig)
        before, association = association, _told_apart(moved, found.rig, config)
        reassigned.append(reassigned_share(before, association))
        if reassigned[-1] <= _NEGLIGIBLE_SHARE:
            break
        found = calibrate(_each_measured(observations, association, rig), rig, config)
    return found, tuple(reassigned)


def reassigned_share(before: Association, after: Association) -> float:
    """Of the camera where it is largest, the share of the detected joints that belong to somebody else, or now to
    nobody, or no longer to nobody.

    People of both are the same where most of their joints are (as an assignment). Joints that are nobody's either time
    do not count.
    """
    from scipy.optimize import linear_sum_assignment

    owned, now_owned = _owned_joints(before), _owned_joints(after)
    everything = np.unique(np.concatenate([np.zeros(0, dtype=int), *owned, *now_owned]))
    same = [[np.intersect1d(own, now) for now in now_owned] for own in owned]
    n_same = np.array([[each.size for each in row] for row in same]).reshape(len(owned), len(now_owned))
    pairs = zip(*linear_sum_assignment(n_same, maximize=True), strict=True)
    kept = np.concatenate([everything[:0], *(same[person][now] for person, now in pairs)])
    observations, n_cameras = before.observations, len(before.observations.camera_names)
    n_kept, n_all = (
        np.bincount(numbers // _n_joints_in_image(observations) % n_cameras, minlength=n_cameras)
        for numbers in (kept, everything)
    )
    return float(np.max(1 - n_kept / np.maximum(n_all, 1), where=n_all > 0, initial=0.0))


def everybody_of(observations: Observations | PeopleObservations, rig: CameraRig, config: Config) -> list[Observations]:
    """What the cameras saw of the one person, or of each who can be told apart with the rig."""
    if isinstance(observations, Observations):
        return [without_clipped(observations, rig)]
    return _each_measured(observations, _told_apart(observations, rig, config), rig)


def _told_apart(observations: PeopleObservations, rig: CameraRig, config: Config) -> Association:
    """Everybody; one person where no image shows more, and where no two cameras agree on anybody the one whom each
    sees most."""
    if observations.n_most <= 1:
        return Association(observations, rig, {0: observations.only()}, ())
    association = associate(observations, rig, config.tracking)
    if association.people:
        return association
    somebody = list(each_camera_alone(observations, rig).people.values())
    return Association(observations, rig, {0: (somebody or [observations.only()])[0]}, ())


def each_person(observations: PeopleObservations, association: Association) -> list[Observations]:
    """What the cameras saw of each."""
    return [observations.of_person(seen) for seen in association.people.values()]


def _each_measured(observations: PeopleObservations, association: Association, rig: CameraRig) -> list[Observations]:
    return [without_clipped(own, rig) for own in each_person(observations, association)]


def _owned_joints(association: Association) -> list[Int[np.ndarray, " joint"]]:
    """Of each person the detected joints, as numbers that are unique in the recording."""
    observations, numbers = association.observations, []
    for seen in association.people.values():
        t, c, j = np.nonzero(seen.detection != NOBODY)
        image = (seen.first_frame + t) * len(observations.camera_names) + c
        in_image = seen.detection[t, c, j] * observations.skeleton.n_joints + seen.joint[t, c, j]
        numbers.append(image * _n_joints_in_image(observations) + in_image)
    return numbers


def _n_joints_in_image(observations: PeopleObservations) -> int:
    return observations.n_most * observations.skeleton.n_joints
