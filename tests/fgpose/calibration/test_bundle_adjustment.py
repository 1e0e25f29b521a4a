"""The objective of calibration: derivatives by central differences, priors, and what it knows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose.calibration.bundle_adjustment import BundleProblem, Calibration, moved_rig, prior_sigmas
from fgpose.calibration.sightings import Sightings
from fgpose.config import Config
from fgpose_benchmarks.synthetic import Scene

CONFIG = Config()


@pytest.fixture(scope="module")
def sightings(walking_scene: Scene) -> Sightings:
    """Three frames, one detection missing, a clock that is accounted for in part."""
    frames = slice(10, 13)
    weights = 0.3 * walking_scene.observations.confidence[frames]
    weights[1, 2, 5] = 0.0
    velocities_mps = np.gradient(walking_scene.truth_m, 1 / 30, axis=0)[frames]
    points2d_px = walking_scene.observations.points2d_px[frames].copy()
    points2d_px[1, 2, 5] = np.nan
    return Sightings(points2d_px, weights, velocities_mps, np.array([0.0, 0.1, 0.0, -0.05]))


@pytest.fixture(scope="module")
def state(walking_scene: Scene) -> Calibration:
    """Cameras turned by up to 0.6 degrees, moved by up to 3 cm and off by up to 0.2 s."""
    changes = np.random.default_rng(0).uniform(-6.0, 6.0, (4, 7))
    changes[:, 6] /= 3
    changes[0, 6] = 0.0
    return Calibration(changes, walking_scene.truth_m[10:13])


def both(rig: fgpose.CameraRig, sightings: Sightings) -> BundleProblem:
    return BundleProblem(rig, sightings, CONFIG, poses=True, clocks=True)


def test_gradient_against_central_differences(rig: fgpose.CameraRig, sightings: Sightings, state: Calibration) -> None:
    problem = both(rig, sightings)
    residual_px, by_joint, by_camera, weights = problem.projection_terms(state)
    by_changes = (
        np.einsum("tcj,tcji,tcjik->ck", weights, residual_px, by_camera).ravel() + problem.prior_terms(state)[1]
    )
    by_joints = np.einsum("tcj,tcji,tcjia->tja", weights, residual_px, by_joint)

    def slope(changes: np.ndarray, joints_m: np.ndarray) -> float:
        after = Calibration(state.changes + changes, state.joints_m + joints_m)
        before = Calibration(state.changes - changes, state.joints_m - joints_m)
        return (problem.error(after) - problem.error(before)) / 2e-5

    nothing = np.zeros_like(state.changes), np.zeros_like(state.joints_m)
    expected = [slope(1e-5 * unit.reshape(4, 7), nothing[1]) for unit in np.eye(28)]
    # Central differences of an error of 1e4: 1e-16 / 1e-5 of it.
    np.testing.assert_allclose(by_changes, expected, atol=1e-5 * np.abs(expected).max())
    for frame, joint, axis in ((0, 0, 0), (1, 5, 2), (2, 16, 1)):
        unit_m = np.zeros_like(state.joints_m)
        unit_m[frame, joint, axis] = 1e-5
        assert by_joints[frame, joint, axis] == pytest.approx(slope(nothing[0], unit_m), rel=1e-5)


def test_the_step_solves_the_whole_system(rig: fgpose.CameraRig, sightings: Sightings, state: Calibration) -> None:
    """Elimination of the joints and back-substitution, against the normal equations of everything at once."""
    problem = both(rig, sightings)
    step = -problem.factorized(state, 0.0).solve(problem.gradient(state))
    residual_px, by_joint, by_camera, weights = problem.projection_terms(state)
    T, C, J, _ = residual_px.shape
    jacobian = np.zeros((T, C, J, 2, 7 * C + 3 * T * J))
    for t, c, j in np.ndindex(T, C, J):
        jacobian[t, c, j, :, 7 * c : 7 * c + 7] = by_camera[t, c, j]
        joint = 7 * C + 3 * (t * J + j)
        jacobian[t, c, j, :, joint : joint + 3] = by_joint[t, c, j]
    free = np.concatenate([problem.free, np.ones(3 * T * J, dtype=bool)])
    rows = (np.sqrt(weights)[..., None, None] * jacobian).reshape(-1, jacobian.shape[-1])
    information, gradient = rows.T @ rows, rows.T @ (np.sqrt(weights)[..., None] * residual_px).ravel()
    of_priors, by_priors = problem.prior_terms(state)
    information[range(7 * C), range(7 * C)] += of_priors
    gradient[: 7 * C] += by_priors
    expected = np.zeros(len(free))
    expected[free] = -np.linalg.solve(information[np.ix_(free, free)], gradient[free])
    # The whole system has the condition 1e9, and the squares of pixels by metres in it.
    np.testing.assert_allclose(step[: 7 * C], expected[: 7 * C], atol=1e-5)
    np.testing.assert_allclose(step[7 * C :], expected[7 * C :], atol=1e-6)


def test_what_is_held_stays(rig: fgpose.CameraRig, sightings: Sightings, state: Calibration) -> None:
    start = replace(state, changes=np.zeros((4, 7)))
    poses = BundleProblem(rig, sightings, CONFIG, poses=True, clocks=False)
    clocks = BundleProblem(rig, sightings, CONFIG, poses=False, clocks=True)
    found = poses.solve(start).state.changes
    assert not found[:, 6].any()
    assert found[:, :6].all()
    found = clocks.solve(start).state.changes
    assert not found[:, :6].any()
    assert not found[0].any()
    assert found[1:, 6].all()


def test_without_detections_all_is_as_the_priors_say(
    rig: fgpose.CameraRig, sightings: Sightings, state: Calibration
) -> None:
    nothing = replace(sightings, weights=np.zeros_like(sightings.weights))
    problem = both(rig, nothing)
    solution = problem.solve(state)
    assert solution.convergence.converged
    np.testing.assert_allclose(solution.state.changes, 0.0, atol=2e-3)  # twice the step at which it ends
    expected = np.ones((4, 7))
    expected[0, 6] = 0.0
    np.testing.assert_allclose(problem.sigmas(replace(state, changes=np.zeros((4, 7)))), expected)


def test_a_changed_rig(rig: fgpose.CameraRig) -> None:
    """By hand: one camera steps 2 sigmas to its right, one turns to its right, one is late."""
    changes = np.zeros((4, 7))
    changes[0, 3], changes[1, 1], changes[2, 6] = 2.0, 5.0, 1.5
    moved = moved_rig(rig, changes, CONFIG)
    right = rig.cameras[0].world_T_camera[:3, 0]
    np.testing.assert_allclose(moved.cameras[0].position_m - rig.cameras[0].position_m, 2 * 0.005 * right, atol=1e-12)
    old, new = rig.cameras[1].world_T_camera, moved.cameras[1].world_T_camera
    angle = np.deg2rad(5 * 0.1)
    np.testing.assert_allclose(new[:3, 2], np.cos(angle) * old[:3, 2] + np.sin(angle) * old[:3, 0], atol=1e-12)
    np.testing.assert_allclose(moved.time_offsets_s, [0.0, 0.0, 0.15, 0.0])
    np.testing.assert_array_equal(moved.cameras[3].world_T_camera, rig.cameras[3].world_T_camera)
    np.testing.assert_allclose(prior_sigmas(CONFIG), [*3 * [np.deg2rad(0.1)], *3 * [0.005], 0.1])


def test_a_joint_behind_the_camera_that_sees_it_costs_more_than_any_in_front(
    rig: fgpose.CameraRig, sightings: Sightings, state: Calibration
) -> None:
    problem, away = both(rig, sightings), state.joints_m.copy()
    away[0, 0] = rig.cameras[0].to_world_frame(np.array([0.0, 0.0, -1.0]))
    behind = replace(state, joints_m=away)
    assert np.isfinite(problem.error(behind))
    assert problem.error(behind) > problem.error(state)
    assert np.isfinite(problem.factorized(behind, 0.0).solve(problem.gradient(behind))).all()
