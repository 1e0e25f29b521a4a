"""The objective of the adjustment: derivatives, the elimination of the joints, and GTSAM's native factors."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from walks import bare, walk

from fgpose.calibration.from_people.evidence import Evidence, evidence_of
from fgpose.calibration.from_people.scene import SceneState
from fgpose.calibration.from_people.scene_problem import SceneNoise, SceneProblem
from fgpose.calibration.from_people.sectors import SeenFrom
from fgpose.calibration.from_people.unknowns import Unknowns
from fgpose_benchmarks.synthetic import NO_NOISE, DetectionNoise, ring_rig, walking

RIG = ring_rig(3)
NOISE = SceneNoise(5.0, "cauchy", 2.2, bias_m=0.02, bone_m=0.02, focal=0.25, k1=0.1, centre=0.01, offset_s=0.05)
FRAMES = [0, 40, 80, 120]
UNKNOWNS = Unknowns.of(3, 6, focal=[(0, 2), (1,)], radial=[(0, 1, 2)], centres=[0, 2], clocks=True)
# The last camera is rolled by 30 degrees.
AXES = np.array([np.eye(2), np.eye(2), [[np.sqrt(0.75), -0.5], [0.5, np.sqrt(0.75)]]])
SEEN_FROM = SeenFrom(np.array([[0, 1, 1], [1, 0, 0], [0, 0, 1], [1, 1, 1]]), AXES)


def evidence(noise: DetectionNoise) -> Evidence:
    own = evidence_of(walk(RIG, 121, noise), RIG, 4)
    np.testing.assert_array_equal(own.frames, FRAMES)
    weights = own.weights.copy()
    weights[1, 2, 5] = weights[:, 0, 9] = 0.0
    return replace(own, weights=weights)


def true_state(own: Evidence, *, in_common: bool = False) -> SceneState:
    return SceneState.of(RIG, walking(121, 30.0)[FRAMES][:, own.joints], own, 2, in_common=in_common)


def moved(problem: SceneProblem, state: SceneState, size: float) -> SceneState:
    scale = problem.damping_scale
    return problem.moved(state, size * np.random.default_rng(0).normal(size=scale.size) / np.sqrt(scale))


@pytest.mark.parametrize("in_common", [True, False])
def test_the_gradient_is_that_of_the_error(in_common: bool) -> None:
    own = evidence(DetectionNoise())
    assert own.n_lengths == 6
    state = true_state(own, in_common=in_common)
    problem = SceneProblem(RIG, own, SEEN_FROM, UNKNOWNS, NOISE, state)
    # Away from the truth; not far, for the distance that is held is stiff: 1e5 to one.
    state = moved(problem, state, 1e-3)
    rng = np.random.default_rng(1)
    gradient = problem.gradient(state)

    n_outer = UNKNOWNS.n_shared + state.bias_m.size
    chosen = [
        *range(UNKNOWNS.n_shared),
        *rng.integers(UNKNOWNS.n_shared, len(gradient), 40),
        n_outer,
        len(gradient) - 1,
    ]
    for unknown in chosen:
        step = np.zeros_like(gradient)
        step[unknown] = 1e-6
        ahead, behind = (problem.error(problem.moved(state, sign * step)) for sign in (1, -1))
        # Central differences: the error is about 1e3 to 1e5, exact to 1e-16 of it, which divided by 2e-6 is 1e-5.
        assert gradient[unknown] == pytest.approx((ahead - behind) / 2e-6, rel=1e-4, abs=2e-2), unknown


@pytest.mark.parametrize("in_common", [True, False])
def test_the_elimination_solves_the_whole_system(in_common: bool) -> None:
    """Where all residuals are zero Gauss-Newton's matrix is the derivative of the gradient."""
    own = evidence(NO_NOISE)
    own = replace(own, velocity_pxps=own.velocity_pxps + 1.0)
    state = true_state(own, in_common=in_common)
    problem = SceneProblem(RIG, own, SEEN_FROM, UNKNOWNS, NOISE, state)
    scale = problem.damping_scale
    step = np.random.default_rng(0).normal(size=scale.size) / np.sqrt(scale)
    known = (own.weights > 0).sum(axis=1) >= 2
    step[UNKNOWNS.n_shared + state.bias_m.size :] *= np.repeat(known.ravel(), 3)
    system = problem.factorized(state, 0.0)
    assert system is not None

    behind, ahead = (problem.gradient(problem.moved(state, size * step)) for size in (-1e-6, 1e-6))
    solved = system.solve((ahead - behind) / 2e-6)

    # Second differences of residuals are 1e-6 of the step; what is least determined is amplified by 1e3.
    np.testing.assert_allclose(solved[: UNKNOWNS.n_shared], step[: UNKNOWNS.n_shared], rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(solved[UNKNOWNS.n_shared :], step[UNKNOWNS.n_shared :], atol=2e-2)


def test_the_detections_cost_what_they_cost_in_gtsam() -> None:
    """Poses, points and one focal length, by native factors."""
    own = evidence(DetectionNoise())
    noise = replace(NOISE, bone_m=1e9, bias_m=1e-6, kernel="none", offset_s=1e9)
    state = true_state(own)
    turned = moved(SceneProblem(RIG, own, SEEN_FROM, Unknowns.of(3, 6), noise, state), state, 1e-2)
    state = replace(turned, bias_m=np.zeros_like(state.bias_m), log_focal=np.full(3, 0.1))
    problem = SceneProblem(RIG, own, SEEN_FROM, Unknowns.of(3, 6), noise, state)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    values.insert(0, gtsam.Cal3f(1145 * np.exp(0.1), 500.0, 500.0))
    for c, pose in enumerate(state.world_T_camera):
        values.insert(gtsam.symbol("x", c), gtsam.Pose3(pose))
    for t, c, j in np.argwhere(own.weights > 0).tolist():
        point = gtsam.symbol("p", 14 * t + j)
        if not values.exists(point):
            values.insert(point, state.joints_m[t, j])
        model = gtsam.noiseModel.Isotropic.Sigma(2, 5.0 / np.sqrt(own.weights[t, c, j]))
        measured = own.undistorted_px[t, c, j]
        graph.add(gtsam.GeneralSFMFactor2Cal3f(measured, model, gtsam.symbol("x", c), point, 0))

    assert problem.error(state) == pytest.approx(graph.error(values), rel=1e-6)  # the held distance adds 1e-12


def test_a_joint_behind_a_camera_costs_a_constant() -> None:
    own = evidence(NO_NOISE)
    state = true_state(own)
    problem = SceneProblem(RIG, own, SEEN_FROM, UNKNOWNS, replace(NOISE, bone_m=1e9), state)
    behind = state.joints_m.copy()
    camera = RIG.cameras[0]
    behind[0, 3] = camera.position_m - 0.5 * camera.world_T_camera[:3, 2]
    farther = behind.copy()
    farther[0, 3] -= 0.1 * camera.world_T_camera[:3, 2]
    only_first = own.weights.copy()
    only_first[:, 1:, 3] = 0.0
    problem = SceneProblem(
        RIG, replace(own, weights=only_first), SEEN_FROM, UNKNOWNS, replace(NOISE, bone_m=1e9), state
    )

    assert np.isnan(problem.residual_px(replace(state, joints_m=behind))[0, 0, 3])
    errors = [problem.error(replace(state, joints_m=joints_m)) for joints_m in (behind, farther)]
    assert errors[0] == pytest.approx(errors[1], rel=1e-9)
    assert errors[0] > 1.0


def test_intrinsics_that_are_bare_make_no_difference() -> None:
    """Poses are of the state alone."""
    own = evidence(DetectionNoise())
    state = true_state(own)
    errors = [SceneProblem(rig, own, SEEN_FROM, UNKNOWNS, NOISE, state).error(state) for rig in (RIG, bare(RIG))]

    assert errors[0] == errors[1]
