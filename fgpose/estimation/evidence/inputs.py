"""What estimators are given: one clear error where it is something else."""

from __future__ import annotations

from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.people_observations import PeopleObservations
from fgpose.shown.wrong_types import check_type


def check_inputs(function: str, observations: object, rig: object, wanted: type = Observations) -> None:
    """Raise TypeError, which says what to do, unless these are the observations wanted and a rig.

    Args:
        function: that was called.
        observations: its first argument.
        rig: its second.
        wanted: Observations, of one person, or PeopleObservations.
    """
    if isinstance(observations, CameraRig):
        raise TypeError(f"{function} takes the observations first, then the rig: {function}(observations, rig)")
    if wanted is Observations and isinstance(observations, PeopleObservations):
        raise TypeError(
            f"{function} takes Observations, of one person; PeopleObservations is of several people: use smooth_people"
        )
    if wanted is PeopleObservations and isinstance(observations, Observations):
        raise TypeError(
            f"{function} takes PeopleObservations; Observations is of one person: use smooth, or "
            f"{function}(PeopleObservations.of_one(observations), rig)"
        )
    check_type(function, "observations", observations, wanted)
    check_type(function, "rig", rig, CameraRig)


def check_known(function: str, rig: object, skeleton: object) -> None:
    """Raise TypeError, which says what to do, unless an online estimator is given a rig, and no rig as its skeleton."""
    if isinstance(skeleton, CameraRig):
        raise TypeError(f"{function} takes the rig first, then the skeleton: {function}(rig, skeleton)")
    check_type(function, "rig", rig, CameraRig)
