"""Recognising somebody who was away: by the lengths of their bones, by how they look, and by the place."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from fgpose.association.appearance import MeanAppearance
from fgpose.association.pose_filter import PoseFilters
from fgpose.skeleton import Skeleton

# Lengths of the same person, measured twice, differ by their errors and by so much that does not average out (joints
# that a detector puts elsewhere in another pose).
_SYSTEMATIC_M = 0.01
# Bones of adults differ in common, by the size of the body (standard deviation of stature over its mean: 5.5 %), and
# each for itself.
_SIZE_SHARE, _OWN_M = 0.055, 0.012
# A joint is known well enough for its bones where its standard deviation is below this.
_KNOWN_M = 0.04
_CORRELATED_S = 0.3  # errors of lengths from the filter are correlated over about the time of a swing
# Log odds at which somebody is recognised, and by which the next likely must be less so.
RECOGNISED, UNAMBIGUOUS = np.log(10.0), np.log(5.0)
# Who was seen for so long beside a newcomer is not the newcomer. Shorter, some cameras may have gone on with the old
# track while others agreed on a better one.
_OVERLAP_S, _IMPOSSIBLE = 0.3, -1e3
# Who is not seen walks about, and not in a straight line.
_NEAR_M, _WALKS_MPS = 0.4, 0.8
_SMALLEST_ROOM_M2 = 9.0


@dataclass(eq=False)
class Likeness:
    """What is known of the lengths of somebody's bones, and of how they look."""

    skeleton: Skeleton
    looks: MeanAppearance = field(default_factory=MeanAppearance)
    n: np.ndarray = field(init=False)
    mean_m: np.ndarray = field(init=False)
    squares_m2: np.ndarray = field(init=False)
    at_s: float = -np.inf

    def __post_init__(self) -> None:
        self.n, self.mean_m, self.squares_m2 = (np.zeros(self.skeleton.n_lengths) for _ in range(3))

    def add(self, pose: PoseFilters, time_s: float) -> None:
        """The lengths of the bones of a pose, as far as it is known."""
        share = min(1.0, (time_s - self.at_s) / _CORRELATED_S)
        if share <= 0:
            return
        self.at_s = time_s
        variance_m2 = np.trace(pose.covariance[0, :, :3, :3], axis1=-2, axis2=-1) / 3
        known = variance_m2 < _KNOWN_M**2
        lengths_m = self.skeleton.bone_lengths(pose.positions_m[0])
        for bone, number in enumerate(self.skeleton.length_of_bone):
            a, b = self.skeleton.bones[bone]
            if known[a] and known[b]:
                self.n[number] += share
                change_m = lengths_m[bone] - self.mean_m[number]
                self.mean_m[number] += share * change_m / self.n[number]
                self.squares_m2[number] += share * change_m * (lengths_m[bone] - self.mean_m[number])

    def join(self, before: Likeness) -> None:
        """What was known of the same person before."""
        self.looks.join(before.looks)
        n = self.n + before.n
        known = n > 0
        change_m = before.mean_m - self.mean_m
        share = np.divide(before.n, n, out=np.zeros_like(n), where=known)
        self.squares_m2 = self.squares_m2 + before.squares_m2 + change_m**2 * self.n * share
        self.mean_m, self.n = self.mean_m + share * change_m, n

    def log_ratio(self, other: Likeness) -> float:
        """Log of the ratio of probabilities that two are the same person, against that they are two of many."""
        return self._log_ratio_of_bones(other) + self.looks.log_ratio(other.looks)

    def _log_ratio_of_bones(self, other: Likeness) -> float:
        both = (self.n > 0) & (other.n > 0)
        if not both.any():
            return 0.0
        difference_m = self.mean_m[both] - other.mean_m[both]
        error_m2 = np.diag(self._variance_m2(both) + other._variance_m2(both) + 2 * _SYSTEMATIC_M**2)
        length_m = (self.mean_m[both] + other.mean_m[both]) / 2
        between_m2 = 2 * (_SIZE_SHARE**2 * np.outer(length_m, length_m) + _OWN_M**2 * np.eye(len(length_m)))
        return _log_normal(difference_m, error_m2) - _log_normal(difference_m, error_m2 + between_m2)

    def _variance_m2(self, some: np.ndarray) -> np.ndarray:
        """Of the means."""
        n = self.n[some]
        # Two samples tell little of their spread: 3 cm in addition, as one sample.
        spread_m2 = (self.squares_m2[some] + 0.03**2) / n
        return spread_m2 / np.maximum(n, 1.0)


def _log_normal(x: Float[np.ndarray, " n"], covariance: Float[np.ndarray, "n n"]) -> float:
    _, log_determinant = np.linalg.slogdet(2 * np.pi * covariance)
    return float(-0.5 * (log_determinant + x @ np.linalg.solve(covariance, x)))


@dataclass(frozen=True, eq=False)
class Passage:
    """Where and when somebody comes, and where and when they are lost."""

    begin_s: float
    begin_m: Float[np.ndarray, " 3"]
    end_s: float
    end_m: Float[np.ndarray, " 3"]
    likeness: Likeness

    @staticmethod
    def joined(passages: Sequence[Passage]) -> Passage:
        """Of the same person, one at least."""
        first, last = min(passages, key=lambda each: each.begin_s), max(passages, key=lambda each: each.end_s)
        likeness = copy.deepcopy(first.likeness)
        for each in passages:
            if each is not first:
                likeness.join(each.likeness)
        return Passage(first.begin_s, first.begin_m, last.end_s, last.end_m, likeness)

    def log_ratio(self, later: Passage, room_m2: float) -> float:
        """Log of the ratio of probabilities that a later passage is of the same person, and that it is of anybody.

        Args:
            later: who comes.
            room_m2: area in which people have been.
        """
        away_s = later.begin_s - self.end_s
        if away_s < -_OVERLAP_S or later.begin_s <= self.begin_s:
            return _IMPOSSIBLE
        place = log_ratio_of_place(self.end_m, later.begin_m, max(away_s, 0.0), room_m2)
        return place + later.likeness.log_ratio(self.likeness)


def log_ratio_of_place(
    before_m: Float[np.ndarray, " 3"], now_m: Float[np.ndarray, " 3"], gap_s: float, room_m2: float
) -> float:
    """Log of the ratio of densities: where somebody comes back, over anywhere in the room; horizontal or not does not
    matter, for people stay on the floor."""
    room_m2 = max(room_m2, _SMALLEST_ROOM_M2)
    sigma_m = _NEAR_M + _WALKS_MPS * gap_s
    distance_m = float(np.linalg.norm(now_m - before_m))
    density = np.exp(-0.5 * (distance_m / sigma_m) ** 2) / (2 * np.pi * sigma_m**2)
    # They may as well come back anywhere.
    return float(np.log(0.5 * density * room_m2 + 0.5)) if gap_s > 1.0 else float(np.log(density * room_m2 + 1e-3))
