"""Whose detection, and whose joint: the assignment is the best there is, and wrong grouping is put right."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from rooms import body_m, moment_of

from fgpose.association.likelihood import Likelihood
from fgpose.association.matching import Matches, Moment, follow, match
from fgpose.association.pose_filter import PoseFilters
from fgpose.correspondences import NOBODY
from fgpose.people_observations import Detections
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import ring_rig

N_JOINTS = 4
MIRROR = np.array([0, 2, 1, 3])
FITS, DOES_NOT = 8.0, -8.0
"""Log ratios of a joint that is the person's, and of one that is not."""


def matched(log_ratio: np.ndarray, exists: list[float] | None = None, mirrored: np.ndarray | None = None) -> Matches:
    """Of log ratios (C, K, P, J)."""
    likelihood = Likelihood(log_ratio.astype(float))
    sides = np.zeros(log_ratio.shape[:3], dtype=int) if mirrored is None else mirrored.astype(int)
    return match(likelihood, sides, np.array(exists or [1.0] * log_ratio.shape[1]), MIRROR)


def grouped(n_people: int) -> np.ndarray:
    """Log ratios (1, K, K, J) where detection k is of person k."""
    own = np.eye(n_people, dtype=bool)[None, :, :, None]
    return np.repeat(np.where(own, FITS, DOES_NOT), N_JOINTS, axis=3)


def largest_sum(score: np.ndarray) -> float:
    """Over all ways to give people (rows) different detections, or none."""
    n_people, n_detections = score.shape
    padded = np.concatenate([np.maximum(score, 0.0), np.zeros((n_people, n_people))], axis=1)
    return max(
        float(padded[np.arange(n_people), list(way)].sum())
        for way in permutations(range(n_people + n_detections), n_people)
    )


@pytest.mark.parametrize("seed", range(20))
def test_the_assignment_is_the_best_of_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n_people, n_detections = rng.integers(1, 4, 2)
    log_ratio = rng.normal(1.0, 4.0, (2, n_people, n_detections, 1)) + rng.normal(
        0.0, 0.3, (2, n_people, n_detections, N_JOINTS)
    )
    score = Likelihood(log_ratio).score
    matches = matched(log_ratio)
    for of_camera, own, chosen in zip(score, matches.score, matches.chosen, strict=True):
        assert own[chosen != NOBODY].sum() == pytest.approx(largest_sum(of_camera))
        used = chosen[chosen != NOBODY]
        assert len(set(used.tolist())) == len(used)
        np.testing.assert_array_equal(own[chosen != NOBODY], of_camera[chosen != NOBODY, used])
        assert (own[chosen == NOBODY] == -np.inf).all()


def test_nobody_gets_what_is_improbable_for_them() -> None:
    matches = matched(np.full((1, 2, 3, N_JOINTS), DOES_NOT))
    assert (matches.chosen == NOBODY).all()
    assert (matches.detection == NOBODY).all()
    assert matches.is_free.all()


@pytest.mark.parametrize(("less", "exists", "gets_it"), [(1, 1.0, 1), (1, 0.01, 0), (3, 0.01, 1)])
def test_who_is_surely_there_gets_what_fits_another_hardly_better(less: float, exists: float, gets_it: int) -> None:
    """Both fit the one detection, the second better by 4 or 12; a probability of 0.01 is worth -4.6."""
    log_ratio = np.stack([np.full((1, N_JOINTS), FITS - less), np.full((1, N_JOINTS), FITS)])[None]
    (chosen,) = matched(log_ratio, [1.0, exists]).chosen
    assert chosen.tolist() == [0 if person == gets_it else NOBODY for person in range(2)]


def test_who_is_surely_there_does_not_take_what_does_not_fit() -> None:
    np.testing.assert_array_equal(matched(grouped(2)[:, ::-1], [1.0, 1e-3]).chosen, [[1, 0]])


def test_a_second_detection_of_somebody_is_not_free() -> None:
    log_ratio = np.full((1, 1, 3, N_JOINTS), DOES_NOT)
    log_ratio[0, 0, 0], log_ratio[0, 0, 2] = FITS - 1, FITS
    matches = matched(log_ratio)
    np.testing.assert_array_equal(matches.chosen, [[2]])
    np.testing.assert_array_equal(matches.is_double, [[True, False, False]])
    np.testing.assert_array_equal(matches.is_free, [[False, True, False]])


def test_the_other_half_of_a_body_that_is_split_is_not_free() -> None:
    """With two joints of somebody else in it: not nearly all of it fits."""
    log_ratio = np.full((1, 1, 3, 12), np.nan)
    log_ratio[0, 0, 0, :6], log_ratio[0, 0, 1, 6:], log_ratio[0, 0, 2] = FITS, FITS - 1, DOES_NOT
    log_ratio[0, 0, 1, 10:] = DOES_NOT
    matches = match(Likelihood(log_ratio), np.zeros((1, 1, 3), dtype=int), np.ones(1), np.arange(12))
    np.testing.assert_array_equal(matches.chosen, [[0]])
    np.testing.assert_array_equal(matches.is_double, [[False, True, False]])
    np.testing.assert_array_equal(matches.is_free, [[False, False, True]])


def test_the_other_half_of_somebody_is_not_given_to_who_may_be_anywhere() -> None:
    """The joints of the second half are those of the first person, with left and right exchanged."""
    log_ratio = np.full((1, 2, 2, 6), np.nan)
    log_ratio[0, :, 0, :3] = [[FITS], [DOES_NOT]]
    log_ratio[0, :, 1, 3:] = [[FITS], [1.0]]
    sides, mirror = np.array([[[0, 1], [0, 0]]]), np.array([0, 1, 2, 4, 3, 5])
    matches = match(Likelihood(log_ratio), sides, np.ones(2), mirror)
    np.testing.assert_array_equal(matches.chosen, [[0, NOBODY]])
    np.testing.assert_array_equal(matches.detection[0], [[0, 0, 0, 1, 1, 1], [NOBODY] * 6])
    np.testing.assert_array_equal(matches.joint[0, 0], [0, 1, 2, 4, 3, 5])
    np.testing.assert_array_equal(matches.is_free, [[False, False]])


def test_half_a_body_beside_another_half_is_of_whom_it_fits_best() -> None:
    log_ratio = np.full((1, 2, 2, 6), np.nan)
    log_ratio[0, :, 0, :3] = [[FITS], [DOES_NOT]]
    log_ratio[0, :, 1, 3:] = [[1.0], [FITS]]
    matches = match(Likelihood(log_ratio), np.zeros((1, 2, 2), dtype=int), np.ones(2), np.arange(6))
    np.testing.assert_array_equal(matches.chosen, [[0, 1]])


def test_what_may_be_of_somebody_else_once_more_tells_nothing() -> None:
    """The second detection fits both people, the first the first alone; without it the second person gets one that
    nobody else explains."""
    log_ratio = grouped(2)
    log_ratio[0, 0, 1] = FITS - 1
    (score,), (gain,) = matched(log_ratio).score, matched(log_ratio).gain
    assert gain.tolist() == [score[0], 0.0]
    (score,), (gain,) = matched(log_ratio[:, :, 1:]).score, matched(log_ratio[:, :, 1:]).gain
    assert 0 < gain[1] < score[1]


def test_a_joint_that_fits_another_is_theirs() -> None:
    """The wrist of the second person, in the detection of the first; their own was not detected."""
    log_ratio = grouped(2)
    log_ratio[0, :, 0, 3] = DOES_NOT, FITS
    log_ratio[0, :, 1, 3] = np.nan
    matches = matched(log_ratio)
    np.testing.assert_array_equal(matches.detection[0], [[0, 0, 0, NOBODY], [1, 1, 1, 0]])
    np.testing.assert_array_equal(matches.joint[0, 1], [0, 1, 2, 3])


def test_a_joint_that_fits_another_is_not_theirs_if_their_own_fits() -> None:
    log_ratio = grouped(2)
    log_ratio[0, :, 0, 3] = DOES_NOT, FITS
    matches = matched(log_ratio)
    np.testing.assert_array_equal(matches.detection[0], [[0, 0, 0, NOBODY], [1, 1, 1, 1]])


def test_a_joint_that_fits_two_others_is_neither_s() -> None:
    log_ratio = grouped(3)
    log_ratio[0, :, 0, 3] = DOES_NOT, FITS, FITS
    log_ratio[0, 1:, 1:, 3] = np.nan
    matches = matched(log_ratio)
    assert (matches.detection[0, 1:, 3] != 0).all()


def test_a_joint_goes_to_somebody_without_a_detection() -> None:
    log_ratio = grouped(2)[:, :, :1]
    log_ratio[0, :, 0, 3] = DOES_NOT, FITS
    matches = matched(log_ratio)
    np.testing.assert_array_equal(matches.detection[0], [[0, 0, 0, NOBODY], [NOBODY] * 3 + [0]])


def test_two_who_have_each_other_s_joint_both_get_their_own() -> None:
    log_ratio = grouped(2)
    log_ratio[0, :, 0, 3] = DOES_NOT, FITS
    log_ratio[0, :, 1, 3] = FITS, DOES_NOT
    matches = matched(log_ratio)
    np.testing.assert_array_equal(matches.detection[0], [[0, 0, 0, 1], [1, 1, 1, 0]])


def test_a_mirrored_detection_gives_its_joints_to_the_other_side() -> None:
    mirrored = np.array([[[True, False], [False, False]]])
    matches = matched(grouped(2), mirrored=mirrored)
    np.testing.assert_array_equal(matches.joint[0], [MIRROR, np.arange(N_JOINTS)])


def test_no_joint_of_a_mirrored_detection_is_of_two_people() -> None:
    """Joint 1 of the first person is joint 2 of their mirrored detection, and does not fit. Joint 1 of the detection is
    their joint 2, and fits them; that it would fit the second person as well does not matter."""
    log_ratio = grouped(2)
    mirrored = np.array([[[True, False], [False, False]]])
    log_ratio[0, :, 0, 1] = DOES_NOT, FITS
    log_ratio[0, 1, 1, 1] = np.nan
    matches = matched(log_ratio, mirrored=mirrored)
    used = [(p, j) for p, j in zip(matches.detection.ravel(), matches.joint.ravel(), strict=True) if p != NOBODY]
    assert len(set(used)) == len(used)


def test_a_joint_of_a_mirrored_detection_is_handed_over_as_the_joint_it_is() -> None:
    """Joint 2 of the detection is the neighbour's; read as joint 1 of the first person it does not fit."""
    log_ratio = grouped(2)
    mirrored = np.array([[[True, False], [False, False]]])
    log_ratio[0, 0, 0, 1] = DOES_NOT
    log_ratio[0, 1, 0, 2] = FITS
    log_ratio[0, 1, 1, 2] = np.nan
    matches = matched(log_ratio, mirrored=mirrored)
    np.testing.assert_array_equal(matches.detection[0], [[0, NOBODY, 0, 0], [1, 1, 0, 1]])
    assert matches.joint[0, 1, 2] == 2


def test_values_and_probabilities_of_the_matched_joints() -> None:
    log_ratio = grouped(2)
    log_ratio[0, :, 0, 3] = DOES_NOT, FITS
    log_ratio[0, :, 1, 3] = np.nan
    matches = matched(log_ratio)
    values = np.arange(2 * N_JOINTS, dtype=float).reshape(1, 2, N_JOINTS)
    np.testing.assert_array_equal(matches.of(values)[0], [[0, 1, 2, np.nan], [4, 5, 6, 3]])
    likelihood = Likelihood(log_ratio)
    probability = matches.probability(likelihood)[0]
    assert probability[0, 3] == 0.0
    assert (np.delete(probability.ravel(), 3) > 0.99).all()


def test_images_without_detections_and_rooms_without_people() -> None:
    assert matched(np.zeros((3, 2, 0, N_JOINTS))).is_free.shape == (3, 0)
    assert (matched(np.zeros((3, 2, 0, N_JOINTS))).chosen == NOBODY).all()
    assert matched(np.zeros((3, 0, 2, N_JOINTS)), []).is_free.all()
    assert Matches.nobody(3, 2, N_JOINTS).is_free.all()


@pytest.fixture
def passing(skeleton: Skeleton) -> tuple[np.ndarray, PoseFilters]:
    """Two people 0.7 m apart, 24 cm beside each other in the first camera, and predicted the other way round there."""
    away = ring_rig(3).cameras[0].world_T_camera[:2, 2].copy()
    away /= np.linalg.norm(away)
    aside = np.array([-away[1], away[0]])
    true_m = np.stack([body_m(skeleton, (side * (0.12 * aside - 0.35 * away)).tolist()) for side in (1, -1)])
    wrong_m = [body_m(skeleton, (side * (-0.12 * aside - 0.35 * away)).tolist()) for side in (1, -1)]
    covariance_m2 = np.tile(0.2**2 * np.eye(3), (skeleton.n_joints, 1, 1))
    return true_m, PoseFilters.stacked([PoseFilters.at(0.0, each_m, covariance_m2) for each_m in wrong_m])


def test_who_pass_each_other_in_one_view_are_told_apart_by_the_others(
    skeleton: Skeleton, passing: tuple[np.ndarray, PoseFilters]
) -> None:
    rig, (true_m, people) = ring_rig(3), passing
    moment = moment_of(rig, [list(true_m)] * 3, np.random.default_rng(0))
    expected = people.seen_by(rig, moment.times_s)
    none, there = np.zeros((3, 2, 2), dtype=int), np.ones(2)
    np.testing.assert_array_equal(
        match(moment.likelihood(expected), none, there, skeleton.mirror).chosen, [[1, 0], [0, 1], [0, 1]]
    )
    found, matches = follow(people, there, moment, skeleton.mirror)
    np.testing.assert_array_equal(matches.chosen, [[0, 1], [0, 1], [0, 1]])
    # 3 px are 12 mm at 4.5 m; the worst of 34 joints from three views.
    assert np.linalg.norm(found.positions_m - true_m, axis=-1).max() < 0.06


def test_one_camera_alone_has_no_others(skeleton: Skeleton, passing: tuple[np.ndarray, PoseFilters]) -> None:
    true_m, people = passing
    moment = moment_of(ring_rig(3).subset(["ring_0"]), [list(true_m)], np.random.default_rng(0))
    _, matches = follow(people, np.ones(2), moment, skeleton.mirror)
    np.testing.assert_array_equal(matches.chosen, [[1, 0]])


def test_joints_that_are_clipped_to_the_image_do_not_count() -> None:
    """Whoever is cut by the border of an image has joints that are put there; all others stay."""
    rig = ring_rig()
    width_px, height_px = rig.cameras[0].size_px
    seen_px = np.array([[[100.5, 200.5], [0.0, 300.5], [width_px - 1.0, 10.5], [50.5, height_px]]])
    moment = Moment.of([Detections(rig.names[0], 0.0, seen_px, np.ones((1, 4)))], rig)
    np.testing.assert_allclose(moment.points_px[0, 0, 0], rig.cameras[0].undistort(seen_px[0, :1])[0], rtol=1e-12)
    assert np.isnan(moment.points_px[0, 0, 1:]).all()
