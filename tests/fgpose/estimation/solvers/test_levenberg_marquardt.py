from __future__ import annotations

import gtsam
import numpy as np
import pytest

from fgpose.estimation.solvers.gtsam_problem import GraphProblem
from fgpose.estimation.solvers.levenberg_marquardt import Solution, levenberg_marquardt
from fgpose.geometry.camera import CameraRig
from fgpose_benchmarks.synthetic import Scene
from fgpose_factors import State, constant_velocity_factor, custom_factor, noise_model, projection_factor

X = gtsam.symbol("x", 0)


def solve(
    graph: gtsam.NonlinearFactorGraph, initial: gtsam.Values, max_iterations: int = 100
) -> Solution[gtsam.Values]:
    return levenberg_marquardt(GraphProblem(graph, step_tolerance_m=1e-9), initial, max_iterations)


def at(point_m: np.ndarray) -> gtsam.Values:
    values = gtsam.Values()
    values.insert(X, np.asarray(point_m, dtype=float))
    return values


def arctangent(point: np.ndarray) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """The textbook case: Newton's step from |x| > 1.39 lands farther out on the other side."""
    return np.arctan(point), (np.diag(1 / (1 + point**2)),)


def test_converges_where_gauss_newton_diverges():
    graph = gtsam.NonlinearFactorGraph()
    graph.add(custom_factor((X,), noise_model(3, 0.05), arctangent, (gtsam.Values.atPoint3,)))
    start = at(np.array([3.0, -2.0, 5.0]))
    undamped = start.retract(graph.linearize(start).optimize())
    assert graph.error(undamped) > graph.error(start)
    solution = solve(graph, start)
    assert solution.convergence.converged
    # the last step is below 1e-9, and convergence is better than linear
    np.testing.assert_allclose(solution.state.atPoint3(X), 0.0, atol=1e-8)


def moving_point(scene: Scene, rig: CameraRig, joint: int = 13) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """One joint through five frames: robust projection factors and constant velocity; a start half a metre off."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    noise = noise_model(2, 6.0, "cauchy", 1.5)
    for frame in range(5):
        x, v = gtsam.symbol("x", frame), gtsam.symbol("v", frame)
        for camera in range(rig.n_cameras):
            measured_px = scene.observations.points2d_px[frame, camera, joint]
            graph.add(projection_factor(x, measured_px, noise, rig.cameras[camera].gtsam))
        if frame:
            before = State(gtsam.symbol("x", frame - 1), gtsam.symbol("v", frame - 1), (frame - 1) / 30)
            graph.add(constant_velocity_factor(before, State(x, v, frame / 30), 20.0))
        values.insert(x, scene.truth_m[frame, joint] + np.array([0.3, -0.3, 0.3]))
        values.insert(v, np.zeros(3))
    graph.add(gtsam.PriorFactorPoint3(gtsam.symbol("v", 0), np.zeros(3), noise_model(3, 3.0)))
    return graph, values


def test_finds_the_optimum_that_gtsams_own_optimiser_finds(walking_scene, rig):
    graph, initial = moving_point(walking_scene, rig)
    solution = solve(graph, initial)
    params = gtsam.LevenbergMarquardtParams()
    params.setRelativeErrorTol(1e-14)
    params.setAbsoluteErrorTol(1e-14)
    native = gtsam.LevenbergMarquardtOptimizer(graph, initial, params).optimize()
    assert solution.convergence.final_error == pytest.approx(graph.error(native), rel=1e-6)
    for frame in range(5):
        key = gtsam.symbol("x", frame)
        # GTSAM's stops when an iteration lowers the error by less than 1e-14 of it
        np.testing.assert_allclose(solution.state.atPoint3(key), native.atPoint3(key), atol=1e-4)


def test_a_linear_problem_is_solved_at_once_and_then_confirmed():
    graph = gtsam.NonlinearFactorGraph()
    graph.add(gtsam.PriorFactorPoint3(X, np.array([1.0, 2.0, 3.0]), noise_model(3, 0.1)))
    solution = solve(graph, at(np.zeros(3)))
    assert solution.convergence.converged
    assert solution.convergence.iterations == 2
    assert solution.convergence.initial_error == pytest.approx(0.5 * 14 / 0.1**2)
    # rounding of 1e-16 / 0.1
    assert solution.convergence.final_error < 1e-20
    np.testing.assert_allclose(solution.state.atPoint3(X), [1.0, 2.0, 3.0], rtol=1e-14)


def test_a_variable_that_nothing_determines_stays_where_it_is(walking_scene, rig):
    """One camera leaves the depth open: the undamped system is indeterminate."""
    camera = rig.cameras[0]
    point_m = walking_scene.truth_m[0, 0]
    measured_px = camera.project(point_m) + np.array([30.0, 0.0])
    graph = gtsam.NonlinearFactorGraph()
    graph.add(projection_factor(X, measured_px, noise_model(2, 6.0), camera.gtsam))
    solution = solve(graph, at(point_m))
    assert solution.convergence.converged
    found_m = solution.state.atPoint3(X)
    # 30 px at about 4.5 m are 12 cm sideways; along the ray it has no reason to move but the turn of the ray
    np.testing.assert_allclose(camera.project(found_m), measured_px, atol=1e-3)
    assert np.linalg.norm(found_m - point_m) < 0.2


def test_iterations_that_run_out_are_reported(walking_scene, rig):
    graph, initial = moving_point(walking_scene, rig)
    convergence = solve(graph, initial, max_iterations=2).convergence
    assert not convergence.converged
    assert convergence.iterations == 2
    assert convergence.final_error < convergence.initial_error
    assert convergence.initial_error == graph.error(initial)


def test_an_error_that_is_no_number_is_reported_and_the_start_returned():
    def not_a_number(point: np.ndarray) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        return np.full(3, np.nan), (np.eye(3),)

    graph = gtsam.NonlinearFactorGraph()
    graph.add(custom_factor((X,), noise_model(3, 0.1), not_a_number, (gtsam.Values.atPoint3,)))
    solution = solve(graph, at(np.ones(3)))
    assert not solution.convergence.converged
    np.testing.assert_array_equal(solution.state.atPoint3(X), 1.0)


def test_the_start_is_not_changed(walking_scene, rig):
    graph, initial = moving_point(walking_scene, rig)
    before = gtsam.Values(initial)
    solve(graph, initial)
    assert initial.equals(before, 0.0)
