"""A recording in memory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Generic

from fgpose.association.chosen_person import Chosen, PersonRegion, chosen_person, main_person
from fgpose.association.successive import Succession, successive
from fgpose.calibration.moved_views import Recording
from fgpose.config import Config
from fgpose.diagnosis.diagnose import Diagnosis
from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.evidence.gathered import Gathered, gather_long
from fgpose.freed_memory import hand_back
from fgpose.geometry.camera import CameraRig
from fgpose.io.origin import Origin
from fgpose.io.trajectories import load_trajectory
from fgpose.observations import Observations
from fgpose.people_observations import PeopleObservations
from fgpose.plain_files import naming
from fgpose.skeleton import BoneLengths


@dataclass(frozen=True, eq=False)
class Source(Generic[Recording]):
    """A recording: its cameras and what they saw, of one person (Observations) or of everybody (PeopleObservations)."""

    rig: CameraRig
    observations: Recording
    origin: Origin | None = field(default=None, repr=False)
    """Where it is from, if that is known."""
    chosen: Chosen | None = field(default=None, repr=False)
    """Who it is of how many, where somebody was chosen."""
    succession: Succession | None = field(default=None, repr=False)
    """Who comes after whom, where no image shows more than one person and somebody comes after somebody has gone."""
    with_unfollowed: Observations | None = field(default=None, repr=False)
    """Of one person who was chosen among several: the same, and in cameras in which nobody is followed although they
    show people, the one whom each sees most (fgpose.association.chosen_person.with_unfollowed); None: no such camera.
    What is wrong with such a camera is found in it."""
    bones: BoneLengths | None = field(default=None, repr=False)
    """Of the one person, from an earlier recording."""
    _gathered: dict[Config, Evidence | Gathered] = field(default_factory=dict, init=False, repr=False)

    def gathered(self, config: Config) -> Evidence | Gathered:
        """The evidence of one person: gathered once, whoever asks for it; that of the newest config is kept.

        Raises:
            ValueError: the cameras of observations and rig differ.
        """
        assert isinstance(self.observations, Observations)
        if config not in self._gathered:
            self._gathered.clear()
            self._gathered[config] = gather_long(self.observations, self.rig, config)
            hand_back()
        return self._gathered[config]

    def evidence(self, config: Config) -> Evidence:
        """The same of all frames at once."""
        return self.gathered(config).frames(slice(None))

    def one(self, person: int | PersonRegion = 0) -> Source[Observations]:
        """The main person, see chosen_person; or another one. Raises ValueError if there is no such person."""
        people, rig = self.observations, self.rig
        if isinstance(people, Observations):
            return Source(rig, people, self.origin, self.chosen, self.succession, self.with_unfollowed)
        chosen = main_person(people, rig) if person == 0 else chosen_person(people, rig, person)
        origin = self.origin and replace(self.origin, chosen=str(chosen))
        return Source.of_chosen(rig, people, chosen, origin)

    @staticmethod
    def of_chosen(
        rig: CameraRig, people: PeopleObservations, chosen: Chosen, origin: Origin | None = None
    ) -> Source[Observations]:
        """Of one of the people."""
        also = chosen.with_unfollowed
        with_unfollowed = None if also is None else people.of_person(also)
        return Source(rig, people.of_person(chosen.seen), origin, chosen, with_unfollowed=with_unfollowed)

    def everybody(self) -> Source[PeopleObservations]:
        """The same as of any number of people."""
        seen = self.observations
        people = seen if isinstance(seen, PeopleObservations) else PeopleObservations.of_one(seen)
        return Source(self.rig, people, self.origin, self.chosen, self.succession)

    def one_or_all(self) -> AnySource:
        """Everybody where an image shows more than one, or where somebody comes after somebody else has gone; else the
        one who is there."""
        people = self.observations
        if isinstance(people, PeopleObservations):
            if people.n_most > 1:
                return self
            people = people.of_person(people.only())
        succession = successive(self.observations, self.rig)
        if succession is not None and succession.n_people > 1:
            return replace(self, observations=succession.association.observations, succession=succession)
        return Source(self.rig, people, self.origin, succession=succession)

    def confident(self, least: float) -> Source[Recording]:
        """Without the detections of less confidence. Raises ValueError unless it lies in [0, 1]."""
        return self._changed(lambda seen: seen.confident(least))

    def first_frames(self, n_frames: int | None) -> Source[Recording]:
        """The beginning of the recording; None: all of it."""
        if n_frames is None:
            return self
        return self._changed(lambda seen: seen.first_frames(n_frames))

    def with_bones(self, path: Path) -> Source[Recording]:
        """With the bone lengths of an earlier result of the same person, who is alone in it.

        Raises:
            ValueError: this is a recording of several people, or so is the result; it has no bone lengths, or those of
                another skeleton; or it is damaged.
            OSError: it cannot be read.
        """
        if isinstance(self.observations, PeopleObservations):
            raise ValueError(f"{path}: whose bones are these? There are several people: choose one of them")
        earlier, skeleton = load_trajectory(path), self.observations.skeleton
        with naming(path):
            bones = earlier.bones
            if bones is None:
                raise ValueError("it has no bone lengths; parquet and npz files of smooth and track have them")
            if earlier.skeleton.length_names != skeleton.length_names:
                raise ValueError(
                    f"its bones are of skeleton {earlier.skeleton.name}, the recording has {skeleton.name}"
                )
        return replace(self, bones=bones)

    def subset(self, cameras: tuple[str, ...]) -> Source[Recording]:
        """Some of the cameras, all if none is named. Raises ValueError for an unknown name."""
        if not cameras:
            return self
        return replace(self._changed(lambda seen: seen.subset(cameras)), rig=self.rig.subset(cameras))

    def _changed(self, change: Callable[[Any], Any]) -> Source[Recording]:
        """With other observations."""
        also = self.with_unfollowed
        return replace(
            self, observations=change(self.observations), with_unfollowed=None if also is None else change(also)
        )


AnySource = Source[Any]
"""Of one person or of everybody."""


def with_findings(origin: Origin | None, diagnosis: Diagnosis | None) -> Origin | None:
    """The origin with what was found, if anybody has looked."""
    if origin is None or diagnosis is None:
        return origin
    return replace(origin, findings=diagnosis.findings)
