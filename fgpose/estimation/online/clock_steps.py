"""The clock of one camera that is set while images come one after the other.

Where images come alone, nothing but their order tells how their clocks go: between two images of a camera the others
go on by as much as it does, however late each comes. One that leaps beyond that, or goes back, was set. On a computer
that is too slow, images wait, those of one camera longer than those of others: how far each camera is ahead changes as
if its clock was set. Such changes are usual then; where it is known when images arrived, they are not taken for that.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from copy import copy
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from fgpose.estimation.online.clock_jumps import FAR_S
from fgpose.geometry.changing_rig import TOGETHER_S

# Images come with jitter, and one may be lost.
_STEPS = 2.0
# So many images tell what is usual for a camera.
_REMEMBERED = 15
# A camera that has not given an image for longer has no say in which clocks are right.
_SILENT_S = 1.0


class _Spread(NamedTuple):
    least: float
    median: float
    most: float


class ClockSteps:
    """Tells which cameras have clocks that were set, and most have not: their images are not of the times they say.

    What most do is no step: after a pause, or where the clock of all is set. Of two, or two and two, those are left out
    that have leapt, for which clock is right nobody can tell. A clock that is right again is as far ahead of the others
    as before. Cameras that are late have no leap, nor have those that were away: they go on with the others. One that
    was far ahead or late from its start is as it always was.
    """

    def __init__(self, camera_names: Sequence[str]) -> None:
        self._names, unknown_s = camera_names, np.full(len(camera_names), np.nan)
        self._told_of: set[str] = set()
        self._newest_s = self._arrived_s = unknown_s
        self._steps_s = np.full((_REMEMBERED, len(camera_names)), np.nan)
        """From image to image of each camera, the newest last."""
        self._leads_s = np.full((_REMEMBERED, len(camera_names)), np.nan)
        """How far each image was ahead of the newest of all others when it came, the newest last; none of a clock that
        was set."""
        self._doubted_s = np.zeros(len(camera_names))
        """The most that each clock seems to have been set by since it was right."""
        self._since_s = unknown_s
        """Newest time of the others when that image came; of a camera that has leapt, when it did."""
        self.by_s = np.zeros(len(camera_names))
        """By how much each clock was set against those of most; zero: it was not."""
        self.lasts = np.zeros(len(camera_names), dtype=bool)
        """Whose clocks are still so after the others have gone on by as much: they did not only come later."""

    @property
    def left_out(self) -> Bool[np.ndarray, " camera"]:
        """Cameras whose newest images are not of their time."""
        return self.by_s != 0

    @property
    def lasting_s(self) -> Float[np.ndarray, " camera"]:
        """By how much those clocks were set of which it is sure."""
        return np.where(self.lasts, self.by_s, 0.0)

    def plus(
        self, taken_s: Float[np.ndarray, " camera"], arrived_s: Float[np.ndarray, " camera"] | None = None
    ) -> ClockSteps:
        """With the images that come next; of several cameras, if they come together.

        Args:
            taken_s: as their cameras say; NaN: there is none.
            arrived_s: when they came to this computer, by its clock; NaN, None: not known.
        """
        after = copy(self)
        for name in ("_steps_s", "_leads_s", "_doubted_s", "_since_s", "by_s", "lasts"):
            setattr(after, name, getattr(self, name).copy())
        if arrived_s is None:
            arrived_s = np.full(len(taken_s), np.nan)
        given = np.isfinite(taken_s) & ~(arrived_s < self._arrived_s)
        after._newest_s = np.where(given, taken_s, self._newest_s)
        after._arrived_s = np.where(given, arrived_s, self._arrived_s)
        limits_s, leads_s = after._limits_s(), _spread(self._leads_s)
        for c in np.flatnonzero(given).tolist():
            after._add(c, float(taken_s[c] - self._newest_s[c]), limits_s[c], leads_s[c])
        after._settle()
        return after

    def warn(self) -> None:
        """Warns:
        UserWarning: the clock of a camera was set, and this was not said before.
        """
        for c in np.flatnonzero(self.lasts).tolist():
            if self._names[c] not in self._told_of:
                self._told_of.add(self._names[c])
                warnings.warn(f"camera {self._names[c]}: {self.in_words(c)}", UserWarning, stacklevel=5)

    def in_words(self, c: int) -> str:
        """What is said of a camera whose clock was set."""
        of_two = "; of two cameras nobody can tell whose clock is right" if len(self._names) == 2 else ""
        return (
            f"its clock was set {'ahead' if self.by_s[c] > 0 else 'back'} by about {abs(self.by_s[c]):.2g} s while "
            f"those of the others were not; its images are left out until it is right again{of_two}"
        )

    def _add(self, c: int, step_s: float, limit_s: float, usual: _Spread) -> None:
        others_s = self._newest_of_others(c)
        lead_s = float(self._newest_s[c]) - others_s
        by_s, beyond_s = lead_s - usual.median, lead_s - min(max(lead_s, usual.least), usual.most)
        if abs(by_s) > FAR_S:  # not of one camera, or the image would be refused
            self._leads_s[:, c], self._doubted_s[c], self.by_s[c], self.lasts[c] = np.nan, 0.0, 0.0, False
            return
        if step_s > 0:
            _append(self._steps_s[:, c], step_s)
        leaps = step_s > limit_s and beyond_s > limit_s and lead_s > limit_s
        goes_back = step_s < (0.0 if self._has_arrivals else -limit_s) and beyond_s < -limit_s and lead_s < -limit_s
        if self.by_s[c]:
            self.by_s[c] = by_s if abs(by_s) > max(limit_s, abs(self.by_s[c]) / 2) else 0.0
        elif leaps or goes_back:
            # The others may have gone on since its last image, which came together with theirs.
            self.by_s[c], self._since_s[c] = by_s, others_s
        self.lasts[c] = self.by_s[c] != 0 and others_s - self._since_s[c] >= abs(self.by_s[c])
        if self.by_s[c]:
            self._doubted_s[c] = max(self._doubted_s[c], by_s, key=abs)
            return
        if self._doubted_s[c] and not self._has_arrivals:  # it had waited
            self._remember(c, lead_s - by_s + self._doubted_s[c])
        # Of who is late it shrinks while all others pause.
        if others_s > self._since_s[c] or np.isnan(by_s):
            self._remember(c, lead_s)
        self._doubted_s[c], self._since_s[c] = 0.0, others_s

    def _newest_of_others(self, c: int) -> float:
        """Time of the newest image of the other cameras whose clocks were not set, and what they have gone on until
        this one came; NaN: there is none."""
        elapsed_s = self._arrived_s[c] - self._arrived_s
        newest_s = self._newest_s + np.where(np.isnan(elapsed_s), 0.0, elapsed_s)
        newest_s[self.left_out], newest_s[c] = np.nan, np.nan
        return float(np.fmax.reduce(newest_s))

    def _remember(self, c: int, lead_s: float) -> None:
        if not np.isnan(lead_s):
            _append(self._leads_s[:, c], lead_s)

    @property
    def _has_arrivals(self) -> bool:
        """Then nothing depends on how long images have waited since."""
        return bool(np.isfinite(self._arrived_s).all())

    def _limits_s(self) -> list[float]:
        """Where a camera is further ahead of the others than by this, it is not by chance."""
        if self._has_arrivals:
            return [TOGETHER_S] * len(self._names)
        usual_s, limits_s = [step.median for step in _spread(self._steps_s)], list[float]()
        for c, own_s in enumerate(usual_s):
            fastest_s = min(
                (each_s for each_s in usual_s[:c] + usual_s[c + 1 :] if not np.isnan(each_s)), default=np.inf
            )
            limits_s.append(max(TOGETHER_S, _STEPS * max(fastest_s, own_s)))
        return limits_s

    def _settle(self) -> None:
        """Where most clocks were set, it was those of the others."""
        newest_s = self._newest_s - self.by_s
        has_say = newest_s >= np.fmax.reduce(newest_s) - _SILENT_S
        was_set = has_say & self.left_out
        if 2 * was_set.sum() > has_say.sum():
            by_s = self.by_s - np.sort(self.by_s[was_set])[was_set.sum() // 2]
            self.by_s = np.where(np.abs(by_s) > TOGETHER_S, by_s, 0.0)
            self._since_s = np.full(len(by_s), np.fmax.reduce(self._newest_s[self.by_s == 0]))
            self.lasts, self._doubted_s = np.zeros(len(by_s), dtype=bool), np.zeros(len(by_s))


def _append(remembered: Float[np.ndarray, " remembered"], value: float) -> None:
    """In place of the oldest."""
    remembered[:-1], remembered[-1] = remembered[1:], value


def _spread(values: Float[np.ndarray, "remembered camera"]) -> list[_Spread]:
    """Of each camera; NaN where none is known."""
    ordered, n_known = np.sort(values, axis=0), np.isfinite(values).sum(axis=0)
    ranks = np.zeros_like(n_known), np.maximum(n_known - 1, 0) // 2, np.maximum(n_known - 1, 0)
    return list(map(_Spread._make, np.take_along_axis(ordered, np.stack(ranks), axis=0).T.tolist()))
