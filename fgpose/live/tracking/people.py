"""People as they are published."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgpose.association.track import Tracked, TrackState
from fgpose.live.frame import LivePerson
from fgpose.trajectory import Status

# ISO 13855 takes people to walk at up to 1.6 m/s: as two standard deviations.
_SIGMA_MPS = 0.8


def live_person(tracked: Tracked) -> LivePerson:
    """Somebody at the time of the newest images. Raises ValueError if the estimate has no covariance."""
    estimate = tracked.estimate
    if estimate.covariance_m2 is None:
        raise ValueError("a live system needs the covariance of the newest pose: set online.covariance")
    return LivePerson(
        person=tracked.person,
        state=tracked.state,
        positions_m=estimate.positions_m,
        covariance_m2=estimate.covariance_m2,
        status=estimate.status,
        probability=_seen_probability(estimate.visibility, len(estimate.status)),
    )


def coasting(person: LivePerson, unseen_s: float) -> LivePerson:
    """Somebody of whom no image has told anything for this long: they may have gone anywhere."""
    known = np.asarray(person.status != Status.UNOBSERVABLE)
    return replace(
        person,
        state=TrackState.COASTING,
        covariance_m2=person.covariance_m2 + (_SIGMA_MPS * unseen_s) ** 2 * np.eye(3),
        status=np.where(known, Status.PREDICTED, Status.UNOBSERVABLE).astype(np.int8),
        probability=np.zeros_like(person.probability),
    )


def _seen_probability(visibility: np.ndarray | None, n_joints: int) -> np.ndarray:
    """(J,) that at least one detection is of its joint."""
    if visibility is None:
        return np.zeros(n_joints)
    return 1 - np.prod(1 - np.where(np.isfinite(visibility), visibility, 0.0), axis=0)
