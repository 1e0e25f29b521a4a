"""What filters make of errors, against the linear problem of a joint alone solved with matrices."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

from fgpose.estimation.covariances.filter_response import FilterResponse, filter_responses, index_of_gain

STEP_S, N_FRAMES, N_LATER = 0.02, 160, 60
TIMES_S = (0.0, 0.05, 0.15, np.inf)
# In 160 frames a slow filter is in its steady state to 1 %. The integrals are good to 1 %; the matrices take white
# acceleration, the filters one that is constant during each step, which differs by less than 1 % at these indices.
TOLERANCE = 0.03
ALONE = np.array([0.8, 0.8, 0.8, 1.0])
"""What bones and robust kernels leave of the errors."""


def matrices(added: float, model: str) -> np.ndarray:
    """Positions from detections of variance 1 of a joint that moves so, as the least squares that the graph solves."""
    if model == "random_walk":
        moves = np.diff(np.eye(N_FRAMES), axis=0) / np.sqrt(added)
        return np.linalg.inv(np.eye(N_FRAMES) + moves.T @ moves)
    precision = np.linalg.inv(added * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]]))
    information = np.zeros((2 * N_FRAMES, 2 * N_FRAMES))
    step = np.hstack([-np.array([[1.0, 1.0], [0.0, 1.0]]), np.eye(2)])
    for frame in range(N_FRAMES - 1):
        both = slice(2 * frame, 2 * frame + 4)
        information[both, both] += step.T @ precision @ step
    information[::2, ::2] += np.eye(N_FRAMES)
    return np.linalg.inv(information)[::2, ::2]


def variances(gains: np.ndarray) -> np.ndarray:
    apart_s = STEP_S * np.abs(np.subtract.outer(np.arange(N_FRAMES), np.arange(N_FRAMES)))
    correlations = [np.exp(-apart_s / time_s) if time_s else np.eye(N_FRAMES) for time_s in TIMES_S]
    return np.array([gains @ correlation @ gains for correlation in correlations])


@pytest.mark.parametrize(
    ("added", "model"), [(1e-4, "constant_velocity"), (1e-2, "constant_velocity"), (1e-2, "random_walk")]
)
def test_responses_are_those_of_the_linear_problem(
    added: float, model: Literal["constant_velocity", "random_walk"]
) -> None:
    newest, smoothed, difference = filter_responses(np.array([np.sqrt(added)]), STEP_S, TIMES_S, model)
    gains, at = matrices(added, model), N_FRAMES - 1 - N_LATER
    early = matrices(added, model)[-1]
    of_newest = np.append(early[N_LATER:], np.zeros(N_LATER))  # of the same frame, before the later ones were there
    graph = gains[-1, -1]

    def check(response: FilterResponse, gain: np.ndarray, of_graph: float, total: float) -> None:
        expected = ALONE * variances(gain) / of_graph
        np.testing.assert_allclose(response.noise[0], expected, rtol=TOLERANCE, atol=0.01)
        assert response.motion[0] == pytest.approx(total / of_graph - expected[0], abs=TOLERANCE)

    check(newest, gains[-1], graph, graph)
    check(smoothed, gains[at], gains[at, at], gains[at, at])
    check(difference, of_newest - gains[at], graph, graph - gains[at, at])


def test_without_a_motion_model_each_frame_is_alone() -> None:
    newest, smoothed, difference = filter_responses(np.array([0.1]), STEP_S, TIMES_S, "none")
    for response in (newest, smoothed):
        assert (response.noise == 1).all()
        assert (response.motion == 0).all()
    assert (difference.noise == 0).all()


def test_the_index_of_a_gain_gives_that_gain() -> None:
    """Constant errors pass whole: their share of the variance of the graph is the inverse of the gain."""
    gains = np.array([0.05, 0.3, 0.9])
    newest, _, _ = filter_responses(index_of_gain(gains), STEP_S, TIMES_S, "constant_velocity")
    np.testing.assert_allclose(1 / newest.noise[:, -1], gains, rtol=1e-3)  # between two indices of a table


def test_errors_that_joints_share_are_not_averaged_over_bones() -> None:
    index, model = np.full(2, 0.1), "constant_velocity"
    newest, _, _ = filter_responses(index, STEP_S, TIMES_S, model, shared=np.array([0.0, 1.0]))
    np.testing.assert_allclose(newest.noise[0] / newest.noise[1], ALONE, rtol=1e-12)
    assert newest.motion[0] == newest.motion[1]  # of the graph, in which errors are independent
