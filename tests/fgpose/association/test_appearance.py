"""Recognising people by how they look."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rooms import FPS, body_m, image, people_of

import fgpose
from fgpose.association.follow import Follower
from fgpose.association.identity.appearance import MeanAppearance, Resemblance, Samples
from fgpose.association.recording import associate
from fgpose.geometry.camera import CameraRig
from fgpose.people_observations import Detections, PeopleObservations
from fgpose.skeleton import Skeleton

N_NUMBERS = 128
PLACES_M = ((-0.8, 0.8), (0.8, 0.8), (-0.8, -0.8))
HALF_WAY_M = (0.0, 0.8)


def vector_of(person: int, rng: np.random.Generator, spread: float = 1.0) -> np.ndarray:
    """Of the same person about 0.5 alike, of different people about 0.25, as the vectors of real networks are."""
    common, own = (np.random.default_rng([n, 7]).standard_normal(N_NUMBERS) for n in (99, person))
    return common + own + spread * rng.standard_normal(N_NUMBERS)


def looks_of(resemblance: Resemblance, person: int, seed: int, n: int = 20) -> MeanAppearance:
    looks, rng = MeanAppearance(resemblance), np.random.default_rng(seed)
    for _ in range(n):
        looks.add(vector_of(person, rng))
    return looks


@pytest.fixture
def resemblance() -> Resemblance:
    """Learned from four people in ten seconds."""
    rng, learned = np.random.default_rng(0), Resemblance()
    people = [MeanAppearance(learned) for _ in range(4)]
    for second in range(10):
        for _ in range(20):
            for person, looks in enumerate(people):
                looks.add(vector_of(person, rng))
        learned.learn(people, float(second))
    return learned


def test_the_same_person_looks_the_same(resemblance: Resemblance):
    """Of people who were not there when it was learned."""
    for person in range(10, 16):
        one, again, other = (looks_of(resemblance, p, seed) for p, seed in ((person, 1), (person, 2), (person + 9, 3)))
        assert one.log_ratio(again) > 0
        assert one.log_ratio(other) < 0
        assert one.log_ratio(again) == pytest.approx(again.log_ratio(one))


def test_without_experience_looks_tell_nothing():
    unknown = Resemblance()
    assert looks_of(unknown, 0, 1).log_ratio(looks_of(unknown, 0, 2)) == 0.0


def test_without_vectors_looks_tell_nothing(resemblance: Resemblance):
    nothing = MeanAppearance(resemblance)
    nothing.add(np.full(N_NUMBERS, np.nan))
    nothing.add(np.zeros(N_NUMBERS))
    assert nothing.log_ratio(looks_of(resemblance, 0, 1)) == 0.0


def test_no_resemblance_is_a_proof():
    """Vectors that are always the same of a person, and always different of others."""
    learned = Resemblance()
    people = [MeanAppearance(learned) for _ in range(3)]
    for second in range(100):
        for looks, vector in zip(people, np.eye(3), strict=True):
            looks.add(vector)
        learned.learn(people, float(second))
    assert abs(learned.log_ratio(1.0)) <= np.log(100.0)
    assert abs(learned.log_ratio(0.0)) <= np.log(100.0)


def test_joined_is_as_if_learned_at_once(resemblance: Resemblance):
    first, second = looks_of(resemblance, 0, 1), looks_of(resemblance, 0, 2)
    second.join(first)
    at_once = looks_of(resemblance, 0, 1)
    rng = np.random.default_rng(2)
    for _ in range(20):
        at_once.add(vector_of(0, rng))
    assert second.all == pytest.approx(at_once.all)


def test_samples_are_those_of_numpy():
    values = np.random.default_rng(0).normal(0.5, 0.1, 50)
    samples = Samples()
    for value in values:
        samples.add(float(value), is_new_source=True)
    assert samples.mean == pytest.approx(values.mean())
    assert samples.variance == pytest.approx(values.var())


def twins(rig: CameraRig, skeleton: Skeleton, returns: int, *, with_vectors: bool) -> list[Detections]:
    """Three people with the same bones. After 6 s two are gone, and at 10 s one of them stands half-way between the
    places of both."""
    rng, images = np.random.default_rng(0), []
    for time_s in np.arange(0.0, 13.0, 1.0 / FPS).tolist():
        here = {0: PLACES_M[0], 1: PLACES_M[1], 2: PLACES_M[2]} if time_s < 6.0 else {2: PLACES_M[2]}
        if time_s >= 10.0:
            here[returns] = HALF_WAY_M
        for c in range(rig.n_cameras):
            seen = image(rig, c, time_s, [body_m(skeleton, place_m) for place_m in here.values()], rng)
            vectors = np.array([vector_of(person, rng) for person in here])
            images.append(replace(seen, appearance=vectors) if with_vectors else seen)
    return images


@pytest.mark.slow
@pytest.mark.parametrize("returns", [0, 1])
def test_twins_are_told_apart_by_their_looks(returns: int, rig: CameraRig, skeleton: Skeleton):
    for with_vectors, n_people in ((True, 3), (False, 4)):
        images = twins(rig, skeleton, returns, with_vectors=with_vectors)
        association = associate(PeopleObservations(skeleton, rig.names, tuple(images)), rig)
        assert len(association.people) == n_people
        if with_vectors:
            at_first = [seen.main_detection[90 - seen.first_frame] for seen in association.people.values()]
            at_last = {n: seen.frames.stop == 390 for n, seen in association.people.items()}
            first = dict(zip(association.people, (numbers[0] for numbers in at_first), strict=True))
            assert {first[n] for n, is_there in at_last.items() if is_there} == {2, returns}


@pytest.mark.slow
def test_live_too(rig: CameraRig, skeleton: Skeleton):
    follower, images = Follower(rig, skeleton), twins(rig, skeleton, 1, with_vectors=True)
    numbers: dict[float, list[int]] = {}
    for first in range(0, len(images), rig.n_cameras):
        sightings = follower.see(images[first : first + rig.n_cameras])
        numbers[sightings[0].image.time_s] = people_of(follower)
    before, after = numbers[min(numbers, key=lambda time_s: abs(time_s - 5.0))], people_of(follower)
    assert before == [0, 1, 2]
    assert len(after) == 2
    assert set(after) < {0, 1, 2}


def test_vectors_must_fit(rig: CameraRig, skeleton: Skeleton):
    seen = image(rig, 0, 0.0, [body_m(skeleton)])
    with pytest.raises(ValueError, match=r"camera ring_0, image at 0 s: appearance must be \(1, any\), got \(2, 4\)"):
        replace(seen, appearance=np.ones((2, 4)))
    short, long = replace(seen, appearance=np.ones((1, 3))), replace(seen, time_s=0.1, appearance=np.ones((1, 4)))
    message = "image at 0 s: appearance vectors of 3 numbers, but of 4 in camera ring_0, image at 0.1 s"
    with pytest.raises(ValueError, match=message):
        PeopleObservations(skeleton, rig.names, (short, long))
    tracker = fgpose.Tracker(rig, skeleton, fgpose.Config(tracking={"max_processes": 1}))
    tracker.update([short])
    with pytest.raises(ValueError, match=message):
        tracker.update([long])
