"""Somebody who is seen twice: of two cameras that are exchanged, rays meet where nobody is.

Cameras that stand opposite each other agree on such a double, so that it is followed. Nothing is wrong with it at any
moment; but it moves as somebody does whom only other cameras see, although all of them look at both.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float

from fgpose.association.track import Tracked, TrackState
from fgpose.finding import Code
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.field_of_view import in_views
from fgpose.people_observations import Detections

# Of these seconds, so many looks at both, a few in a second; they are compared once a second.
_KEPT_S, _EVERY_S, _FEWEST, _COMPARED_S = 16.0, 0.1, 60, 1.0
_LASTS_S = 8.0
_NOW_S = 0.5  # a slow camera has an image of somebody now
_FEWEST_CAMERAS = 2  # that see each of both
_USUALLY = 0.5
_BEFORE_IT, _MARGIN = 0.8, 0.05  # of the joints, so many are in an image, this share of its sides from its edges
# Between the lengths across two bodies over time. A double in cameras with noise of 3 px had 0.81 to 0.87; of simulated
# people who walk in one room any two had at most 0.5 in eight seconds, and 0.3 in sixteen.
_ALIKE = 0.7
# Of the other lengths there is little but errors.
_CHANGING = 20

Cameras = frozenset[str]
_REASON = (
    "it shows somebody who moves as somebody else does whom only other cameras show: are its keypoints, or theirs, "
    f"those of another camera? [{Code.OTHER_PERSON}]"
)


@dataclass(frozen=True, eq=False)
class _Look:
    """At two people at once."""

    time_s: float
    across_m: Float[np.ndarray, "person=2 pair"]
    """Between any two joints of each: how a body is bent, wherever it stands and looks."""
    cameras: tuple[Cameras, Cameras]
    """Those that see each."""


class SeenTwice:
    """Follows who moves as somebody else does. What was said stays until cameras of both have seen somebody together
    for some seconds.

    Args:
        rig: the cameras.
    """

    def __init__(self, rig: CameraRig) -> None:
        self._views = {name: rig.subset([name]) for name in rig.names}
        self._seen_s: dict[int, dict[str, float]] = {}
        """By person and camera: when it saw them last."""
        self._looks: dict[tuple[int, int], deque[_Look]] = {}
        self._looked_s = self._compared_s = -np.inf
        self._apart_s: dict[tuple[Cameras, Cameras], float] = {}
        """By the cameras of both of whom one is a double: when none of these saw somebody together last."""

    @property
    def faults(self) -> dict[str, str]:
        """By camera, in words: those that see the one whom fewer do; of as many, nobody can tell, and all are."""
        found = set[str]()
        for first, second in self._apart_s:
            fewest = min(len(first), len(second))
            found |= {camera for cameras in (first, second) if len(cameras) == fewest for camera in cameras}
        return dict.fromkeys(sorted(found), _REASON)

    def add(self, images: Sequence[Detections], people: Sequence[Tracked]) -> None:
        """The newest images, and who is in them."""
        now_s = max(image.time_s for image in images)
        self._seen_s = {
            each.person: self._seen_s.get(each.person, {}) | dict.fromkeys(each.seen, now_s) for each in people
        }
        confirmed = {person.person: person for person in people if person.state is TrackState.CONFIRMED}
        cameras = {number: self._cameras(number, now_s) for number in confirmed}
        self._forget(list(cameras.values()), now_s)
        if now_s >= self._looked_s + _EVERY_S:
            self._looked_s = now_s
            for first, second in combinations(confirmed, 2):
                both = cameras[first], cameras[second]
                if self._show(both, (confirmed[first], confirmed[second])):
                    across_m = np.stack([_across_m(confirmed[first]), _across_m(confirmed[second])])
                    self._looks.setdefault((first, second), deque()).append(_Look(now_s, across_m, both))
        if now_s >= self._compared_s + _COMPARED_S:
            self._compared_s = now_s
            self._compare(now_s)

    def _cameras(self, person: int, now_s: float) -> Cameras:
        return frozenset(name for name, at_s in self._seen_s[person].items() if at_s > now_s - _NOW_S)

    def _show(self, cameras: tuple[Cameras, Cameras], people: tuple[Tracked, Tracked]) -> bool:
        """Whether enough cameras see each, none sees both, and both are in the views of all."""
        if min(map(len, cameras)) < _FEWEST_CAMERAS or cameras[0] & cameras[1]:
            return False
        return all(
            in_views(self._views[name], person.estimate.positions_m, _MARGIN).mean() > _BEFORE_IT
            for name in cameras[0] | cameras[1]
            for person in people
        )

    def _compare(self, now_s: float) -> None:
        self._looks = {pair: looks for pair, looks in self._looks.items() if self._seen_s.keys() >= set(pair)}
        for looks in self._looks.values():
            while looks and looks[0].time_s < now_s - _KEPT_S:
                looks.popleft()
            if len(looks) >= _FEWEST and looks[-1].time_s - looks[0].time_s >= _LASTS_S and _are_alike(looks):
                self._apart_s[_usual_cameras(looks, 0), _usual_cameras(looks, 1)] = now_s

    def _forget(self, cameras: Sequence[Cameras], now_s: float) -> None:
        for first, second in list(self._apart_s):
            if not any(each & first and each & second for each in cameras):
                self._apart_s[first, second] = now_s
            elif now_s > self._apart_s[first, second] + _LASTS_S:
                del self._apart_s[first, second]


def _across_m(person: Tracked) -> Float[np.ndarray, " pair"]:
    positions_m = person.estimate.positions_m
    one, other = np.triu_indices(len(positions_m), 1)
    return np.linalg.norm(positions_m[one] - positions_m[other], axis=-1)


def _are_alike(looks: Sequence[_Look]) -> bool:
    """Whether the lengths across both bodies change together, those that change most."""
    across_m = np.stack([look.across_m for look in looks], axis=1)
    across_m = across_m[:, :, np.isfinite(across_m).all(axis=(0, 1))]
    if across_m.shape[2] < _CHANGING:
        return False
    changes_m = across_m - across_m.mean(axis=1, keepdims=True)
    much = np.argsort(changes_m.var(axis=(0, 1)))[-_CHANGING:]
    return bool(np.corrcoef(changes_m[:, :, much].reshape(2, -1))[0, 1] > _ALIKE)


def _usual_cameras(looks: Sequence[_Look], person: int) -> Cameras:
    """In most of the looks."""
    n_looks = Counter(camera for look in looks for camera in look.cameras[person])
    return frozenset(camera for camera, n in n_looks.items() if n > _USUALLY * len(looks))
