"""What is published, at a steady rate: the people, the cameras, and how much of the volume is observed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from fgpose.association.track import TrackState
from fgpose.skeleton import Skeleton


class CameraState(Enum):
    """What can be said of a camera now."""

    OK = "ok"
    LATE = "late"
    """Its images come, but slower or later than they should."""
    LOST = "lost"
    """Nothing has come for a while."""
    RECONNECTING = "reconnecting"
    """Its source has failed and is opened again."""
    DOUBTFUL = "doubtful"
    """Images come that should not be trusted: frozen, black, garbled, of a camera that was moved or does not see people
    where the others do, or with a clock that jumps."""


@dataclass(frozen=True)
class CameraStatus:
    """A camera at the time of a frame."""

    name: str
    state: CameraState
    reason: str = ""
    """In words, where the state is not ok."""
    image_s: float | None = None
    """When its newest image was taken, Unix time; None: there was none yet."""
    rate_hz: float = 0.0
    """Of its images over the last seconds."""
    clock_offset_s: float | None = None
    """What is added to the stamps of its images to get Unix time; None: they have none, or it is not known yet."""
    clock_sigma_s: float | None = None
    n_images: int = 0
    """That have arrived."""
    n_used: int = 0
    """Whose detections entered the estimate."""
    n_lost: int = 0
    """Whose detections were too old when they were there, or in whose pictures a fault is seen."""
    motion_offset_s: float | None = None
    """By how much later than their times say its images are taken, as the motion of those who are seen tells; relative
    to the cameras whose times are known best. None: it has told nothing yet, or the times are this computer's."""
    motion_sigma_s: float | None = None
    unproven_s: float | None = None
    """So much longer ago than their times say its images may have been taken: nothing tells yet whether its clock is
    behind or its images come late. None: nothing tells how late they come."""


@dataclass(frozen=True)
class Restarts:
    """A thread or process of the live system that has ended and was begun again."""

    part: str
    n: int
    """How often."""
    reason: str
    """Of the last time."""
    last_s: float
    """When that was, Unix time."""


@dataclass(frozen=True, eq=False)
class LivePerson:
    """Somebody at the time of a frame."""

    person: int
    state: TrackState
    """CONFIRMED, or COASTING where no camera detects them at the moment."""
    positions_m: np.ndarray
    """(J, 3) in the world frame; NaN where nothing determines a joint."""
    covariance_m2: np.ndarray
    """(J, 3, 3)"""
    status: np.ndarray
    """(J,) values of fgpose.Status."""
    probability: np.ndarray
    """(J,) that at least one camera really sees the joint at the moment."""


@dataclass(frozen=True, eq=False)
class LiveFrame:
    """One message. It is published also when nobody is there and when nothing is observed; then it says so."""

    sequence: int
    """Counts the frames of a run, from 0."""
    time_s: float
    """At which the people are where this frame says, Unix time: the mean of when the newest images of all cameras were
    taken. NaN before the first image."""
    published_s: float
    """Unix time."""
    skeleton: Skeleton
    people: tuple[LivePerson, ...]
    cameras: tuple[CameraStatus, ...]
    """In the order of the rig."""
    observed_share: float
    """Of the volume, that at least two cameras that are ok observe: elsewhere, nobody does not mean that nobody is
    there."""
    tracking_since_s: float = math.nan
    """When the first image was taken that the tracker has used without beginning anew, and without half a second of no
    images, Unix time; NaN: it has not begun. For a second after that, nobody may mean not found yet."""
    restarts: tuple[Restarts, ...] = ()
    """Of what has ended since the start of the live system; what it knew before is lost."""

    @property
    def age_s(self) -> float:
        """Of the newest image when the frame was published; NaN before the first."""
        return self.published_s - self.time_s
