"""The objective of the adjustment: derivatives, the elimination of the joints, GTSAM's native factors, covariance."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from fgpose.calibration.adjustment.cameras import adjusted_rig
from fgpose.calibration.adjustment.noise import Noise
from fgpose.calibration.adjustment.problem import Bundle, BundleProblem
from fgpose.calibration.adjustment.sightings import SeenFrom, Sightings
from fgpose.calibration.adjustment.unknowns import FOCAL, N_OF_CAMERA, Unknowns
from fgpose.io.skeletons import load_skeleton
from fgpose_benchmarks.synthetic import NO_NOISE, NO_OCCLUSION, DetectionNoise, ring_rig, simulate, walking

RIG = ring_rig(3)
SIGMA_PX = np.array([5.0, 5.0, 7.0])
NOISE = Noise(SIGMA_PX, "cauchy", 2.2, bias_m=0.02, focal=0.25, k1=0.1, centre=0.01, offset_s=0.05)
WITH_POSES = replace(NOISE, rotation_rad=0.01, translation_m=0.05)
FRAMES = [0, 40, 80, 120]
UNKNOWNS = Unknowns.of(3, (1, 2), focal=[(0, 2), (1,)], radial=[(0, 1, 2)], centres=[0, 2], clocks=True)
ALL_POSES = Unknowns.of(3, (0, 1, 2), clocks=True)
POSES = Unknowns.of(3, (1, 2))
UNCHANGED = np.zeros((3, N_OF_CAMERA))
# The last camera is rolled by 30 degrees.
AXES = np.array([np.eye(2), np.eye(2), [[np.sqrt(0.75), -0.5], [0.5, np.sqrt(0.75)]]])
SEEN_FROM = SeenFrom(np.eye(2)[np.array([[0, 1, 1], [1, 0, 0], [0, 0, 1], [1, 1, 1]])], AXES)


def sightings(noise: DetectionNoise) -> Sightings:
    """Two detections are missing; clocks are accounted for in part."""
    seen = simulate(walking(121, 30.0), load_skeleton("h36m_17"), RIG, 30.0, noise, NO_OCCLUSION, seed=0).observations
    weights = 0.3 * seen.confidence[FRAMES]
    weights[1, 2, 5] = weights[:, 0, 9] = 0.0
    points2d_px, velocity_pxps = seen.points2d_px[FRAMES], np.gradient(seen.points2d_px, 1 / 30, axis=0)[FRAMES]
    points2d_px[1, 2, 5] = np.nan
    return Sightings(points2d_px, weights, velocity_pxps, np.array([0.0, 0.01, -0.005]))


def true_state() -> Bundle:
    return Bundle.of(UNCHANGED, walking(121, 30.0)[FRAMES], 2)


def moved(problem: BundleProblem, state: Bundle, size: float) -> Bundle:
    scale = problem.damping_scale
    return problem.moved(state, size * np.random.default_rng(0).normal(size=scale.size) / np.sqrt(scale))


@pytest.mark.parametrize(("unknowns", "noise"), [(UNKNOWNS, NOISE), (ALL_POSES, WITH_POSES)])
def test_the_gradient_is_that_of_the_error(unknowns: Unknowns, noise: Noise) -> None:
    state = true_state()
    problem = BundleProblem(RIG, sightings(DetectionNoise()), unknowns, noise, SEEN_FROM)
    # Away from the truth; where a distance is held not far, for it is stiff: 1e5 to one.
    state = moved(problem, state, 1e-3 if noise is NOISE else 3e-2)
    rng = np.random.default_rng(1)
    gradient = problem.gradient(state)

    n_shared = unknowns.n_shared
    n_outer = n_shared + state.bias_m.size
    chosen = [*range(n_shared), *rng.integers(n_shared, len(gradient), 40), n_outer, len(gradient) - 1]
    for unknown in chosen:
        step = np.zeros_like(gradient)
        step[unknown] = 1e-6
        ahead, behind = (problem.error(problem.moved(state, sign * step)) for sign in (1, -1))
        # Central differences: the error is about 1e3 to 1e5, exact to 1e-16 of it, which divided by 2e-6 is 1e-5.
        assert gradient[unknown] == pytest.approx((ahead - behind) / 2e-6, rel=1e-4, abs=2e-2), unknown


@pytest.mark.parametrize(("unknowns", "noise"), [(UNKNOWNS, NOISE), (ALL_POSES, WITH_POSES)])
def test_the_elimination_solves_the_whole_system(unknowns: Unknowns, noise: Noise) -> None:
    """Where all residuals are zero Gauss-Newton's matrix is the derivative of the gradient."""
    own = replace(sightings(NO_NOISE), offsets_s=np.zeros(3))
    own = replace(own, velocity_pxps=own.velocity_pxps + 1.0)
    state = true_state()
    problem = BundleProblem(RIG, own, unknowns, noise, SEEN_FROM)
    scale = problem.damping_scale
    step = np.random.default_rng(0).normal(size=scale.size) / np.sqrt(scale)
    system = problem.factorized(state, 0.0)
    assert system is not None

    behind, ahead = (problem.gradient(problem.moved(state, size * step)) for size in (-1e-6, 1e-6))
    solved = system.solve((ahead - behind) / 2e-6)

    # Second differences of residuals are 1e-6 of the step; what is least determined is amplified by 1e3.
    np.testing.assert_allclose(solved[: unknowns.n_shared], step[: unknowns.n_shared], rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(solved[unknowns.n_shared :], step[unknowns.n_shared :], atol=2e-2)


def test_the_detections_cost_what_they_cost_in_gtsam() -> None:
    """Poses, points and one focal length, by native factors."""
    own = replace(sightings(DetectionNoise()), offsets_s=np.zeros(3))
    noise = replace(NOISE, kernel="none", offset_s=np.inf)
    state = Bundle.of(UNCHANGED, walking(121, 30.0)[FRAMES])
    changes = moved(BundleProblem(RIG, own, POSES, noise), state, 1e-2).changes
    changes[:, FOCAL] = 0.1
    state = replace(state, changes=changes)
    problem = BundleProblem(RIG, own, ALL_POSES, noise)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    values.insert(0, gtsam.Cal3f(1145 * np.exp(0.1), 500.0, 500.0))
    for c, camera in enumerate(adjusted_rig(RIG, changes).cameras):
        values.insert(gtsam.symbol("x", c), gtsam.Pose3(camera.world_T_camera))
    for t, c, j in np.argwhere(own.weights > 0).tolist():
        point = gtsam.symbol("p", 17 * t + j)
        if not values.exists(point):
            values.insert(point, state.joints_m[t, j])
        model = gtsam.noiseModel.Isotropic.Sigma(2, SIGMA_PX[c] / np.sqrt(own.weights[t, c, j]))
        measured = own.undistorted_px[t, c, j]
        graph.add(gtsam.GeneralSFMFactor2Cal3f(measured, model, gtsam.symbol("x", c), point, 0))

    assert problem.error(state) == pytest.approx(graph.error(values), rel=1e-9)


def test_a_joint_behind_a_camera_costs_a_constant() -> None:
    own = sightings(NO_NOISE)
    only_first = own.weights.copy()
    only_first[:, 1:, 3] = 0.0
    state = true_state()
    problem = BundleProblem(RIG, replace(own, weights=only_first), UNKNOWNS, NOISE, SEEN_FROM)
    behind = state.joints_m.copy()
    camera = RIG.cameras[0]
    behind[0, 3] = camera.position_m - 0.5 * camera.world_T_camera[:3, 2]
    farther = behind.copy()
    farther[0, 3] -= 0.1 * camera.world_T_camera[:3, 2]

    assert np.isnan(problem.residual_px(replace(state, joints_m=behind))[0, 0, 3])
    errors = [problem.error(replace(state, joints_m=joints_m)) for joints_m in (behind, farther)]
    assert errors[0] == pytest.approx(errors[1], rel=1e-9)
    assert errors[0] > problem.error(state) + 1.0
    beside = replace(state, joints_m=behind)
    assert np.isfinite(problem.equations(beside).solve(problem.gradient(beside))).all()


def test_the_covariance_is_of_small_changes_of_the_cameras_as_they_are_now() -> None:
    """Wherever they were given: in their own frames, they are equally well known."""
    own, unknowns = sightings(NO_NOISE), Unknowns.of(3, (2,), clocks=True)
    noise, joints_m = replace(NOISE, kernel="none"), walking(121, 30.0)[FRAMES]
    turned, back = UNCHANGED.copy(), UNCHANGED.copy()
    turned[2, :3] = 0.3, -0.2, 0.1
    back[2, :3] = -turned[2, :3]
    elsewhere = BundleProblem(adjusted_rig(RIG, turned), own, unknowns, noise)
    here, there = (
        BundleProblem(RIG, own, unknowns, noise).covariance(Bundle.of(UNCHANGED, joints_m)),
        elsewhere.covariance(Bundle.of(back, joints_m)),
    )
    np.testing.assert_allclose(there, here, rtol=1e-6, atol=1e-9 * np.abs(here).max())
    assert not here[:2, :6].any()
