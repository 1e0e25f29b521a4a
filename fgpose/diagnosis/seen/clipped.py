"""Detections on the border of the image: joints beyond it, where the network puts what it guesses outside."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool

from fgpose.diagnosis.examined import Examined
from fgpose.estimation.evidence.plausibility import clipped_to_images
from fgpose.finding import Code, Finding, Severity
from fgpose.trajectory import Trajectory

# By chance a few detections stand there, of whole numbers one in some hundred.
_NOTICED_SHARE = 0.01


@dataclass(frozen=True, eq=False)
class Clipped:
    """Which detections are clipped."""

    of: Mapping[int, Bool[np.ndarray, "frame camera joint"]]
    """Of each person."""

    @staticmethod
    def among(examined: Examined) -> Clipped:
        return Clipped({person: clipped_to_images(seen, examined.rig) for person, seen in examined.people.items()})

    def as_missing(self, examined: Examined) -> Examined:
        """As estimators take them."""
        people = {person: seen.without(self.of[person]) for person, seen in examined.people.items()}
        result = examined.result
        if result is not None:
            result = replace(
                result, people={person: self._unjudged(person, of) for person, of in result.people.items()}
            )
        return replace(examined, people=people, result=result)

    def _unjudged(self, person: int, trajectory: Trajectory) -> Trajectory:
        """What is left out contradicts nothing, and is at no other joint."""
        clipped, residual_px, visibility = self.of.get(person), trajectory.residual_px, trajectory.visibility
        if clipped is None or residual_px is None or visibility is None or clipped.shape != visibility.shape:
            return trajectory
        if not clipped.any():
            return trajectory
        unknown_px, unknown = (np.where(clipped, np.nan, of) for of in (residual_px, visibility))
        return replace(trajectory, residual_px=unknown_px, visibility=unknown)

    def findings(self, examined: Examined) -> list[Finding]:
        n_seen = sum(own.seen.sum(axis=(0, 2)) for own in examined.people.values())
        n_clipped = sum(own.sum(axis=(0, 2)) for own in self.of.values())
        share, shares = float(np.sum(n_clipped) / max(np.sum(n_seen), 1)), n_clipped / np.maximum(n_seen, 1)
        if shares.max(initial=0.0) < _NOTICED_SHARE:
            return []
        named = zip(examined.rig.names, shares.tolist(), strict=True)
        where = examined.in_words([name for name, of_camera in named if of_camera >= _NOTICED_SHARE])
        return [
            Finding(
                Code.CLIPPED_KEYPOINTS,
                Severity.NOTE,
                f"{100 * share:.2g} % of the detections stand exactly on the border of the image, and are left out: "
                f"joints beyond it, which the network clips. They are in {where}",
                "Give coordinates as they were before they were clipped, or NaN for joints outside the image.",
                min(1.0, share),
                numbers={"share": share},
            )
        ]
