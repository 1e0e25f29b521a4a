from __future__ import annotations

import numpy as np

from fgpose.config import MotionConfig
from fgpose.estimation.initial_guess import active_joints, fill_gaps, median_lengths, time_to_known_s
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status, joint_status

NAN = np.nan


def guesses(*known: list[int]) -> np.ndarray:
    """(frame, joint, 3) with the joint's frames of 1 known, its position the frame number."""
    guess_m = np.array(known, dtype=float).T[..., None] * np.ones(3)
    guess_m = np.where(guess_m > 0, np.arange(len(guess_m))[:, None, None], NAN)
    return guess_m.astype(float)


def test_with_a_motion_model_a_joint_is_active_near_in_time_to_a_guess():
    guess_m = guesses([0, 0, 1, 0, 0, 0, 1, 0], [1, 1, 1, 1, 1, 1, 1, 1], [0, 0, 0, 0, 0, 0, 0, 0])
    active = active_joints(guess_m, np.arange(8) * 0.1, MotionConfig(max_unseen_s=0.11))
    np.testing.assert_array_equal(active[:, 0], [0, 1, 1, 1, 0, 1, 1, 1])
    assert active[:, 1].all()
    assert not active[:, 2].any()


def test_near_is_a_matter_of_seconds_not_of_frames():
    guess_m = guesses([1, 0, 0, 0, 1])
    active = active_joints(guess_m, np.array([0.0, 0.1, 0.5, 5.0, 5.1]), MotionConfig(max_unseen_s=0.2))
    np.testing.assert_array_equal(active[:, 0], [1, 1, 0, 1, 1])


def test_without_a_motion_model_a_joint_is_active_where_it_has_a_guess():
    guess_m = guesses([0, 1, 0, 1])
    guess_m[3, 0, 2] = NAN
    active = active_joints(guess_m, np.arange(4) * 0.1, MotionConfig(model="none"))
    np.testing.assert_array_equal(active[:, 0], [0, 1, 0, 0])


def test_gaps_are_filled_linearly_in_time_and_ends_held():
    time_s = np.array([0.0, 1.0, 2.0, 4.0, 5.0])
    guess_m = np.full((5, 3, 3), NAN)
    guess_m[1, 0], guess_m[3, 0] = [1, 10, 0], [4, 40, 0]
    guess_m[:, 1] = 7.0
    before = guess_m.copy()
    filled_m = fill_gaps(guess_m, time_s)
    np.testing.assert_allclose(filled_m[:, 0], [[1, 10, 0], [1, 10, 0], [2, 20, 0], [4, 40, 0], [4, 40, 0]])
    np.testing.assert_array_equal(filled_m[:, 1], 7.0)
    assert np.isnan(filled_m[:, 2]).all()
    np.testing.assert_array_equal(guess_m, before)


def test_status_of_every_combination():
    active, observed = np.array([True, True, False, False]), np.array([True, False, True, False])
    np.testing.assert_array_equal(
        joint_status(active, observed),
        [Status.OBSERVED, Status.PREDICTED, Status.UNOBSERVABLE, Status.UNOBSERVABLE],
    )


def test_lengths_are_medians_over_time_and_both_sides():
    body = Skeleton("body", ("l0", "l1", "r0", "r1", "m"), ((0, 1), (2, 3), (0, 4)), (0,), ((0, 2), (1, 3)))
    positions_m = np.zeros((2, 5, 3))
    positions_m[:, 1, 0] = 0.30, 0.32
    positions_m[:, 3, 1] = 0.29, 0.50
    positions_m[:, 4] = NAN
    lengths_m = median_lengths(body, positions_m)
    np.testing.assert_allclose(lengths_m, [0.31, NAN])
    positions_m[1, 3] = NAN
    np.testing.assert_allclose(median_lengths(body, positions_m), [0.30, NAN])


def test_time_to_the_nearest_sight() -> None:
    seen = np.array([[True, False], [False, False], [False, False], [True, False]])
    unseen_s = time_to_known_s(seen, np.array([0.0, 0.1, 0.2, 0.5]))
    np.testing.assert_allclose(unseen_s[:, 0], [0.0, 0.1, 0.2, 0.0])
    assert np.isinf(unseen_s[:, 1]).all()
