"""What the tracker knows at one moment, as frames say it at any later time."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fgpose.live.diagnosis.told_live import doubt
from fgpose.live.frame import CameraState, CameraStatus, LiveFrame, LiveJudgement, LivePerson, Restarts
from fgpose.live.tracking.observed import ObservedVolume
from fgpose.people_observations import Detections
from fgpose.skeleton import Skeleton

_LOG = logging.getLogger("fgpose.live")
# Of so many images, as they come: two seconds at 30 Hz.
_REMEMBERED = 60
# Nine of ten come so early; one that is much later than the others does not count.
_SHARE = 0.9
# So many intervals later still, images stay away.
_INTERVALS = 3.0
# Images of most systems come earlier than this. One that is later is no sign of anything; that all are is said.
_MOST_S = 0.2
# What motion must tell of a clock so that it counts, a tenth of a step, and how much of it is allowed for.
_TOLD_SIGMA_S, _SIGMAS = 0.03, 3.0


@dataclass(frozen=True)
class KnownCamera:
    """What the tracker knows of a camera."""

    n_used: int = 0
    """Images whose detections entered the estimate."""
    n_lost: int = 0
    """Others."""
    motion_offset_s: float | None = None
    """See CameraStatus. None also where its times are this computer's."""
    motion_sigma_s: float | None = None
    fault: str = ""
    """It does not agree with the others; in words."""


@dataclass(frozen=True, eq=False)
class Known:
    """It never changes, so that any thread may tell it."""

    skeleton: Skeleton
    volume: ObservedVolume
    people: tuple[LivePerson, ...]
    """As of time_s."""
    time_s: float
    """Of the people; NaN before the first image."""
    newest_s: float
    """When the newest image was taken that was used; -inf: none was."""
    longest_s: float
    """When that image is older, images stay away and people say that they are predicted: usually they come earlier."""
    since_s: float
    """See LiveFrame.tracking_since_s."""
    cameras: Mapping[str, KnownCamera]
    nobodys: tuple[Detections, ...] = ()
    """See LiveFrame."""

    def frame(
        self,
        sequence: int,
        now_s: float,
        cameras: Sequence[CameraStatus],
        restarts: tuple[Restarts, ...] = (),
        diagnosis: LiveJudgement | None = None,
    ) -> LiveFrame:
        """What it says at a time, beside how the cameras are then: with no news for long, people may be anywhere."""
        unseen_s = now_s - self.newest_s
        people = self.people
        if unseen_s > self.longest_s:
            people = tuple(person.coasting(unseen_s) for person in people)
        told = tuple(doubtful(self._told(camera, cameras), doubt(diagnosis, camera.name)) for camera in cameras)
        return LiveFrame(
            sequence=sequence,
            time_s=self.time_s,
            published_s=now_s,
            skeleton=self.skeleton,
            people=people,
            cameras=told,
            observed_share=self.volume.share(told),
            tracking_since_s=self.since_s,
            restarts=restarts,
            diagnosis=diagnosis,
            nobodys=self.nobodys,
        )

    def _told(self, camera: CameraStatus, cameras: Sequence[CameraStatus]) -> CameraStatus:
        """With the images that were used, what the motion tells of its clock, and whether it agrees with the others."""
        known = self.cameras[camera.name]
        n_lost = camera.n_lost + known.n_lost
        # The camera may have been asked before the newest of these came.
        n_images = max(camera.n_images, known.n_used + n_lost)
        changes: dict[str, Any] = {"n_images": n_images, "n_used": known.n_used, "n_lost": n_lost}
        if known.motion_sigma_s is not None:
            changes |= {"motion_offset_s": known.motion_offset_s, "motion_sigma_s": known.motion_sigma_s}
            if is_told_by_motion(camera.name, known.motion_sigma_s, cameras):
                changes["unproven_s"] = _SIGMAS * known.motion_sigma_s
        return doubtful(replace(camera, **changes), known.fault)


def is_told_by_motion(name: str, motion_sigma_s: float, cameras: Sequence[CameraStatus]) -> bool:
    """How old the images of a camera are, beside those of another camera of which it is proven."""
    return motion_sigma_s < _TOLD_SIGMA_S and any(
        each.unproven_s == 0 and each.name != name and each.state is CameraState.OK for each in cameras
    )


def doubtful(camera: CameraStatus, reason: str) -> CameraStatus:
    """With another fault, empty where there is none; the graver one is said first."""
    if not reason or reason in camera.reason:
        return camera
    is_graver = camera.state in (CameraState.OK, CameraState.LATE)
    reasons = (reason, camera.reason) if is_graver else (camera.reason, reason)
    state = CameraState.DOUBTFUL if is_graver else camera.state
    return replace(camera, state=state, reason="; ".join(filter(None, reasons)))


class UsualAge:
    """Learns how old images are when they are told, and how long after each other they are taken."""

    def __init__(self) -> None:
        self._newest_s = -np.inf
        self._ages_s: deque[float] = deque(maxlen=_REMEMBERED)
        self._intervals_s: deque[float] = deque(maxlen=_REMEMBERED)
        self._is_said = False

    def add(self, newest_s: float, now_s: float) -> None:
        """A frame is published whose newest image was taken at a time; -inf: there was none."""
        if newest_s <= self._newest_s:
            return
        if np.isfinite(self._newest_s):
            self._intervals_s.append(newest_s - self._newest_s)
        self._newest_s = newest_s
        self._ages_s.append(now_s - newest_s)
        self._say(float(np.median(self._ages_s)))

    @property
    def longest_s(self) -> float:
        """When the newest image is older than this, images stay away."""
        if not self._intervals_s:
            return max([_MOST_S, *self._ages_s])
        interval_s = float(np.median(self._intervals_s))
        return max(_MOST_S, float(np.quantile(self._ages_s, _SHARE)) + _INTERVALS * interval_s)

    def _say(self, usual_s: float) -> None:
        if len(self._ages_s) == _REMEMBERED and usual_s > _MOST_S and not self._is_said:
            self._is_said = True
            _LOG.warning(
                "frames come %.2f s after their images were taken (median): people are where they were then (time_s). "
                "Cameras or the network are slow, or this computer is busy",
                usual_s,
            )
