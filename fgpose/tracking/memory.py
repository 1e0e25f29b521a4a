"""What a tracker leaves to the next one: those it has followed are lost to it, and may be recognised."""

from __future__ import annotations

import numpy as np

from fgpose.association.follow import Follower
from fgpose.association.identity.appearance import MeanAppearance, Resemblance, Samples
from fgpose.association.identity.likeness import Lengths, Likeness, Passage
from fgpose.estimation.online.clock_offsets import OffsetEvidence, RunningOffsets
from fgpose.io.live.tracker_memory import Numbers, RememberedPerson, RememberedSimilarity, TrackerMemory
from fgpose.skeleton import BoneLengths, Skeleton
from fgpose.tracking.known_bones import KnownBones


def memory_of(follower: Follower, bones: KnownBones, offsets: RunningOffsets, time_s: float) -> TrackerMemory:
    """What is known at the time of the newest image."""
    people, told = follower.passages, offsets.evidence + offsets.elsewhere
    return TrackerMemory(
        time_s=time_s,
        n_people=follower.n_people,
        people=tuple(_remembered(person, passage, bones) for person, passage in sorted(people.items())),
        same=_similarity(follower.resemblance.same),
        different=_similarity(follower.resemblance.different),
        offset_information=tuple(_numbers(row) for row in told.information),
        offset_moment=_numbers(told.moment),
    )


def go_on(
    memory: TrackerMemory, follower: Follower, bones: KnownBones, offsets: RunningOffsets, skeleton: Skeleton
) -> None:
    """Let a follower that has seen nothing yet recognise these people, and their bones and the clocks be known."""
    resemblance = Resemblance(_samples(memory.same), _samples(memory.different))
    passages = {each.person: _passage(each, skeleton, resemblance) for each in memory.people}
    follower.go_on(memory.n_people, passages, resemblance)
    bones.of_person = {each.person: _bones(each) for each in memory.people}
    moment = np.array(memory.offset_moment)
    told = OffsetEvidence(np.array(memory.offset_information), moment, np.zeros((2, len(moment))))
    offsets.go_on(told, memory.time_s)


def _remembered(person: int, passage: Passage, known: KnownBones) -> RememberedPerson:
    bones = known.of_person.get(person) or BoneLengths.unknown(passage.likeness.skeleton.n_lengths)
    is_known = np.isfinite(bones.lengths_m)
    lengths, looks = passage.likeness.lengths, passage.likeness.looks
    return RememberedPerson(
        person=person,
        begin_s=float(passage.begin_s),
        begin_m=_numbers(passage.begin_m),
        end_s=float(passage.end_s),
        end_m=_numbers(passage.end_m),
        length_n=_numbers(lengths.n),
        length_information=_numbers(lengths.information),
        length_m=_numbers(lengths.mean_m),
        length_squares=_numbers(lengths.squares),
        n_length_periods=passage.likeness.n_periods,
        n_looks=looks.n_periods,
        looks=() if looks.all is None else _numbers(looks.all),
        bone_lengths_m=_numbers(np.where(is_known, bones.lengths_m, 0.0)),
        bone_length_sigma_m=_numbers(np.where(is_known, bones.sigma_m, 0.0)),
    )


def _bones(somebody: RememberedPerson) -> BoneLengths:
    lengths_m, sigma_m = np.array(somebody.bone_lengths_m), np.array(somebody.bone_length_sigma_m)
    return BoneLengths(np.where(lengths_m > 0, lengths_m, np.nan), sigma_m)


def _passage(somebody: RememberedPerson, skeleton: Skeleton, resemblance: Resemblance) -> Passage:
    looks = MeanAppearance(resemblance, somebody.n_looks, np.array(somebody.looks) if somebody.looks else None)
    likeness = Likeness(skeleton, looks)
    lengths = somebody.length_n, somebody.length_information, somebody.length_m, somebody.length_squares
    likeness.before, likeness.n_periods = Lengths(*map(np.array, lengths)), somebody.n_length_periods
    places_m = np.array(somebody.begin_m), np.array(somebody.end_m)
    return Passage(somebody.begin_s, places_m[0], somebody.end_s, places_m[1], likeness)


def _similarity(samples: Samples) -> RememberedSimilarity:
    return RememberedSimilarity(samples.n, samples.n_sources, float(samples.mean), float(samples.variance))


def _samples(similarity: RememberedSimilarity) -> Samples:
    return Samples(similarity.n, similarity.n_sources, similarity.mean, similarity.variance)


def _numbers(array: np.ndarray) -> Numbers:
    return tuple(array.tolist())
