"""What is said of arguments of another type than the one that is needed."""

from __future__ import annotations

from pathlib import Path

_READERS = {
    "CameraRig": "load_rig",
    "Observations": "load_observations",
    "PeopleObservations": "load_people",
    "Trajectory": "load_trajectory",
}
_MAKERS = {
    ("Observations", "Trajectory"): "smooth(observations, rig) gives one",
    ("PeopleObservations", "Trajectory"): "smooth_people(observations, rig) gives one of each person",
}


def check_type(function: str, what: str, given: object, kind: type) -> None:
    """Raise TypeError, which says how to come by the right one, unless an argument is of the type wanted.

    Args:
        function: that was called.
        what: the name of the argument.
        given: the argument.
        kind: wanted.
    """
    if isinstance(given, kind):
        return
    remedy = _MAKERS.get((type(given).__name__, kind.__name__), "")
    if isinstance(given, str | Path) and kind.__name__ in _READERS:
        remedy = f"{_READERS[kind.__name__]} reads one from a file"
    said = f": fgpose.{remedy}" if remedy else ""
    raise TypeError(f"{function}: {what} must be {kind.__name__}, got {type(given).__name__}{said}")
