"""Cameras whose network takes a thing for the person: its keypoints stay where they are while the person moves."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from fgpose.diagnosis.examined import Examined
from fgpose.finding import Code, Finding, Severity
from fgpose.observations import Observations
from fgpose.sampling import stretches, usual_step_s

# Joints of a thing tremble by 0.5 % of its size in the image, as networks err. Those of somebody who works or walks
# move by 5 % in a second, those of somebody who stands by as little as a thing, but in all views alike: where one view
# shows so little of people, two others show twice as much at most.
_SECOND_S, _FEWEST_FRAMES = 1.0, 6
_STILL, _MOVES, _FAR_LESS = 0.015, 0.03, 0.3
_REPEATED = 1e-6  # images that are the same to the last digit: see frozen_cameras
_FEWEST_SECONDS, _FEWEST_CAMERAS = 2, 3
_FEWEST_JOINTS = 5


@dataclass(frozen=True, eq=False)
class Things:
    """In which frames each camera shows something that stands still while others show somebody move."""

    of: Mapping[int, Bool[np.ndarray, "frame camera"]]
    """By person."""

    @staticmethod
    def among(examined: Examined) -> Things:
        of = {person: _still(seen) for person, seen in examined.people.items()}
        return Things({person: still for person, still in of.items() if still.any()})

    def as_missing(self, examined: Examined) -> Examined:
        """Without what is of things: it says nothing of clocks and poses."""
        without = {person: _without(examined.people[person], still) for person, still in self.of.items()}
        return replace(examined, people={**examined.people, **without}) if without else examined

    def findings(self, examined: Examined) -> list[Finding]:
        return [
            _finding(examined, person, camera, still[:, camera])
            for person, still in self.of.items()
            for camera in np.flatnonzero(still.any(axis=0)).tolist()
        ]


def _without(seen: Observations, still: Bool[np.ndarray, "frame camera"]) -> Observations:
    return seen.without(np.broadcast_to(still[:, :, None], seen.seen.shape))


def _still(seen: Observations) -> Bool[np.ndarray, "frame camera"]:
    """By whole seconds."""
    still = np.zeros(seen.seen.shape[:2], dtype=bool)
    per_second = round(_SECOND_S / usual_step_s(seen.frame_time_s))
    n_seconds = seen.n_frames // max(per_second, 1)
    if per_second < _FEWEST_FRAMES or n_seconds < _FEWEST_SECONDS or seen.n_cameras < _FEWEST_CAMERAS:
        return still
    seconds_px = seen.points2d_px[: n_seconds * per_second].reshape(n_seconds, per_second, *seen.points2d_px.shape[1:])
    moved = np.stack([_moved(seconds_px[:, :, c]) for c in range(seen.n_cameras)], axis=1)
    others = np.stack([_as_two_show(np.delete(moved, c, axis=1)) for c in range(moved.shape[1])], axis=1)
    found = (moved > _REPEATED) & (moved < _STILL) & (others > _MOVES) & (moved < _FAR_LESS * others)
    for c in range(found.shape[1]):
        for first, end in stretches(found[:, c]):
            if end - first >= _FEWEST_SECONDS and _stays(seconds_px[first:end, :, c]):
                still[:, c] |= _at_its_place(seen.points2d_px[:, c], slice(first * per_second, end * per_second))
    return still


def _as_two_show(moved: Float[np.ndarray, "second camera"]) -> Float[np.ndarray, " second"]:
    """By how much the body moves as two cameras at least show it: one alone may show another time."""
    return np.sort(np.nan_to_num(moved), axis=1)[:, -2]


def _moved(seconds_px: Float[np.ndarray, "second frame joint 2"]) -> Float[np.ndarray, " second"]:
    """Standard deviation of the joints within each second over the extent of them all, the median; NaN where too few
    are seen."""
    known = np.isfinite(seconds_px).all(axis=-1).mean(axis=1) > 0.5
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of joints that are not seen
        deviation_px = np.linalg.norm(np.nanstd(seconds_px, axis=1), axis=-1)
        middle_px = np.where(known[..., None], np.nanmean(seconds_px, axis=1), np.nan)
        moved = np.nanmedian(np.where(known, deviation_px, np.nan), axis=-1) / _extent_px(middle_px)
    return np.where(known.sum(axis=-1) >= _FEWEST_JOINTS, moved, np.nan)


def _extent_px(places_px: Float[np.ndarray, "*images joint 2"]) -> Float[np.ndarray, "*images"]:
    """Diagonal of what holds all joints."""
    return np.asarray(np.linalg.norm(np.nanmax(places_px, axis=-2) - np.nanmin(places_px, axis=-2), axis=-1))


def _stays(seconds_px: Float[np.ndarray, "second frame joint 2"]) -> bool:
    """Whether it is at the same place all the time, where slow walkers move on."""
    return bool(_moved(seconds_px.reshape(1, -1, *seconds_px.shape[2:]).astype(float))[0] < _STILL)


def _at_its_place(points_px: Float[np.ndarray, "frame joint 2"], known: slice) -> Bool[np.ndarray, " frame"]:
    """In which frames a camera shows the thing of some of them: for parts of seconds too, and whenever it comes back to
    it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of joints that are not seen
        place_px = np.nanmean(points_px[known], axis=0, dtype=float)
        away = np.nanmedian(np.linalg.norm(points_px - place_px, axis=-1), axis=-1) / _extent_px(place_px)
    return np.asarray(away < 2 * _STILL)


def _finding(examined: Examined, person: int, camera: int, still: Bool[np.ndarray, " frame"]) -> Finding:
    time_s, name = examined.people[person].frame_time_s, examined.rig.names[camera]
    times = [(float(time_s[first]), float(time_s[end - 1])) for first, end in stretches(still)]
    from_s, to_s = max(times, key=lambda each: each[1] - each[0])
    more = f", and {len(times) - 1} more times" if len(times) > 1 else ""
    return Finding(
        Code.THING_FOR_PERSON,
        Severity.DOUBTFUL,
        f"The keypoints of {name} stay where they are from {from_s:.1f} to {to_s:.1f} s{more}, while others show the "
        "person move: its network takes a thing for the person",
        f"Look at the images of {name}; leave its detections of that time out.",
        0.4,
        camera=name,
        person=examined.number(person),
        from_s=from_s,
        to_s=to_s,
        numbers={"share": float(still.mean())},
    )
