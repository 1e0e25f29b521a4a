"""Which side of somebody is left: as images of one moment say it together, for most of the time.

A detection is turned round where it fits somebody better that way (Likelihood.mirrored_where_better): a detector that
exchanges left and right for a while changes nothing. But somebody may be founded on images of which some are exchanged;
then right ones are turned round for ever after, be it of all cameras, or of those that look along one axis, which makes
a body that is mirrored in depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fgpose.association.founding import found
from fgpose.association.matching import Matches, Moment
from fgpose.association.pose_filter import PoseFilters
from fgpose.correspondences import NOBODY
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton

# What images said fades in this time: who was right for long stays right where most detectors exchange sides for two
# seconds.
_MEMORY_S = 3.0
_LEAST_S = 0.1  # for so much longer images must speak for other sides than against them
_LONGEST_S = 0.1  # a moment tells no more than the time since the one before, nor than this


@dataclass(eq=False)
class Sides:
    """For how long images have fitted each other better as they are labelled than as somebody is followed, less that
    for which they have not."""

    begun_s: float
    """Time of the first images on which somebody was founded."""
    _since_s: float = -np.inf
    """Until when images said that they are right (CUSUM, Page 1954)."""
    _wrong_s: float = 0.0
    """Lately."""
    _sum_s: float = 0.0
    _told_s: float = -np.inf

    def told(self, now_s: float, *, are_wrong: bool) -> None:
        """The images of a moment."""
        step_s = float(np.clip(now_s - self._told_s, 0.0, _LONGEST_S)) * (1 if are_wrong else -1)
        self._told_s = max(now_s, self._told_s)
        self._wrong_s = float(np.exp(-abs(step_s) / _MEMORY_S)) * self._wrong_s + step_s
        self._sum_s = max(self._sum_s + step_s, 0.0)
        if not self._sum_s:
            self._since_s = now_s

    @property
    def since_s(self) -> float:
        """Since when left and right are wrong, if they are: soon after somebody was founded, since then, for nobody who
        is followed changes sides."""
        return self.begun_s if self._since_s < self.begun_s + _MEMORY_S / 2 else self._since_s

    @property
    def are_wrong(self) -> bool:
        """For most of the time."""
        return self._wrong_s > _LEAST_S


@dataclass(frozen=True, eq=False)
class Shown:
    """Some images, and whose detections they show."""

    moment: Moment
    matches: Matches
    tracks: list[int]
    """Numbers of those who are followed."""

    def sides_of(self, number: int) -> dict[str, int]:
        """By camera that shows somebody, whether his sides are exchanged there (Matches.sides)."""
        if number not in self.tracks:
            return {}
        k = self.tracks.index(number)
        shows = zip(
            self.moment.cameras.names, self.matches.chosen[:, k], self.matches.sides[:, k].tolist(), strict=True
        )
        return {name: side for name, chosen, side in shows if chosen != NOBODY}

    def alone(self, number: int, camera: str) -> Moment:
        """The detection of somebody alone, in the image of one camera that shows him."""
        c, k = self.moment.cameras.names.index(camera), self.tracks.index(number)
        own = self.moment.of_camera(c)
        return own.without(np.arange(own.points_px.shape[1])[None] != self.matches.chosen[c, k])


@dataclass(frozen=True, eq=False)
class Turned:
    """Somebody whose left is what the newest images call left."""

    pose: PoseFilters
    cameras: list[str]
    """Those that show him with left and right exchanged, as he was followed until now."""
    are_all: bool
    """Whether no other one shows him."""


def turned(shown: Sequence[Shown], number: int, rig: CameraRig, skeleton: Skeleton) -> Turned | None:
    """Somebody as the newest images are labelled, if more of them agree on him then than call him as he is followed.

    Args:
        shown: the images, in the order of time.
        number: of his track.
        rig, skeleton: of the images.
    """
    sides: dict[str, int] = {}
    newest: dict[str, Shown] = {}
    for each in shown:
        own = each.sides_of(number)
        sides, newest = sides | own, newest | dict.fromkeys(own, each)
    cameras = [name for name, side in sides.items() if side > 0]
    if not cameras:
        return None
    n_called_so = sum(side < 0 for side in sides.values())
    people = found(Moment.together([each.alone(number, name) for name, each in newest.items()], rig), None, skeleton)
    if not people or np.count_nonzero(people[0].chosen != NOBODY) <= n_called_so:
        return None
    return Turned(people[0].pose, cameras, n_called_so == 0)
