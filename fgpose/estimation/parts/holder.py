"""Where a hand or a face hangs, frame by frame, as the newest estimate of the body says it."""

from __future__ import annotations

from collections import deque

import numpy as np

from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.parts.place import apart_m, place_covariance_m2
from fgpose.trajectory import Estimate

_REMEMBERED = 200  # frames that tell how far the two joints of one place are apart


class Holder:
    """Holds one joint of a part at a joint of the body.

    Args:
        joint: index in the part.
        body_joint: index in the body.
        is_same: whether they are one joint, and not two at one place.
    """

    def __init__(self, joint: int, body_joint: int, *, is_same: bool) -> None:
        self._joint, self._body_joint, self._is_same = joint, body_joint, is_same
        self._away_m: deque[np.ndarray] = deque(maxlen=_REMEMBERED)
        self._body: list[Estimate] = []

    def take(self, body: Estimate) -> None:
        """The newest estimate of the body."""
        self._body = [*self._body[-1:], body]

    def held(self, evidence: Evidence, *, is_new: bool) -> Evidence:
        """The evidence of one frame, of the time of that estimate if it is new; of an older frame it is left as it is,
        for its estimate is not at hand."""
        body = self._body[-1]
        at_m = body.positions_m[self._body_joint]
        if not is_new or not np.isfinite(at_m).all():
            return evidence
        away_m = evidence.guess_m[0, self._joint] - at_m
        if np.isfinite(away_m).all():
            self._away_m.append(away_m)
        covariance_m2 = np.zeros((3, 3)) if body.covariance_m2 is None else body.covariance_m2[self._body_joint]
        step_s = body.time_s - self._body[0].time_s if len(self._body) > 1 else np.inf
        apart = 0.0 if self._is_same else apart_m(np.array(self._away_m).reshape(-1, 3))
        return evidence.held(self._joint, at_m[None], place_covariance_m2(covariance_m2[None], apart, step_s))
