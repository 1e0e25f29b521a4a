"""The sliding window of iSAM2 against a plain Kalman filter and smoother."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from fgpose.estimation.keys import position_key, velocity_key
from fgpose.estimation.solvers.fixed_lag import FixedLagSmoother
from fgpose_factors import State, constant_velocity_factor, noise_model

STEP_S, DENSITY, SIGMA_M = 0.02, 20.0, 0.02


def frame_of(number: int, measured_m: np.ndarray) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values, list[int]]:
    """One joint, measured directly: a linear problem, so that the filter is exact."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    position, velocity = position_key(0, number), velocity_key(0, number)
    graph.add(gtsam.PriorFactorPoint3(position, measured_m, noise_model(3, SIGMA_M)))
    if number == 0:
        graph.add(gtsam.PriorFactorPoint3(velocity, np.zeros(3), noise_model(3, 1.0)))
    else:
        before = State(position_key(0, number - 1), velocity_key(0, number - 1), (number - 1) * STEP_S)
        graph.add(constant_velocity_factor(before, State(position, velocity, number * STEP_S), DENSITY))
    values.insert(position, measured_m)
    values.insert(velocity, np.zeros(3))
    return graph, values, [position, velocity]


def kalman_filter(measured_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Filtered positions and the variance of the last one, per axis, by the textbook recursion."""
    F = np.array([[1.0, STEP_S], [0.0, 1.0]])
    Q = DENSITY * np.array([[STEP_S**3 / 3, STEP_S**2 / 2], [STEP_S**2 / 2, STEP_S]])
    P, state = np.diag([SIGMA_M**2, 1.0]), np.stack([measured_m[0], np.zeros(3)])
    filtered = [state[0]]
    for measurement in measured_m[1:]:
        state, P = F @ state, F @ P @ F.T + Q
        gain = P[:, 0] / (P[0, 0] + SIGMA_M**2)
        state = state + np.outer(gain, measurement - state[0])
        P = P - np.outer(gain, P[0])
        filtered.append(state[0])
    return np.array(filtered), P


# 3 frames are more than the two variables of a frame can label in order, so the order must be restored now and then.
@pytest.mark.parametrize("lag", [1, 3, 12])
def test_the_newest_estimate_is_that_of_a_kalman_filter(lag: int) -> None:
    rng = np.random.default_rng(0)
    measured_m = np.cumsum(rng.normal(0, 0.02, (60, 3)), axis=0)
    smoother = FixedLagSmoother(relinearize_m=1e-3)
    filtered_m, variance = kalman_filter(measured_m)
    for number, measurement in enumerate(measured_m):
        smoother.add(*frame_of(number, measurement))
        if number >= lag:
            smoother.drop_oldest()
        # 1e-6 m: GTSAM back-substitutes only where the change exceeds its wildfire threshold.
        np.testing.assert_allclose(smoother.point(position_key(0, number)), filtered_m[number], atol=1e-6)
    covariance_m2 = smoother.covariances([position_key(0, 59)])[0]
    np.testing.assert_allclose(covariance_m2, variance[0, 0] * np.eye(3), rtol=1e-6, atol=1e-12)


def test_frames_without_variables_and_separate_frames() -> None:
    smoother = FixedLagSmoother(relinearize_m=0.01)
    for number in range(6):
        if number % 2:
            smoother.add(gtsam.NonlinearFactorGraph(), gtsam.Values(), [])
        else:
            graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
            graph.add(gtsam.PriorFactorPoint3(position_key(0, number), np.ones(3), noise_model(3, 0.1)))
            values.insert(position_key(0, number), np.zeros(3))
            smoother.add(graph, values, [position_key(0, number)])
    for _ in range(5):
        smoother.drop_oldest()
    assert smoother.covariances([]).shape == (0, 3, 3)
