"""Recognising people: by the lengths of their bones and by the place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rooms import body_m

from fgpose.association.identity.likeness import Builds, Likeness, Passage, log_ratio_of_place
from fgpose.association.pose_filter import PoseFilters
from fgpose.skeleton import Skeleton

KNOWN_M, UNKNOWN_M = 0.01, 0.3


def pose_of(positions_m: np.ndarray, sigma_m: float = KNOWN_M) -> PoseFilters:
    return PoseFilters.at(0.0, positions_m, np.tile(sigma_m**2 * np.eye(3), (len(positions_m), 1, 1)))


def likeness_of(
    skeleton: Skeleton, size: float, seed: int, n: int = 40, begin_s: float = 0.0, into: Likeness | None = None
) -> Likeness:
    """Learnt for more than a second from joints that err by a centimetre."""
    rng = np.random.default_rng(seed)
    likeness = into or Likeness(skeleton)
    for frame in range(n):
        positions_m = body_m(skeleton, size=size) + 0.01 * rng.standard_normal((skeleton.n_joints, 3))
        likeness.add(pose_of(positions_m), begin_s + frame / 30.0)
    return likeness


@pytest.mark.parametrize("seed", range(3))
def test_the_same_person_is_recognised_by_the_bones(skeleton: Skeleton, seed: int) -> None:
    one, again = likeness_of(skeleton, 1.0, seed), likeness_of(skeleton, 1.0, 100 + seed)
    assert one.log_ratio(again) > 0
    assert one.log_ratio(again) == pytest.approx(again.log_ratio(one))


@pytest.mark.parametrize("size", [0.85, 1.15])
def test_people_of_different_size_are_not_the_same(skeleton: Skeleton, size: float) -> None:
    assert likeness_of(skeleton, 1.0, 0).log_ratio(likeness_of(skeleton, size, 1)) < -2.0


def test_longer_known_is_surer(skeleton: Skeleton) -> None:
    known = likeness_of(skeleton, 1.0, 0)
    assert known.log_ratio(likeness_of(skeleton, 1.0, 1, n=3)) < known.log_ratio(likeness_of(skeleton, 1.0, 1, n=40))


def test_nothing_known_tells_nothing(skeleton: Skeleton) -> None:
    unknown = Likeness(skeleton)
    unknown.add(pose_of(body_m(skeleton), UNKNOWN_M), 0.0)
    assert unknown.log_ratio(likeness_of(skeleton, 1.0, 0)) == 0.0
    boneless = Likeness(Skeleton("points", ("a", "b"), (), (0,)))
    boneless.add(pose_of(np.zeros((2, 3))), 0.0)
    assert boneless.log_ratio(boneless) == 0.0


def test_joined_is_as_if_learnt_at_once(skeleton: Skeleton) -> None:
    """The second visit is half a minute later: that is more than errors are correlated for."""
    at_once = likeness_of(skeleton, 1.0, 1, begin_s=30.0, into=likeness_of(skeleton, 1.0, 0))
    joined = likeness_of(skeleton, 1.0, 1, begin_s=30.0)
    joined.join(likeness_of(skeleton, 1.0, 0))
    for name in ("n", "information", "mean_m", "squares"):
        np.testing.assert_allclose(getattr(joined.lengths, name), getattr(at_once.lengths, name), rtol=1e-9)


def test_the_mean_is_that_of_the_samples(skeleton: Skeleton) -> None:
    """Samples far apart in time count one each."""
    likeness = Likeness(skeleton)
    sizes = np.array([0.9, 1.0, 1.2])
    for second, size in enumerate(sizes.tolist()):
        likeness.add(pose_of(body_m(skeleton, size=size)), float(second))
    lengths_m = np.array([skeleton.bone_lengths(body_m(skeleton, size=size)) for size in sizes.tolist()])
    # Mirrored bones share a length: there are two samples of it at each time.
    number = np.array(skeleton.length_of_bone)
    for length in range(skeleton.n_lengths):
        samples_m, known = lengths_m[:, number == length].ravel(), likeness.lengths
        assert known.n[length] == len(samples_m)
        assert known.information[length] == pytest.approx(len(samples_m) / (2 * KNOWN_M**2))
        assert known.mean_m[length] == pytest.approx(samples_m.mean())
        assert known.squares[length] == pytest.approx(np.sum((samples_m - samples_m.mean()) ** 2) / (2 * KNOWN_M**2))


def test_two_images_of_one_time_are_one_sample(skeleton: Skeleton) -> None:
    """And a bone that is known from the second on is not known from nothing."""
    likeness = Likeness(skeleton)
    likeness.add(pose_of(body_m(skeleton), UNKNOWN_M), 0.0)
    likeness.add(pose_of(body_m(skeleton)), 0.0)
    likeness.add(pose_of(body_m(skeleton)), 0.1)
    assert np.isfinite(likeness.lengths.mean_m).all()
    likeness.add(pose_of(body_m(skeleton)), 1.0)
    n = likeness.lengths.n
    likeness.add(pose_of(body_m(skeleton)), 1.0)
    likeness.add(pose_of(body_m(skeleton)), 0.5)
    np.testing.assert_array_equal(likeness.lengths.n, n)
    assert np.isfinite(likeness.log_ratio(likeness_of(skeleton, 1.0, 0)))


def together(skeleton: Skeleton, own_m: float, n_people: int = 8) -> list[Passage]:
    """People of one size who are there at the same time, whose bones differ by so much."""
    rng, passages = np.random.default_rng(0), []
    for seed in range(n_people):
        likeness = likeness_of(skeleton, 1.0, seed, n=120)
        off_m = own_m * rng.standard_normal(skeleton.n_lengths)
        likeness.recent = replace(likeness.recent, mean_m=likeness.recent.mean_m + off_m)
        passages.append(Passage(0.0, np.zeros(3), 4.0, np.zeros(3), likeness))
    return passages


@pytest.mark.parametrize("own_m", [0.004, 0.03])
def test_it_is_learned_how_alike_people_are(skeleton: Skeleton, own_m: float) -> None:
    """A hundred lengths tell a standard deviation to a tenth, and beforehand it is 12 mm."""
    builds = Builds()
    builds.learn_between(together(skeleton, own_m))
    assert abs(builds.own_m - own_m) < abs(builds.own_m - 0.012)
    assert builds.size_share < Builds().size_share


def test_where_everybody_is_alike_bones_tell_less(skeleton: Skeleton) -> None:
    alike, one, again = Builds(), likeness_of(skeleton, 1.0, 0), likeness_of(skeleton, 1.0, 100)
    alike.learn_between(together(skeleton, 0.0))
    assert 0 <= one.log_ratio(again, alike) < one.log_ratio(again) - 1.0


def test_who_comes_after_another_tells_nothing_of_how_people_differ(skeleton: Skeleton) -> None:
    """They may be the same person."""
    builds, first = Builds(), together(skeleton, 0.03, 1)[0]
    builds.learn_between([first, replace(first, begin_s=5.0, end_s=9.0)])
    assert (builds.own_m, builds.size_share) == (Builds().own_m, Builds().size_share)


def test_near_and_soon_is_probably_the_same() -> None:
    here, near, far = np.zeros(3), np.array([0.3, 0.0, 0.0]), np.array([3.0, 0.0, 0.0])
    soon = [log_ratio_of_place(here, there, 0.5, 20.0) for there in (here, near, far)]
    assert soon[0] > soon[1] > 0 > soon[2]


def test_after_a_while_the_place_tells_little() -> None:
    here, far = np.zeros(3), np.array([3.0, 0.0, 0.0])
    for gap_s in (5.0, 60.0):
        assert -np.log(2) <= log_ratio_of_place(here, far, gap_s, 20.0) <= log_ratio_of_place(here, here, gap_s, 20.0)
    assert abs(log_ratio_of_place(here, here, 60.0, 20.0)) < np.log(2)


def test_a_larger_room_makes_the_same_place_tell_more() -> None:
    here = np.zeros(3)
    assert log_ratio_of_place(here, here, 0.5, 100.0) > log_ratio_of_place(here, here, 0.5, 20.0)
    assert log_ratio_of_place(here, here, 0.5, 0.0) == log_ratio_of_place(here, here, 0.5, 9.0)
