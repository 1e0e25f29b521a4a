"""What the newest image of each camera shows of everybody: where rates differ, few frames have images of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.association.track import COASTING_S, Tracked
from fgpose.people_observations import Detections
from fgpose.sampling import Pace

# Of the usual steps of a camera; then its next image has come, or is lost.
_STEPS = 2.0


@dataclass(frozen=True, eq=False)
class _Views:
    """Of one person."""

    visibility: Float[np.ndarray, "camera joint"]
    """As of Estimate; NaN: the image shows nothing of it."""
    taken_s: Float[np.ndarray, " camera"]
    """When each camera took that image; -inf: none yet."""


class NewestViews:
    """Remembers them for two steps of the camera, and COASTING_S at most: who moves for longer may be hidden since.

    Args:
        camera_names: of the rig.
    """

    def __init__(self, camera_names: Sequence[str]) -> None:
        self._names = list(camera_names)
        self._image_s = np.full(len(self._names), -np.inf)
        self._pace = [Pace(warns=False) for _ in self._names]
        self._of: dict[int, _Views] = {}

    def add(self, images: Sequence[Detections], people: Sequence[Tracked]) -> list[Float[np.ndarray, "camera joint"]]:
        """The newest images, and what the tracker says then; of each person the probability that each camera sees each
        joint in its newest image, NaN where that is too old or shows nothing of it."""
        for image in images:
            camera = self._names.index(image.camera)
            if np.isfinite(before_s := self._image_s[camera]):
                self._pace[camera].add(image.time_s - before_s)
            self._image_s[camera] = image.time_s
        given = np.isin(self._names, [image.camera for image in images])
        self._of = {tracked.person: self._newest(tracked, given) for tracked in people}
        lasts_s = np.array([min(_STEPS * pace.usual_step_s, COASTING_S) for pace in self._pace])
        since_s = self._image_s.max() - lasts_s
        return [np.where((views.taken_s >= since_s)[:, None], views.visibility, np.nan) for views in self._of.values()]

    def _newest(self, tracked: Tracked, given: np.ndarray) -> _Views:
        n_joints, before = len(tracked.estimate.status), self._of.get(tracked.person)
        if before is None and tracked.former is not None:
            before = self._of.get(tracked.former)
        if before is None:
            before = _Views(np.full((len(given), n_joints), np.nan), np.full(len(given), -np.inf))
        visibility = tracked.estimate.visibility
        if visibility is None:
            visibility = np.full((len(given), n_joints), np.nan)
        in_frame = np.isfinite(visibility).any(axis=1)
        # An image that shows them and came too late for the newest frame tells nothing there: what was before counts.
        is_new = given & (in_frame | ~np.isin(self._names, list(tracked.seen)))
        return _Views(
            np.where((is_new | in_frame)[:, None], visibility, before.visibility),
            np.where(is_new, self._image_s, before.taken_s),
        )
