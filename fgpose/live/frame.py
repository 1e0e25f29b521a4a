"""What is published, at a steady rate: the people, the cameras, and how much of the volume is observed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from fgpose.association.track import Tracked, TrackState
from fgpose.estimation.evidence.evidence import PROBABLE
from fgpose.finding import Severity
from fgpose.people_observations import Detections
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status

# Limbs, and people who begin to walk, which ISO 13855 takes to be at up to 1.6 m/s: as two standard deviations.
_SIGMA_MPS = 0.8


class CameraState(Enum):
    """What can be said of a camera now."""

    OK = "ok"
    LATE = "late"
    """Its images come, but slower or later than they should."""
    LOST = "lost"
    """Nothing has come for a while."""
    RECONNECTING = "reconnecting"
    """Its source has failed, or is not there yet, and is opened again."""
    DOUBTFUL = "doubtful"
    """Images come that should not be trusted: frozen, black, garbled, of a camera that was moved or does not see people
    where the others do, or with a clock that jumps; or the diagnosis says that what comes of it is wrong."""


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


@dataclass(frozen=True)
class LiveFinding:
    """Something that is probably wrong, in the words of a live system; see fgpose.finding.Finding."""

    code: str
    """One of fgpose.finding.Code: docs/help/findings.md."""
    severity: Severity
    """WRONG or DOUBTFUL."""
    reason: str
    """Seconds in it count from the from_s of the judgement."""
    remedy: str
    camera: str = ""
    """Which one it is about; empty: all, or none in particular."""
    from_s: float | None = None
    """Since when, Unix time; None: throughout. Until when: to_s."""
    to_s: float | None = None

    @property
    def text(self) -> str:
        """In one paragraph."""
        how = "probably wrong" if self.severity is Severity.WRONG else "doubtful"
        return f"{how}: {self.reason}. {self.remedy} [{self.code}]"

    @property
    def text_when_gone(self) -> str:
        """When it is found no longer."""
        return f"no longer found: {self.code}{' of ' if self.camera else ''}{self.camera}"


@dataclass(frozen=True)
class LiveJudgement:
    """What the diagnosis has found in the detections of about the last minute: of the past, and not of now."""

    findings: tuple[LiveFinding, ...] = ()
    """The severest first."""
    from_s: float | None = None
    """When the first of the images was taken that were looked at, Unix time; None: nothing was judged yet. When the
    last one was: to_s; and when this was said: judged_s."""
    to_s: float | None = None
    judged_s: float | None = None
    not_judged: Mapping[str, str] = field(default_factory=dict)
    """What these images could not tell, and why."""
    waits_for: str = ""
    """Why nothing is judged yet, or nothing newer, in words; empty: it was a moment ago, or is about to be."""

    @property
    def is_judged(self) -> bool:
        """Whether anything was; else no finding does not mean that nothing is wrong."""
        return self.judged_s is not None

    @property
    def is_wrong(self) -> bool:
        """Whether a finding says that numbers are off by more than they claim."""
        return any(finding.severity is Severity.WRONG for finding in self.findings)


@dataclass(frozen=True, eq=False)
class LivePerson:
    """Somebody at the time of a frame."""

    person: int
    state: TrackState
    """CONFIRMED, or COASTING where no camera detects them at the moment, or images stay away."""
    positions_m: np.ndarray
    """(J, 3) in the world frame; NaN where nothing determines a joint."""
    covariance_m2: np.ndarray
    """(J, 3, 3) of the positions at the time of the frame; more while images stay away."""
    status: np.ndarray
    """(J,) values of fgpose.Status; observed: at least two cameras see it in their newest images."""
    probability: np.ndarray
    """(J,) that at least one camera really sees the joint at the moment: in its newest image, of the last 0.1 s."""
    is_provisional: bool = False
    """Whether it is open who they are: they may still be recognised as somebody who was here before, so that the number
    may change; were, but not for certain yet; or may have been exchanged with somebody to whom they were very near."""
    former: int | None = None
    """Their number in the frames before they were recognised; it is not used again. Every frame says so while they are
    followed, for a consumer may miss the first. None: it has not changed."""
    velocity_mps: np.ndarray | None = None
    """(3,) of the body as a whole, see fgpose.Estimate; None: not known."""

    @staticmethod
    def of(tracked: Tracked, visibility: np.ndarray | None = None) -> LivePerson:
        """At the time of the newest images.

        Args:
            tracked: who it is.
            visibility: (C, J) probability that each camera sees each joint in its newest image; NaN: it does not. None:
                as the estimate says it of the newest frame, into which few cameras may have entered.

        Raises:
            ValueError: the estimate has no covariance.
        """
        estimate = tracked.estimate
        visibility = estimate.visibility if visibility is None else visibility
        if estimate.covariance_m2 is None:
            raise ValueError("a live system needs the covariance of the newest pose: set online.covariance")
        visibility = np.zeros((1, len(estimate.status))) if visibility is None else np.nan_to_num(visibility)
        is_observed = (estimate.status != Status.UNOBSERVABLE) & ((visibility > PROBABLE).sum(axis=0) >= 2)
        return LivePerson(
            person=tracked.person,
            state=tracked.state,
            positions_m=estimate.positions_m,
            covariance_m2=estimate.covariance_m2,
            status=np.where(is_observed, np.int8(Status.OBSERVED), estimate.status),
            probability=1 - np.prod(1 - visibility, axis=0),
            is_provisional=tracked.is_provisional,
            former=tracked.former,
            velocity_mps=estimate.velocity_mps,
        )

    def coasting(self, unseen_s: float) -> LivePerson:
        """When no image has told anything for this long: where they were, but they may have gone on as they went, or
        anywhere."""
        known = np.asarray(self.status != Status.UNOBSERVABLE)
        went_mps = np.zeros(3) if self.velocity_mps is None else self.velocity_mps
        moved_m2 = unseen_s**2 * (_SIGMA_MPS**2 * np.eye(3) + np.outer(went_mps, went_mps))
        return replace(
            self,
            state=TrackState.COASTING,
            covariance_m2=self.covariance_m2 + moved_m2,
            status=np.where(known, Status.PREDICTED, Status.UNOBSERVABLE).astype(np.int8),
            probability=np.zeros_like(self.probability),
        )


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
    diagnosis: LiveJudgement | None = None
    """Of the last minute; None: there is none."""
    nobodys: tuple[Detections, ...] = ()
    """Of the newest image of each camera the detections that are of none of these people: of what was taken for
    somebody, of somebody whom no other camera shows, or who is not found yet. Messages do not tell them."""

    @property
    def age_s(self) -> float:
        """Of the newest image when the frame was published; NaN before the first."""
        return self.published_s - self.time_s
