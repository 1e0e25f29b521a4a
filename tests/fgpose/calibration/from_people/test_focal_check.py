"""Focal lengths that were given are checked by the recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_walk_adjustment import MORE, RIG, started
from walks import walk

from fgpose.calibration.adjustment.unknowns import FOCAL, Unknowns
from fgpose.calibration.from_people.rig.focal_check import FocalCheck, check_focal
from fgpose.calibration.from_people.rig.walk_adjustment import adjust
from fgpose.calibration.from_people.verdict.sigmas import RigEstimate, disagreement
from fgpose.geometry.camera import Camera, CameraRig
from fgpose_benchmarks.synthetic import DetectionNoise


def checked(ratio: float) -> FocalCheck:
    """With the focal length of the second camera given as so many times the true one."""
    start = list(started(RIG, 1.0).cameras)
    start[1] = with_focal(start[1], ratio)
    adjusted = adjust(walk(RIG, 600, DetectionNoise()), CameraRig(tuple(start)), config=MORE)
    return check_focal(adjusted.problem, adjusted.state)


def with_focal(camera: Camera, ratio: float) -> Camera:
    K = camera.K.copy()
    K[[0, 1], [0, 1]] *= ratio
    return replace(camera, K=K)


def test_each_focal_length_is_as_in_a_problem_of_its_own() -> None:
    """Joints are eliminated once for all of them."""
    problem = adjust(walk(RIG, 40, DetectionNoise()), started(RIG, 1.0), config=MORE)
    held, state = problem.problem.unknowns, problem.state
    check = check_focal(problem.problem, state)
    for c in range(RIG.n_cameras):
        free = problem.problem.with_unknowns(Unknowns.of(RIG.n_cameras, held.poses, ((c,),), clocks=held.clocks))
        step = free.equations(state).solve(-free.gradient(state))[: free.unknowns.n_shared]
        assert check.change[c] == pytest.approx(free.unknowns.of_cameras(step)[c, FOCAL], rel=1e-9)
        assert check.sigma[c] == pytest.approx(np.sqrt(free.covariance(state)[c, FOCAL, c, FOCAL]), rel=1e-9)


@pytest.mark.slow
def test_right_focal_lengths_hardly_change() -> None:
    check = checked(1.0)
    assert (check.sigma < 0.05).all()
    assert (np.abs(check.change) < 3 * check.sigma).all()


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.75, 1.3])
def test_a_wrong_focal_length_would_change_back(ratio: float) -> None:
    check = checked(ratio)
    # One step of a problem that is not linear: it comes to within a third of the way.
    assert check.change[1] == pytest.approx(-np.log(ratio), rel=0.33)
    assert np.abs(check.change).argmax() == 1
    assert abs(check.change[1]) > 5 * check.sigma[1]


def test_how_probably_a_focal_length_is_wrong() -> None:
    """By Bayes' rule: one in ten is, by a tenth; errors are twice as large as the independent ones that sigma is of."""
    change, sigma = np.array([0.0, 0.04, 0.1, 0.3, 0.3]), np.array([0.01, 0.01, 0.01, 0.01, 0.06])
    check = FocalCheck(change, sigma, np.zeros((5, 5, 6)))
    if_right = 0.9 * np.exp(-(change**2) / (2 * 0.02**2)) / 0.02
    if_wrong = 0.1 * np.exp(-(change**2) / (2 * (0.02**2 + 0.1**2))) / np.hypot(0.02, 0.1)
    np.testing.assert_allclose(check.wrong[:4], (if_wrong / (if_right + if_wrong))[:4], rtol=1e-9)
    assert check.wrong[4] == 0  # nothing is known of it
    assert check.wrong[0] < 0.05 < 0.95 < check.wrong[2]


def test_what_may_be_wrong_is_in_the_covariance_of_the_poses() -> None:
    moves = np.random.default_rng(0).normal(0, 0.1, (2, 2, 6))
    check = FocalCheck(np.array([0.0, 0.2]), np.full(2, 0.01), moves)
    expected = sum(wrong * np.outer(each, each) for wrong, each in zip(check.wrong, moves.reshape(2, 12), strict=True))
    np.testing.assert_allclose(check.covariance.reshape(12, 12), expected)


@pytest.mark.slow
def test_cameras_move_with_a_focal_length_as_they_are_off_by_it() -> None:
    """The second camera is 8 % too long, which drags it; what is left of that is less than half."""
    start, true = list(started(RIG, 1.0).cameras), started(RIG, 1.0)
    start[1] = with_focal(start[1], 1.08)
    filmed = walk(RIG, 600, DetectionNoise())
    wrong, right = (adjust(filmed, rig, config=MORE) for rig in (CameraRig(tuple(start)), true))
    check = check_focal(wrong.problem, wrong.state)
    covariance = np.einsum("ci,dj->cidj", check.moves[1], check.moves[1])
    zero = np.zeros(wrong.rig.n_cameras)
    moved = RigEstimate(wrong.rig, covariance, zero, zero).aligned(right.rig).variances()
    off = disagreement(wrong.rig, right.rig)
    assert (off.position_m2[1] / moved.position_m2[1]) ** 0.5 == pytest.approx(1.0, abs=0.5)
