"""Recognising somebody who was away: by the lengths of their bones, by how they look, and by the place."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from jaxtyping import Float

from fgpose.association.identity.appearance import MeanAppearance
from fgpose.association.pose_filter import PoseFilters
from fgpose.skeleton import Skeleton

# A joint is known well enough for its bones where its standard deviation is below this.
_KNOWN_M = 0.04
# Errors of lengths from the filter are correlated over about the time of a swing: some samples in it tell all.
_CORRELATED_S, _SAMPLED_S = 0.3, 0.075
# Log odds, against two of many, at which somebody is recognised; and against all others whom it may be together.
RECOGNISED, UNAMBIGUOUS = np.log(10.0), np.log(5.0)
# Who was seen for so long beside a newcomer is not the newcomer. Shorter, some cameras may have gone on with the old
# track while others agreed on a better one.
_OVERLAP_S, _IMPOSSIBLE = 0.3, -1e3
# Who is not seen walks about, and not in a straight line.
_NEAR_M, _WALKS_MPS = 0.4, 0.8
_SMALLEST_ROOM_M2 = 9.0
# What is assumed until it is learned: lengths of the same person, measured twice, differ by so much that does not
# average out (joints that a detector puts elsewhere in another pose). Bones of adults differ in common, by the size of
# the body (standard deviation of stature over its mean: 5.5 %), and each for itself.
_SYSTEMATIC_M, _SIZE_SHARE, _OWN_M = 0.01, 0.055, 0.012
# So many lengths, and sizes, must have been compared until what is learned counts as much as that. Of more lengths than
# some, older ones fade.
_PRIOR_LENGTHS, _PRIOR_SIZES, _REMEMBERED = 20.0, 5.0, 2000.0
_LEAST_M, _LEAST_SHARE = 0.003, 0.01
# Probability that errors which do not average out are as small after an absence as they were within a stay: a Kinect
# found somebody's thigh 27 mm longer when they were back after two seconds, and before had varied by 5 mm in nine.
_AS_BEFORE = 0.25
_PERIOD_S = 2.0  # poses differ from one to the next


@dataclass(frozen=True, eq=False)
class Lengths:
    """Mean lengths of somebody's bones, each from samples of different variance."""

    n: Float[np.ndarray, " length"]
    """Number of samples, those counted less whose errors are correlated with the ones before."""
    information: Float[np.ndarray, " length"]
    """Of the means, 1/m^2, if the errors were as large as the filter says."""
    mean_m: Float[np.ndarray, " length"]
    squares: Float[np.ndarray, " length"]
    """Sum of the squared deviations, each over the variance that the filter states."""

    @staticmethod
    def none(n_lengths: int) -> Lengths:
        return Lengths(*(np.zeros(n_lengths) for _ in range(4)))

    @staticmethod
    def of(pose: PoseFilters, skeleton: Skeleton, share: float) -> Lengths:
        """Those of a pose, as far as they are known.

        Args:
            pose: of one person.
            skeleton: the bones.
            share: as which part of a sample they count.
        """
        if not skeleton.bones:
            return Lengths.none(skeleton.n_lengths)
        a, b = skeleton.bone_ends
        covariance_m2 = pose.covariance[0, :, :3, :3]
        is_known = np.trace(covariance_m2, axis1=-2, axis2=-1) / 3 < _KNOWN_M**2
        along_m = pose.positions_m[0, a] - pose.positions_m[0, b]
        length_m = np.linalg.norm(along_m, axis=-1)
        known = np.asarray(is_known[a] & is_known[b] & (length_m > 0))
        number, along = np.array(skeleton.length_of_bone)[known], along_m[known] / length_m[known, None]
        variance_m2 = np.einsum("bi,bij,bj->b", along, (covariance_m2[a] + covariance_m2[b])[known], along)

        def total(values: np.ndarray) -> np.ndarray:
            return np.bincount(number, values, skeleton.n_lengths)

        weight = share / variance_m2
        information = total(weight)
        mean_m = total(weight * length_m[known]) / np.where(information > 0, information, 1.0)
        squares = total(weight * (length_m[known] - mean_m[number]) ** 2)
        return Lengths(total(np.full(len(number), share)), information, mean_m, squares)

    def joined(self, other: Lengths) -> Lengths:
        """With other samples of the same person."""
        information = self.information + other.information
        share = other.information / np.where(information > 0, information, 1.0)
        change_m = other.mean_m - self.mean_m
        return Lengths(
            self.n + other.n,
            information,
            self.mean_m + share * change_m,
            self.squares + other.squares + change_m**2 * self.information * share,
        )

    def compared(self, other: Lengths) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of the bones that are known of both: the differences, the variances of their errors as far as these average
        out, and the lengths; m, m^2, m.

        How much larger errors are than the filter says is seen in the samples of both: a newcomer has few.
        """
        both = np.asarray((self.n > 0) & (other.n > 0))
        n, squares = (self.n + other.n)[both], (self.squares + other.squares)[both]
        variance_m2 = (squares + 1.0) / (n + 1.0) * (1 / self.information[both] + 1 / other.information[both])
        return (self.mean_m - other.mean_m)[both], variance_m2, (self.mean_m + other.mean_m)[both] / 2


@dataclass(eq=False)
class Builds:
    """How far lengths that are measured lie apart: of the same person at different times, and of different people.

    That depends on the detector, on what people do and on who they are, so it is learned from those who are followed:
    what is known beforehand counts as much as some comparisons.
    """

    systematic_m: float = _SYSTEMATIC_M
    """Standard deviation of errors that do not average out while somebody does the same."""
    size_share: float = _SIZE_SHARE
    """Standard deviation of the sizes of bodies, over their mean."""
    own_m: float = _OWN_M
    """Of the lengths of bones, beside that of the size."""
    _n_within: float = _PRIOR_LENGTHS
    _within_m2: float = _PRIOR_LENGTHS * _SYSTEMATIC_M**2
    _period_began_s: float = -np.inf

    @property
    def between_stays_m(self) -> float:
        """Standard deviation of the difference between two stays, of errors that do not average out in one. What is
        learned within stays may be too small for it."""
        return float(np.sqrt(2.0)) * max(self.systematic_m, _SYSTEMATIC_M)

    def is_due(self, now_s: float) -> bool:
        """Whether a period has ended."""
        return now_s >= self._period_began_s + _PERIOD_S

    def learn(self, present: Sequence[Passage], lost: Iterable[Passage], now_s: float) -> None:
        """From those who are there and who were there, at the end of a period."""
        self._period_began_s = now_s
        for passage in present:
            self._learn_within(passage.likeness)
        self.learn_between([*present, *lost])

    def _learn_within(self, likeness: Likeness) -> None:
        """From somebody at different times."""
        difference_m, variance_m2, _ = likeness.recent.compared(likeness.before)
        # Where they would not show beside the other errors, differences tell nothing.
        tells = 1 / (1 + variance_m2 / _SYSTEMATIC_M**2) ** 2
        excess_m2 = (difference_m**2 - variance_m2) / (1 + 1 / max(likeness.n_periods, 1))
        keep = min(1.0, _REMEMBERED / self._n_within)
        self._n_within = keep * self._n_within + float(tells.sum())
        self._within_m2 = keep * self._within_m2 + float(tells @ excess_m2)
        self.systematic_m = max(float(np.sqrt(max(self._within_m2, 0.0) / self._n_within)), _LEAST_M)
        likeness.end_period()

    def learn_between(self, passages: Sequence[Passage]) -> None:
        """From people who were there at the same time."""
        pairs = [(a, b) for a, b in combinations(passages, 2) if a.is_beside(b)]
        sizes, own_m2, n_lengths = [], [], 0
        for a, b in pairs:
            difference_m, variance_m2, length_m = a.likeness.lengths.compared(b.likeness.lengths)
            if len(length_m) < 2:
                continue
            error_m2, n_lengths = variance_m2 + 2 * self.systematic_m**2, max(n_lengths, len(length_m))
            share = length_m / (length_m @ length_m)
            size = float(share @ difference_m)
            sizes.append((size**2 - share**2 @ error_m2) / 2)
            rest_m2 = (difference_m - size * length_m) ** 2
            own_m2.append(float(np.sum(rest_m2 - error_m2)) / 2 / (len(length_m) - 1))
        if not sizes:
            return
        # So many of the pairs are independent.
        n_sizes = len({id(each) for pair in pairs for each in pair}) - 1
        n_own = n_sizes * (n_lengths - 1)
        size2 = (_PRIOR_SIZES * _SIZE_SHARE**2 + n_sizes * np.mean(sizes)) / (_PRIOR_SIZES + n_sizes)
        rest2_m2 = (_PRIOR_LENGTHS * _OWN_M**2 + n_own * np.mean(own_m2)) / (_PRIOR_LENGTHS + n_own)
        self.size_share = max(float(np.sqrt(max(size2, 0.0))), _LEAST_SHARE)
        self.own_m = max(float(np.sqrt(max(rest2_m2, 0.0))), _LEAST_M)

    def log_ratio(self, one: Lengths, other: Lengths) -> float:
        """Log of the ratio of probabilities that lengths are of the same person, against that they are of two."""
        difference_m, variance_m2, length_m = one.compared(other)
        if not len(length_m):
            return 0.0
        between_m2 = self.size_share**2 * np.outer(length_m, length_m) + self.own_m**2 * np.eye(len(length_m))
        # Who comes back may do the same as before, or something that was never seen of them.
        same, different = [], []
        for systematic_m, probability in ((self.systematic_m, _AS_BEFORE), (_SYSTEMATIC_M, 1 - _AS_BEFORE)):
            error_m2 = np.diag(variance_m2 + 2 * systematic_m**2)
            same.append(np.log(probability) + _log_normal(difference_m, error_m2))
            different.append(np.log(probability) + _log_normal(difference_m, error_m2 + 2 * between_m2))
        return float(np.logaddexp(*same) - np.logaddexp(*different))


@dataclass(eq=False)
class Likeness:
    """What is known of the lengths of somebody's bones, and of how they look."""

    skeleton: Skeleton
    looks: MeanAppearance = field(default_factory=MeanAppearance)
    before: Lengths = field(init=False)
    """Of all periods that have ended."""
    recent: Lengths = field(init=False)
    """Of the period that has not."""
    n_periods: int = 0
    at_s: float = -np.inf

    def __post_init__(self) -> None:
        self.before = self.recent = Lengths.none(self.skeleton.n_lengths)

    def add(self, pose: PoseFilters, time_s: float) -> None:
        """The lengths of the bones of a pose, as far as it is known."""
        since_s = time_s - self.at_s
        if since_s >= _SAMPLED_S:
            self.at_s, share = time_s, min(1.0, since_s / _CORRELATED_S)
            self.recent = self.recent.joined(Lengths.of(pose, self.skeleton, share))

    @property
    def lengths(self) -> Lengths:
        return self.before.joined(self.recent)

    def end_period(self) -> None:
        self.before, self.recent = self.lengths, Lengths.none(self.skeleton.n_lengths)
        self.n_periods += 1

    def join(self, before: Likeness) -> None:
        """What was known of the same person before."""
        self.looks.join(before.looks)
        self.before, self.n_periods = before.lengths.joined(self.before), self.n_periods + before.n_periods

    def log_ratio(self, other: Likeness, builds: Builds | None = None) -> float:
        """Log of the ratio of probabilities that two are the same person, against that they are two of many."""
        return (builds or Builds()).log_ratio(self.lengths, other.lengths) + self.looks.log_ratio(other.looks)


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

    def is_beside(self, other: Passage) -> bool:
        """Whether both are there at the same time, so that they are two."""
        return min(self.end_s, other.end_s) > max(self.begin_s, other.begin_s) + _OVERLAP_S

    def log_ratio(self, later: Passage, room_m2: float, builds: Builds | None = None) -> float:
        """Log of the ratio of probabilities that a later passage is of the same person, and that it is of anybody.

        Args:
            later: who comes.
            room_m2: area in which people have been.
            builds: how far the lengths of people differ.
        """
        away_s = later.begin_s - self.end_s
        if away_s < -_OVERLAP_S or later.begin_s <= self.begin_s:
            return _IMPOSSIBLE
        place = log_ratio_of_place(self.end_m, later.begin_m, max(away_s, 0.0), room_m2)
        return place + later.likeness.log_ratio(self.likeness, builds)


def log_ratio_of_place(
    before_m: Float[np.ndarray, " 3"], now_m: Float[np.ndarray, " 3"], gap_s: float, room_m2: float
) -> float:
    """Log of the ratio of densities: where somebody comes back, over anywhere in the room; horizontal or not does not
    matter, for people stay on the floor."""
    room_m2 = max(room_m2, _SMALLEST_ROOM_M2)
    sigma_m = _NEAR_M + _WALKS_MPS * gap_s
    distance_m = float(np.linalg.norm(now_m - before_m))
    density = np.exp(-0.5 * (distance_m / sigma_m) ** 2) / (2 * np.pi * sigma_m**2)
    if gap_s <= 1.0:  # nobody gets far at once
        return float(np.log(density * room_m2 + 1e-3))
    # They may as well come back anywhere, as who would be outside of the room by now.
    inside = min(1.0, room_m2 / (2 * np.pi * sigma_m**2))
    return float(np.log(0.5 * density * room_m2 + 1.0 - 0.5 * inside))
