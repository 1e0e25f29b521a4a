"""Bone lengths of who was here before, for the estimator of who is recognised."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from fgpose.skeleton import BoneLengths


class KnownBones:
    """Of everybody who is followed or may come back, as their estimators have learned them."""

    def __init__(self) -> None:
        self.of_person: dict[int, BoneLengths] = {}
        """By number."""
        self._person_of_track: dict[int, int] = {}

    def of_recognised(self, track: int, person: int, between_stays_m: float) -> BoneLengths | None:
        """What is known of a track that has just been recognised as somebody; None of every other.

        Args:
            track, person: numbers.
            between_stays_m: standard deviation of the difference of the lengths in two stays.
        """
        lengths = None if self._person_of_track.get(track) == person else self.of_person.get(person)
        self._person_of_track[track] = person
        return lengths and BoneLengths(lengths.lengths_m, np.hypot(lengths.sigma_m, between_stays_m))

    def learn(self, people: Mapping[int, BoneLengths | None], tracks: Collection[int], lost: Collection[int]) -> None:
        """Take what the estimators know of those who are there; forget who is not and cannot come back.

        Args:
            people: by number.
            tracks: their numbers.
            lost: numbers of the people who may come back.
        """
        kept = {person: lengths for person, lengths in self.of_person.items() if person in lost}
        self.of_person = kept | {person: lengths for person, lengths in people.items() if lengths is not None}
        self._person_of_track = {track: person for track, person in self._person_of_track.items() if track in tracks}
