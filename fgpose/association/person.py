"""Somebody who is followed, in space or in the images of one camera."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.association.midlines import median_offset

NOBODY = -1
"""In place of the index of a candidate: the person is not found in this image."""

# A candidate belongs to a person whose midline is as near as this, and as much farther as people walk meanwhile: the
# midlines of two people side by side are about half a metre apart.
NEAR_M = 0.4
# A brisk walk. Higher, a person who is hidden for a moment is confused with a neighbour sooner.
_SPEED_M_PER_S = 2.0
# Beyond this, whoever appears is somebody else. Higher, two people are joined; lower, one person becomes two after a
# gap.
_FARTHEST_M = 1.5
# A person who was seen in fewer frames than this, and not for a second, is a chance agreement of views or a false
# detection.
_MIN_FRAMES = 5
_FORGOTTEN_S = 1.0


class Person:
    """Where somebody was last, and which candidate of each image they are."""

    def __init__(self, place: Float[np.ndarray, "feature axis"], time_s: float, shape: tuple[int, int]) -> None:
        """
        Args:
            place: of the midline; metres in the world, or pixels of an undistorted image.
            time_s: when they were there.
            shape: number of frames and of cameras.
        """
        self.place = place
        self.time_s = time_s
        """When the place was last certain: in space, one view alone does not tell the depth."""
        self.first_place, self.first_time_s = place, time_s
        self.chosen = np.full(shape, NOBODY)
        self.score = 0.0
        """How much was seen of them: the sum of the confidences."""
        self._n_frames = 0

    def reach_m(self, time_s: float) -> float:
        """How far they may be from where they were."""
        return min(NEAR_M + _SPEED_M_PER_S * abs(time_s - self.time_s), _FARTHEST_M)

    def move(self, place: Float[np.ndarray, "feature axis"], time_s: float) -> None:
        """Move them to where they are seen; features that are not seen (NaN) move by the same amount."""
        step = median_offset(place - self.place)
        self.place = np.where(np.isnan(place), self.place + step, place)
        self.time_s = time_s

    def is_seen(self, frame: int) -> bool:
        """Whether they were found in any image of a frame."""
        return bool((self.chosen[frame] != NOBODY).any())

    def images(self, frame: int) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
        """The cameras that see them in a frame, and which candidate they are there."""
        cameras = np.flatnonzero(self.chosen[frame] != NOBODY)
        return cameras, self.chosen[frame, cameras]

    def count(self, frame: int, completeness: Float[np.ndarray, "camera person"]) -> None:
        """Add the confidence of what is seen of them in a frame."""
        self._n_frames += self.is_seen(frame)
        self.score += float(completeness[self.images(frame)].sum())

    def is_real(self, time_s: float) -> bool:
        """Whether they were seen often enough, or a moment ago."""
        return self._n_frames >= _MIN_FRAMES or self.time_s > time_s - _FORGOTTEN_S


def matches(
    distance_m: Float[np.ndarray, "k person"], reach_m: Float[np.ndarray, " k"], free: Bool[np.ndarray, " person"]
) -> Iterable[tuple[int, int]]:
    """Pairs of a person and a free candidate of one image within reach, with the smallest sum of distances."""
    # Takes longer to import than the rest of fgpose, and only recordings of several people need it.
    from scipy.optimize import linear_sum_assignment

    allowed = (distance_m <= reach_m[:, None]) & free
    # More than any pair that is allowed, and finite.
    cost_m = np.where(allowed, distance_m, 10 * _FARTHEST_M)
    pairs = zip(*linear_sum_assignment(cost_m), strict=True)
    return [(int(k), int(candidate)) for k, candidate in pairs if allowed[k, candidate]]
