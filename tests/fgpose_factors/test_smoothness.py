from __future__ import annotations

from typing import Any

import gtsam
import numpy as np
import pytest

from fgpose_factors import (
    Motion,
    State,
    constant_velocity_factor,
    fading_velocity_factor,
    interpolate_position,
    interpolated_factor,
    noise_model,
    random_walk_factor,
)
from fgpose_factors.testing import numerical_linearization

DENSITY = 20.0


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def x(frame: int) -> int:
    return gtsam.symbol("x", frame)


def v(frame: int) -> int:
    return gtsam.symbol("v", frame)


def state(frame: int, time_s: float) -> State:
    return State(x(frame), v(frame), time_s)


def states(*rows: tuple[np.ndarray, np.ndarray]) -> gtsam.Values:
    values = gtsam.Values()
    for frame, (position_m, velocity_mps) in enumerate(rows):
        values.insert(x(frame), np.asarray(position_m, dtype=float))
        values.insert(v(frame), np.asarray(velocity_mps, dtype=float))
    return values


def wnoa_covariance(step_s: float, density: float) -> np.ndarray:
    """Covariance of (position, velocity) after a step of white noise on acceleration, independent of the library."""
    Q = density * np.array([[step_s**3 / 3, step_s**2 / 2], [step_s**2 / 2, step_s]])
    return np.kron(Q, np.eye(3))


def test_constant_velocity_is_zero_for_constant_velocity(rng):
    position_m, velocity_mps = rng.normal(size=(2, 3))
    factor = constant_velocity_factor(state(0, 1.0), state(1, 1.07), DENSITY)
    values = states((position_m, velocity_mps), (position_m + 0.07 * velocity_mps, velocity_mps))
    np.testing.assert_allclose(factor.unwhitenedError(values), 0.0, atol=1e-14)


def test_constant_velocity_residual_is_the_departure_in_metres_and_metres_per_second(rng):
    position_m, velocity_mps, off_m, off_mps = rng.normal(size=(4, 3))
    factor = constant_velocity_factor(state(0, 0.0), state(1, 0.1), DENSITY)
    values = states((position_m, velocity_mps), (position_m + 0.1 * velocity_mps + off_m, velocity_mps + off_mps))
    np.testing.assert_allclose(factor.unwhitenedError(values), np.concatenate([off_m, off_mps]), atol=1e-14)


@pytest.mark.parametrize("step_s", [0.005, 1 / 30, 0.5])
def test_constant_velocity_costs_what_white_noise_on_acceleration_says(rng, step_s):
    factor = constant_velocity_factor(state(0, 2.0), state(1, 2.0 + step_s), DENSITY)
    information = np.linalg.inv(wnoa_covariance(step_s, DENSITY))
    for _ in range(10):
        position_m, velocity_mps, next_m, next_mps = rng.normal(size=(4, 3))
        residual = np.concatenate([next_m - position_m - step_s * velocity_mps, next_mps - velocity_mps])
        error = factor.error(states((position_m, velocity_mps), (next_m, next_mps)))
        # the step is a difference of times: 2.005 - 2 is exact to 1e-13 relative, the covariance's condition 1e5
        assert error == pytest.approx(0.5 * residual @ information @ residual, rel=1e-8)


def test_two_steps_are_one_step_of_the_sum(rng):
    """The prior of a trajectory must not depend on how often it is sampled."""
    graph = gtsam.NonlinearFactorGraph()
    start = (rng.normal(size=3), rng.normal(size=3))
    times_s = (0.0, 0.013, 0.05)
    graph.add(gtsam.PriorFactorPoint3(x(0), start[0], noise_model(3, 0.01)))
    graph.add(gtsam.PriorFactorPoint3(v(0), start[1], noise_model(3, 0.1)))
    for frame in (0, 1):
        before, after = (state(f, times_s[f]) for f in (frame, frame + 1))
        graph.add(constant_velocity_factor(before, after, DENSITY))
    here = states(start, start, start)
    joint = gtsam.Marginals(graph, here).jointMarginalCovariance([x(2), v(2)])
    covariance = np.block([[joint.at(a, b) for b in (x(2), v(2))] for a in (x(2), v(2))])
    prior = np.diag(np.repeat([0.01**2, 0.1**2], 3))
    transition = np.kron(np.array([[1, 0.05], [0, 1]]), np.eye(3))
    expected = transition @ prior @ transition.T + wnoa_covariance(0.05, DENSITY)
    np.testing.assert_allclose(covariance, expected, rtol=1e-9, atol=1e-12)


def test_smoothness_factors_linearise_as_they_evaluate(rng):
    values = states(*[(rng.normal(size=3), rng.normal(size=3)) for _ in range(2)])
    factors: list[Any] = [
        constant_velocity_factor(state(0, 0.0), state(1, 0.04), DENSITY),
        random_walk_factor(x(0), x(1), 0.04, 1.0),
        fading_velocity_factor(v(0), v(1), 0.04, DENSITY, 0.15),
        fading_velocity_factor(v(0), None, 0.04, DENSITY, 0.15),
    ]
    for factor in factors:
        A, b = factor.linearize(values).jacobian()
        numerical_A, numerical_b = numerical_linearization(factor, values)
        # linear residuals: rounding of 1 / 1e-6 is 1e-10, times 1 / sigma = 160 / m and up
        np.testing.assert_allclose(A, numerical_A, rtol=1e-8, atol=1e-6)
        np.testing.assert_allclose(b, numerical_b, rtol=1e-9)


def test_random_walk_is_a_between_factor_with_variance_density_times_step(rng):
    step_s, density = 0.04, 2.5
    ours = random_walk_factor(x(0), x(1), step_s, density)
    values = states(*[(rng.normal(size=3), np.zeros(3)) for _ in range(2)])
    moved_m = values.atPoint3(x(1)) - values.atPoint3(x(0))
    np.testing.assert_allclose(ours.unwhitenedError(values), moved_m, rtol=1e-15)
    assert ours.error(values) == pytest.approx(0.5 * moved_m @ moved_m / (density * step_s), rel=1e-12)
    native = gtsam.BetweenFactorPoint3(x(0), x(1), np.zeros(3), noise_model(3, float(np.sqrt(density * step_s))))
    assert ours.equals(native, 1e-12)


@pytest.mark.parametrize("step_s", [0.0, -0.02])
def test_time_must_increase(step_s):
    with pytest.raises(ValueError, match="time must increase"):
        constant_velocity_factor(state(0, 1.0), state(1, 1.0 + step_s), DENSITY)
    with pytest.raises(ValueError, match="time must increase"):
        random_walk_factor(x(0), x(1), step_s, 1.0)


def velocity_filter(step_s: float, fade_s: float, n_steps: int) -> np.ndarray:
    """Kalman filter of one velocity: random acceleration, and "velocity = 0" measured once a step; gain of each step.

    Written from the textbook: P' = P + q dt, K = P' / (P' + r / dt), v = (1 - K) v, P = (1 - K) P', r = q fade^2.
    """
    variance, velocity = DENSITY * fade_s, 1.0  # starts at the stationary variance
    velocities = []
    for _ in range(n_steps):
        variance += DENSITY * step_s
        gain = variance / (variance + DENSITY * fade_s**2 / step_s)
        velocity, variance = (1 - gain) * velocity, (1 - gain) * variance
        velocities.append(velocity)
    return np.array(velocities)


def faded_chain(step_s: float, fade_s: float, n_steps: int, reference_mps: np.ndarray | None) -> gtsam.Values:
    """An unseen joint with 1 m/s at first, and (frame numbers from 1000) a joint that holds it, which is measured."""
    graph = gtsam.NonlinearFactorGraph()
    rows = n_steps + 1
    values = states(*[(np.zeros(3), np.zeros(3)) for _ in range(rows)])
    start_sigma_mps = float(np.sqrt(DENSITY * fade_s))
    graph.add(gtsam.PriorFactorPoint3(x(0), np.zeros(3), noise_model(3, 0.01)))
    graph.add(gtsam.PriorFactorPoint3(v(0), np.array([1.0, 0, 0]), noise_model(3, start_sigma_mps)))
    for frame in range(n_steps):
        before, after = (state(f, f * step_s) for f in (frame, frame + 1))
        graph.add(constant_velocity_factor(before, after, DENSITY))
        reference = None if reference_mps is None else v(1000 + frame)
        graph.add(fading_velocity_factor(v(frame + 1), reference, step_s, DENSITY, fade_s))
        if reference_mps is not None and reference is not None:
            values.insert(reference, reference_mps)
            graph.add(gtsam.PriorFactorPoint3(reference, reference_mps, noise_model(3, 1e-6)))
    return gtsam.GaussNewtonOptimizer(graph, values).optimize()


def newest_velocities(step_s: float, fade_s: float, n_steps: int) -> np.ndarray:
    """The velocity of the newest frame for every length of the chain: what a live estimate shows."""
    return np.array([faded_chain(step_s, fade_s, n, None).atPoint3(v(n))[0] for n in range(1, n_steps + 1)])


def test_an_unseen_velocity_fades_as_the_kalman_filter_says():
    # a chain of linear factors: both are exact; the optimiser inverts a system of condition 1e6
    np.testing.assert_allclose(newest_velocities(0.02, 0.15, 12), velocity_filter(0.02, 0.15, 12), rtol=1e-8)


@pytest.mark.parametrize("fade_s", [0.1, 0.15, 0.4])
def test_an_unseen_velocity_fades_with_its_time_constant(fade_s):
    step_s = fade_s / 50
    velocities = newest_velocities(step_s, fade_s, 50)
    # sampled in steps of fade / 50, the recursion decays by 1 - 1/50 + (1/50)^2 / 2 a step: exp(-1) to 2 %
    assert velocities[-1] == pytest.approx(np.exp(-1), rel=0.02)


def test_how_it_fades_hardly_depends_on_the_frame_rate():
    at_30_fps = newest_velocities(1 / 30, 0.15, 6)[-1]
    at_120_fps = newest_velocities(1 / 120, 0.15, 24)[-1]
    # after 0.2 s; a step of a quarter of the time constant is the coarse one
    assert at_30_fps == pytest.approx(at_120_fps, abs=0.01)


def test_the_velocity_fades_to_that_of_the_joint_that_holds_it():
    reference_mps = np.array([0.3, -0.5, 0.2])
    # twenty time constants: exp(-20)
    last = faded_chain(0.02, 0.05, 50, reference_mps).atPoint3(v(50))
    np.testing.assert_allclose(last, reference_mps, atol=1e-6)


def test_a_joint_unseen_for_long_stays_within_a_known_speed():
    """The stationary variance of the velocity is density x fade; without fading it grows with time."""
    step_s, fade_s, n_steps = 0.005, 0.15, 300
    graph = gtsam.NonlinearFactorGraph()
    values = states(*[(np.zeros(3), np.zeros(3)) for _ in range(n_steps + 1)])
    graph.add(gtsam.PriorFactorPoint3(x(0), np.zeros(3), noise_model(3, 0.01)))
    graph.add(gtsam.PriorFactorPoint3(v(0), np.zeros(3), noise_model(3, 0.01)))
    for frame in range(n_steps):
        before, after = (state(f, f * step_s) for f in (frame, frame + 1))
        graph.add(constant_velocity_factor(before, after, DENSITY))
        graph.add(fading_velocity_factor(v(frame + 1), None, step_s, DENSITY, fade_s))
    variance = gtsam.Marginals(graph, values).marginalCovariance(v(n_steps))[0, 0]
    # one measurement a step instead of a continuous one: step / (2 fade) = 1.7 %
    assert variance == pytest.approx(DENSITY * fade_s, rel=0.02)


def test_interpolation_keeps_a_constant_velocity_and_the_ends(rng):
    position_m, velocity_mps = rng.normal(size=(2, 5, 3))
    before = Motion(position_m, velocity_mps, 3.0)
    after = Motion(position_m + 0.2 * velocity_mps, velocity_mps, 3.2)
    for time_s in (3.0, 3.05, 3.1, 3.2):
        expected = position_m + (time_s - 3.0) * velocity_mps
        np.testing.assert_allclose(interpolate_position(before, after, time_s), expected, atol=1e-13)


def test_interpolation_of_any_cubic_motion_is_exact(rng):
    """The posterior mean of white noise on acceleration is a cubic with these ends."""
    coefficients = rng.normal(size=(4, 3))

    def position(time_s: float) -> np.ndarray:
        return np.polynomial.polynomial.polyval(time_s, coefficients)

    def velocity(time_s: float) -> np.ndarray:
        return np.polynomial.polynomial.polyval(time_s, np.polynomial.polynomial.polyder(coefficients))

    before, after = (Motion(position(t), velocity(t), t) for t in (0.4, 1.1))
    for time_s in (0.4, 0.55, 0.9, 1.1):
        np.testing.assert_allclose(interpolate_position(before, after, time_s), position(time_s), atol=1e-13)


@pytest.mark.parametrize("time_s", [-0.001, 0.201, float("nan")])
def test_interpolation_refuses_a_time_outside(time_s):
    at_rest = (np.zeros(3), np.zeros(3))
    with pytest.raises(ValueError, match="does not lie between"):
        interpolate_position(Motion(*at_rest, 0.0), Motion(*at_rest, 0.2), time_s)


def interpolated_prior(time_s: float, sigma_m: float, measured_m: np.ndarray) -> gtsam.WnoaInterpFactorPoint3:
    inner = gtsam.PriorFactorPoint3(x(9), measured_m, noise_model(3, sigma_m))
    return interpolated_factor(inner, state(0, 0.0), state(1, 0.05), state(9, time_s), DENSITY)


def test_an_interpolated_factor_sees_the_interpolated_position(rng):
    for time_s in (0.013, 0.025, 0.04):
        rows = [(rng.normal(size=3), rng.normal(size=3)) for _ in range(2)]
        expected_m = interpolate_position(Motion(*rows[0], 0.0), Motion(*rows[1], 0.05), time_s)
        measured_m = rng.normal(size=3)
        residual = interpolated_prior(time_s, 0.01, measured_m).unwhitenedError(states(*rows))
        np.testing.assert_allclose(residual, expected_m - measured_m, atol=1e-12)


def test_an_interpolated_factor_adds_the_uncertainty_of_the_bridge():
    """Between two states the motion is an integrated Brownian bridge, whose variance in the middle is q T^3 / 192."""
    sigma_m = 0.002
    factor = interpolated_prior(0.025, sigma_m, np.zeros(3))
    rows = [(np.array([0.01, 0.0, 0.0]), np.zeros(3))] * 2
    variance_m2 = sigma_m**2 + DENSITY * 0.05**3 / 192
    assert factor.error(states(*rows)) == pytest.approx(0.5 * 0.01**2 / variance_m2, rel=1e-9)


def test_an_interpolated_factor_takes_part_in_an_optimisation():
    graph = gtsam.NonlinearFactorGraph()
    for frame in (0, 1):
        graph.add(gtsam.PriorFactorPoint3(x(frame), np.zeros(3), noise_model(3, 0.1)))
        graph.add(gtsam.PriorFactorPoint3(v(frame), np.zeros(3), noise_model(3, 1.0)))
    graph.add(constant_velocity_factor(state(0, 0.0), state(1, 0.05), DENSITY))
    graph.add(interpolated_prior(0.025, 1e-4, np.array([0.0, 0.0, 0.03])))
    result = gtsam.GaussNewtonOptimizer(graph, states(*[(np.zeros(3), np.zeros(3))] * 2)).optimize()
    rows = [Motion(result.atPoint3(x(f)), result.atPoint3(v(f)), 0.05 * f) for f in (0, 1)]
    middle_m = interpolate_position(rows[0], rows[1], 0.025)
    # the priors (0.07 m together) give way to the measurement (4 mm with the bridge): 3 cm x (4 / 70)^2 = 0.1 mm
    np.testing.assert_allclose(middle_m, [0, 0, 0.03], atol=5e-4)
    assert middle_m[2] > 0.029


def test_an_interpolated_factor_refuses_what_would_crash_gtsam():
    robust = gtsam.PriorFactorPoint3(x(9), np.zeros(3), noise_model(3, 0.01, "huber"))
    ends = state(0, 0.0), state(1, 0.05)
    with pytest.raises(ValueError, match="Gaussian noise only"):
        interpolated_factor(robust, *ends, state(9, 0.02), DENSITY)
    gaussian = gtsam.PriorFactorPoint3(x(9), np.zeros(3), noise_model(3, 0.01))
    for time_s in (-0.01, 0.06, float("nan")):
        with pytest.raises(ValueError, match="does not lie between"):
            interpolated_factor(gaussian, *ends, state(9, time_s), DENSITY)
