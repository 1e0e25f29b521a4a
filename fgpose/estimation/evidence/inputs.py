"""What estimators are given: one clear error where it is something else."""

from __future__ import annotations

from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.people_observations import PeopleObservations


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
    for what, given, kind in (("observations", observations, wanted), ("rig", rig, CameraRig)):
        if not isinstance(given, kind):
            raise TypeError(f"{function}: {what} must be {kind.__name__}, got {type(given).__name__}")
