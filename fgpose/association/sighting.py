"""What an image shows of those who are followed."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np

from fgpose.association.matching import Matches
from fgpose.association.pose_filter import PoseFilters
from fgpose.correspondences import NOBODY
from fgpose.people_observations import Detections


@dataclass(frozen=True, eq=False)
class NewPerson:
    """Somebody whom an image shows and who was not followed before, or lost sight of."""

    track: int
    """Number of the track."""
    detection: int
    """Number of the detection in the image."""
    pose: PoseFilters


@dataclass(frozen=True, eq=False)
class Sighting:
    """What an image shows of those who are followed."""

    image: Detections
    tracks: np.ndarray
    """(K,) numbers of those who were followed."""
    matches: Matches
    """Of all images of the moment."""
    number: int
    """Of this image among them."""
    begun: tuple[NewPerson, ...]
    """Everybody whose track begins with this image, or is found again."""

    def of_others(self, people: Collection[int]) -> Detections:
        """The image with those detections alone that are of none of these tracks, and do not repeat one that is."""
        chosen, others = self.matches.chosen[self.number], self.matches.is_free[self.number].copy()
        of_somebody = (chosen != NOBODY) & ~np.isin(self.tracks, list(people))
        others[chosen[of_somebody]] = True
        others[[begun.detection for begun in self.begun if begun.track in people]] = False
        others = others[: self.image.n_people]
        return Detections(
            self.image.camera, self.image.time_s, self.image.points2d_px[others], self.image.confidence[others]
        )

    def joints(self) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """Of everybody whom the image shows: number of the track, and for every joint the number of the detection (or
        NOBODY) and that of its joint."""
        detection, joint = self.matches.detection[self.number], self.matches.joint[self.number]
        for k in np.flatnonzero((detection != NOBODY).any(axis=-1)).tolist():
            yield int(self.tracks[k]), detection[k], joint[k]
        for begun in self.begun:
            known = self.image.confidence[begun.detection] > 0
            yield begun.track, np.where(known, begun.detection, NOBODY), np.arange(len(known))
