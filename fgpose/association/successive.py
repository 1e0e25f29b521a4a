"""Several people one after the other, where no image shows more than one.

Such a recording looks like that of one person. Who comes is somebody else where nobody can have run so far, or where
bones, looks and place are far more probable of two people than of one: by the odds at which somebody is recognised, the
other way round. Otherwise the one who is there is taken to have come back.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from fgpose.association.identity.likeness import RECOGNISED, Passage
from fgpose.association.recording import Association, Progress, associate
from fgpose.correspondences import NOBODY, Seen
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate_robust
from fgpose.observations import Observations
from fgpose.parameters import TrackingConfig
from fgpose.people_observations import PeopleObservations
from fgpose.sampling import parts_of

# Who is located without such a gap, and never farther away than somebody can run meanwhile, is one person.
_GAP_S, _RUNS_MPS, _NEAR_M = 0.25, 6.0, 0.5
_SOME_JOINTS, _SOME_FRAMES = 6, 3  # their median tells where somebody is
# Who is there for less is a false detection, or not worth a result.
_LEAST_S = 1.0
# Two whose times overlap by more of the shorter time are not one after the other: cameras disagree about one person.
_LEAST_ALONE = 0.75


@dataclass(frozen=True)
class Replacement:
    """Somebody comes after somebody has gone."""

    gone_s: float
    come_s: float
    before: int
    after: int
    """Numbers of the people; the same where it is taken to be the same person."""
    is_somebody_else: bool
    """Whether it is nobody who was there before."""
    away_m: float
    """How far from where somebody was seen last the next one is seen first."""
    log_odds: float
    """That it is the same person, against that it is another one, by bones, looks and place."""

    @property
    def is_too_far(self) -> bool:
        """Whether nobody can have run so far meanwhile."""
        return self.away_m > _NEAR_M + _RUNS_MPS * (self.come_s - self.gone_s)

    def __str__(self) -> str:
        when = f"who comes at {self.come_s:.1f} s, after somebody has gone at {self.gone_s:.1f} s,"
        why = f"{self.away_m:.1f} m away; log odds of the same person, by bones and place: {self.log_odds:.1f}"
        if self.is_somebody_else:
            return f"{when} is somebody else ({why})"
        if self.after != self.before:
            return f"{when} is person {self.after} again ({why})"
        if self.log_odds >= RECOGNISED:
            return f"{when} is the same person ({why})"
        return f"{when} is taken for the same person, but may be somebody else ({why})"


@dataclass(frozen=True, eq=False)
class Succession:
    """Who is there one after the other."""

    association: Association
    """Of these people."""
    changes: tuple[Replacement, ...]

    @property
    def n_people(self) -> int:
        return len(self.association.people)


def successive(
    people: Observations | PeopleObservations,
    rig: CameraRig,
    config: TrackingConfig | None = None,
    progress: Progress | None = None,
) -> Succession | None:
    """Who is there one after the other, where no image shows more than one; None where nobody comes after somebody has
    gone.

    Args:
        people: at most one in each image; or as of one person.
        rig: their cameras.
        config: how people are told apart.
        progress: told after every frame, if it takes a look at each.
    """
    if rig.n_cameras < 2:
        return None
    is_of_one = isinstance(people, Observations)
    places = _Places.of(people if is_of_one else people.of_person(people.only()), rig)
    if not places.may_change:
        return None
    association = associate(PeopleObservations.of_one(people) if is_of_one else people, rig, config, progress)
    groups, changes = _grouped(association, places)
    if not changes:
        return None
    merged = {person: _together(association, numbers) for person, numbers in groups.items()}
    numbers = {own: person for person, group in groups.items() for own in group}
    events = tuple(
        replace(event, person=numbers[event.person]) for event in association.events if event.person in numbers
    )
    return Succession(replace(association, people=merged, events=events), changes)


@dataclass(frozen=True, eq=False)
class _Places:
    """Where somebody is, in the frames in which two cameras agree."""

    time_s: Float[np.ndarray, " located"]
    middle_m: Float[np.ndarray, "located 3"]

    @staticmethod
    def of(seen: Observations, rig: CameraRig) -> _Places:
        joints = np.unique(np.linspace(0, seen.skeleton.n_joints - 1, _SOME_JOINTS).astype(int))
        middle_m = np.full((seen.n_frames, 3), np.nan)
        for part in parts_of(seen.n_frames):
            points_px = rig.undistort(seen.points2d_px[part][:, :, joints])
            some_m = triangulate_robust(points_px, seen.confidence[part][:, :, joints], rig).positions_m
            located = np.isfinite(some_m).all(axis=-1).any(axis=-1)
            middle_m[part][located] = np.nanmedian(some_m[located], axis=1)
        located = np.isfinite(middle_m).all(axis=-1)
        return _Places(seen.frame_time_s[located], middle_m[located])

    @property
    def may_change(self) -> bool:
        """Whether somebody is away for a moment, or farther away from one frame to the next than a person can be."""
        return bool(self._breaks.any())

    @cached_property
    def _breaks(self) -> Bool[np.ndarray, " step"]:
        """After which of the places somebody is away, or farther away than a person can be."""
        step_s, moved_m = np.diff(self.time_s), np.linalg.norm(np.diff(self.middle_m, axis=0), axis=-1)
        return np.asarray((step_s > _GAP_S) | (moved_m > _NEAR_M + _RUNS_MPS * step_s))

    def last_before_s(self, come_s: float) -> float:
        """When somebody was there last before who comes; that moment if nobody was. Who comes is followed a few images
        after they are seen."""
        begin_s = self.time_s[1:]
        breaks = np.flatnonzero(self._breaks & (begin_s <= come_s) & (begin_s > come_s - _GAP_S))
        before_s = self.time_s[: breaks[-1] + 1] if len(breaks) else self.time_s[self.time_s < come_s]
        return float(before_s[-1]) if len(before_s) else come_s

    def until_m(self, gone_s: float) -> Float[np.ndarray, " 3"]:
        """The last places until then; NaN if unknown."""
        return _median_m(self.middle_m[self.time_s <= gone_s][-_SOME_FRAMES:])

    def away_m(self, gone_s: float, come_s: float) -> float:
        """Distance between the last places until somebody has gone and the first of who comes; 0 if unknown."""
        after_m = _median_m(self.middle_m[self.time_s >= come_s][:_SOME_FRAMES])
        return float(np.nan_to_num(np.linalg.norm(after_m - self.until_m(gone_s))))


def _median_m(places_m: Float[np.ndarray, "some 3"]) -> Float[np.ndarray, " 3"]:
    return np.median(places_m, axis=0) if len(places_m) else np.full(3, np.nan)


def _grouped(association: Association, places: _Places) -> tuple[dict[int, list[int]], tuple[Replacement, ...]]:
    """The people of an association as numbers of those who are one person, and who came after whom."""
    time_s = association.frames.frame_time_s
    spans_s = {person: _span_s(seen, time_s) for person, seen in association.people.items()}
    in_order = sorted((n for n, (begin, end) in spans_s.items() if end - begin >= _LEAST_S), key=lambda n: spans_s[n])
    groups: dict[int, list[int]] = {}
    changes = []
    newest: int | None = None
    for person in in_order:
        begin_s, end_s = spans_s[person]
        if newest is not None:
            gone_s = max(spans_s[own][1] for group in groups.values() for own in group)
            if gone_s - begin_s > (1 - _LEAST_ALONE) * (end_s - begin_s):
                continue
            # Where one camera went on with somebody, nobody knows: no image shows two.
            gone_s = min(gone_s, places.last_before_s(begin_s))
            odds = {
                who: _log_odds(association._passages, group, person, gone_s, places) for who, group in groups.items()
            }
            likely = max(odds, key=lambda who: odds[who])
            change = Replacement(gone_s, begin_s, newest, likely, False, places.away_m(gone_s, begin_s), odds[likely])
            # Who has just gone cannot be far away; somebody who was here before that may have come back.
            if change.log_odds <= -RECOGNISED or (likely == newest and change.is_too_far):
                change = replace(change, after=len(groups), is_somebody_else=True)
            changes.append(change)
            newest = change.after
        else:
            newest = 0
        groups.setdefault(newest, []).append(person)
    return groups, tuple(changes)


def _span_s(seen: Seen, time_s: Float[np.ndarray, " frame"]) -> tuple[float, float]:
    own_s = time_s[seen.frames]
    return float(own_s[0]), float(own_s[-1])


def _log_odds(
    passages: Mapping[int, tuple[Passage, ...]], before: list[int], after: int, gone_s: float, places: _Places
) -> float:
    """That somebody is one who was there before, until then, against that it is anybody."""
    places_m = np.array(
        [place_m for own in passages.values() for each in own for place_m in (each.begin_m, each.end_m)]
    )
    extent_m = np.sort(np.ptp(places_m, axis=0))
    earlier = Passage.joined([passage for person in before for passage in passages[person]])
    if earlier.end_s > gone_s:
        end_m = places.until_m(gone_s)
        earlier = replace(earlier, end_s=gone_s, end_m=end_m if np.isfinite(end_m).all() else earlier.end_m)
    return earlier.log_ratio(Passage.joined(passages[after]), float(extent_m[1] * extent_m[2]))


def _together(association: Association, numbers: list[int]) -> Seen:
    """What is seen of several who are one person."""
    own = [association.people[number] for number in numbers]
    first, last = min(seen.first_frame for seen in own), max(seen.frames.stop for seen in own)
    whole = Seen.nothing(last - first, *own[0].detection.shape[1:])
    joined = replace(whole, first_frame=first)
    for seen in own:
        frames = slice(seen.first_frame - first, seen.frames.stop - first)
        known = seen.detection != NOBODY
        joined.detection[frames][known], joined.joint[frames][known] = seen.detection[known], seen.joint[known]
    return joined
