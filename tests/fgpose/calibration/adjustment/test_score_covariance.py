"""What the errors of detections do to what an adjustment estimates."""

from __future__ import annotations

import numpy as np
import pytest

import fgpose
from fgpose.calibration.adjustment import scores
from fgpose.calibration.adjustment.problem import Bundle
from fgpose.calibration.adjustment.scores import Stretch, covariance_by_errors
from fgpose.calibration.adjustment.sightings import Sightings
from fgpose.calibration.adjustment.unknowns import N_OF_CAMERA, OFFSET
from fgpose.calibration.rig_problem import rig_problem
from fgpose.config import Config
from fgpose.estimation.covariances.variance_components import TIMES_S, ErrorComponents, correlation_after
from fgpose_benchmarks.synthetic import Scene

STEP_S = 0.04


def test_errors_that_last_and_are_shared_add_up() -> None:
    """Against the covariance of all errors of a camera, written out."""
    rng, (n_frames, n_joints) = np.random.default_rng(0), (7, 3)
    root = rng.standard_normal((n_joints, n_joints))
    correlation = root @ root.T
    correlation /= np.sqrt(np.outer(np.diag(correlation), np.diag(correlation)))
    variances = rng.uniform(0.1, 1.0, (n_joints, len(TIMES_S)))
    components = ErrorComponents(variances, correlation, rng.uniform(0.5, 1.5, (n_joints, 2)))
    pull = rng.standard_normal((n_frames, n_joints, 2, 4))
    after_s = STEP_S * np.abs(np.subtract.outer(np.arange(n_frames), np.arange(n_frames)))
    expected = np.zeros((4, 4))
    for time_s, of_joints in zip(TIMES_S, variances.T, strict=True):
        in_time = correlation_after(time_s, after_s.ravel()).reshape(after_s.shape)
        for axis in (0, 1):
            sigma = np.sqrt(of_joints * components.axes[:, axis])
            among = np.outer(sigma, sigma) * correlation
            expected += np.einsum("tju,ts,jk,skv->uv", pull[:, :, axis], in_time, among, pull[:, :, axis])
    np.testing.assert_allclose(scores._of_errors(pull, components, STEP_S), expected, rtol=1e-9)


@pytest.mark.parametrize("of_clocks", [1.0, 7.0])
def test_without_detections_the_priors_are_what_is_known(
    walking_scene: Scene, rig: fgpose.CameraRig, of_clocks: float
) -> None:
    """However little they weigh beside detections."""
    points2d_px, config = walking_scene.observations.points2d_px[:12], Config()
    nothing = np.zeros(points2d_px.shape[:-1])
    sightings = Sightings(points2d_px, nothing, np.zeros_like(points2d_px), np.zeros(4))
    problem = rig_problem(rig, sightings, config, poses=True, clocks=True, of_clocks=of_clocks)
    state = Bundle.of(np.zeros((4, N_OF_CAMERA)), walking_scene.truth_m[:12])
    joints = walking_scene.observations.skeleton.joints
    covariance = covariance_by_errors(problem, state, nothing, [Stretch(5, STEP_S), Stretch(7, STEP_S)], joints)
    prior = config.calibration
    expected = np.array([*3 * [np.deg2rad(prior.rotation_sigma_deg)], *3 * [prior.translation_sigma_m]])
    sigmas = np.sqrt(np.einsum("cici->ci", covariance))
    np.testing.assert_allclose(sigmas[:, :6], np.tile(expected, (4, 1)), rtol=1e-9)
    np.testing.assert_allclose(sigmas[:, OFFSET], [0.0, *3 * [prior.offset_sigma_s]], rtol=1e-9)
