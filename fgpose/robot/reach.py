"""Where joints may be that nothing tells the place of: as far from the others as bones reach."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from jaxtyping import Bool, Float

from fgpose.live.frame import LiveFrame
from fgpose.robot.body import Body

LONGEST_M: Mapping[str, float] = MappingProxyType(
    {"trunk": 0.75, "neck": 0.5, "upper_arm": 0.45, "lower_arm": 0.35, "upper_leg": 0.55, "lower_leg": 0.55}
)
"""How far apart the joints of a part of the body are at most: of a man of 2.1 m by the shares of
fgpose.kinematics.proportions, and 5 cm for where detectors have joints. The trunk: from a shoulder to the other hip."""


@dataclass(frozen=True, eq=False)
class Places:
    """Everybody in a frame, each joint with a place from which it is not farther away than is said."""

    positions_m: Float[np.ndarray, "person joint 3"]
    """NaN where nothing is known of somebody."""
    covariance_m2: Float[np.ndarray, "person joint 3 3"]
    away_m: Float[np.ndarray, "person joint"]
    """How far it may be from there; inf where there is no place."""
    is_known: Bool[np.ndarray, "person joint"]
    """Whether the place is where the frame says the joint is; else it is that of another joint."""

    def of_person(self, number: int) -> Places:
        """Of one of them alone, by index."""
        own = slice(number, number + 1)
        return Places(self.positions_m[own], self.covariance_m2[own], self.away_m[own], self.is_known[own])


class Reach:
    """The joints of a body, and how far from each other they can be."""

    def __init__(self, body: Body, n_joints: int) -> None:
        self._longest_m = np.full((n_joints, n_joints), np.inf)
        np.fill_diagonal(self._longest_m, 0.0)
        for part, (first, second) in zip(body.parts, body.joints, strict=True):
            apart = [(a, b) for a in first for b in second if a != b]
            for a, b in [*apart, *((b, a) for a, b in apart)]:
                self._longest_m[a, b] = min(self._longest_m[a, b], LONGEST_M[part])
        for via in range(n_joints):  # all shortest ways along the bones, Floyd 1962
            self._longest_m = np.minimum(self._longest_m, self._longest_m[:, via, None] + self._longest_m[via])

    def places(self, frame: LiveFrame, away_m: Float[np.ndarray, "person joint"]) -> Places:
        """A joint without a place, or of which nothing tells how far it may be from there, is put where the nearest one
        is that has both, as far away as the bones between reach.

        Args:
            frame: the people.
            away_m: how far each joint may be from where it is said to be; inf: nothing tells.
        """
        n_joints = len(self._longest_m)
        positions_m = np.array([person.positions_m for person in frame.people]).reshape(-1, n_joints, 3)
        covariance_m2 = np.array([person.covariance_m2 for person in frame.people]).reshape(-1, n_joints, 3, 3)
        has_place = np.isfinite(positions_m).all(axis=-1) & np.isfinite(covariance_m2).all(axis=(-2, -1))
        is_known = np.asarray(has_place & np.isfinite(away_m))
        from_m = self._longest_m + np.where(is_known, away_m, np.inf)[:, None]
        of_joint = np.where(is_known, np.arange(n_joints), from_m.argmin(axis=-1))
        person = np.arange(len(positions_m))[:, None]
        reached_m = np.take_along_axis(from_m, of_joint[..., None], axis=-1)[..., 0]
        return Places(
            np.where(np.isfinite(reached_m)[..., None], positions_m[person, of_joint], np.nan),
            covariance_m2[person, of_joint],
            reached_m,
            is_known,
        )
