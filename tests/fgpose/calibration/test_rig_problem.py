"""The adjustment of a calibrated rig: what is held, and what the priors say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose.calibration.adjustment.cameras import adjusted_rig
from fgpose.calibration.adjustment.problem import Bundle
from fgpose.calibration.adjustment.sightings import Sightings
from fgpose.calibration.adjustment.unknowns import N_OF_CAMERA, OFFSET, POSE
from fgpose.calibration.rig_problem import rig_problem
from fgpose.config import Config
from fgpose_benchmarks.synthetic import Scene

CONFIG = Config()
SIGMAS = np.array([*3 * [np.deg2rad(0.1)], *3 * [0.005], *4 * [0.0], 0.1])
UNCHANGED = np.zeros((4, N_OF_CAMERA))


@pytest.fixture(scope="module")
def sightings(walking_scene: Scene) -> Sightings:
    """Three frames, one detection missing."""
    frames = slice(10, 13)
    weights = 0.3 * walking_scene.observations.confidence[frames]
    weights[1, 2, 5] = 0.0
    points2d_px = walking_scene.observations.points2d_px
    return Sightings(points2d_px[frames], weights, np.gradient(points2d_px, 1 / 30, axis=0)[frames], np.zeros(4))


@pytest.fixture(scope="module")
def joints_m(walking_scene: Scene) -> np.ndarray:
    return walking_scene.truth_m[10:13]


def test_what_is_held_stays(rig: fgpose.CameraRig, sightings: Sightings, joints_m: np.ndarray) -> None:
    start = Bundle.of(UNCHANGED, joints_m)
    found = rig_problem(rig, sightings, CONFIG, poses=True, clocks=False).solve(start).state.changes
    assert not found[:, POSE.stop :].any()
    assert found[:, POSE].all()
    found = rig_problem(rig, sightings, CONFIG, poses=False, clocks=True).solve(start).state.changes
    assert not found[:, :OFFSET].any()
    assert not found[0].any()
    assert found[1:, OFFSET].all()


def test_without_detections_all_is_as_the_priors_say(
    rig: fgpose.CameraRig, sightings: Sightings, joints_m: np.ndarray
) -> None:
    nothing = replace(sightings, weights=np.zeros_like(sightings.weights))
    problem = rig_problem(rig, nothing, CONFIG, poses=True, clocks=True)
    changes = SIGMAS * np.random.default_rng(0).uniform(-6.0, 6.0, UNCHANGED.shape)
    changes[0, OFFSET] = 0.0
    solution = problem.solve(Bundle.of(changes, joints_m))
    assert solution.convergence.converged
    np.testing.assert_allclose(solution.state.changes, 0.0, atol=2e-5)  # twice the step at which it ends
    expected = np.tile(SIGMAS, (4, 1))
    expected[0, OFFSET] = 0.0
    sigmas = np.sqrt(np.einsum("cici->ci", problem.covariance(Bundle.of(UNCHANGED, joints_m))))
    np.testing.assert_allclose(sigmas, expected, rtol=1e-12)


def test_a_changed_rig(rig: fgpose.CameraRig) -> None:
    """By hand: one camera steps 1 cm to its right, one turns to its right, one is late."""
    changes, angle = UNCHANGED.copy(), np.deg2rad(0.5)
    changes[0, 3], changes[1, 1], changes[2, OFFSET] = 0.01, angle, 0.15
    moved = adjusted_rig(rig, changes)
    right = rig.cameras[0].world_T_camera[:3, 0]
    np.testing.assert_allclose(moved.cameras[0].position_m - rig.cameras[0].position_m, 0.01 * right, atol=1e-12)
    old, new = rig.cameras[1].world_T_camera, moved.cameras[1].world_T_camera
    np.testing.assert_allclose(new[:3, 2], np.cos(angle) * old[:3, 2] + np.sin(angle) * old[:3, 0], atol=1e-12)
    np.testing.assert_allclose(moved.time_offsets_s, [0.0, 0.0, 0.15, 0.0])
    np.testing.assert_array_equal(moved.cameras[3].world_T_camera, rig.cameras[3].world_T_camera)
