"""A frame that is eliminated takes nothing with it: optimum and covariances are those of all frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import Float

import fgpose
from fgpose.config import Config, config_from_dict
from fgpose.estimation.evidence.gather import gather
from fgpose.estimation.initial_guess import median_lengths
from fgpose.estimation.segment import Predecessor, Segment
from fgpose.estimation.solvers.first_frame import eliminate_first
from fgpose.estimation.solvers.levenberg_marquardt import levenberg_marquardt
from fgpose.estimation.solvers.normal_equations import NormalEquations
from fgpose_benchmarks.synthetic import Scene

N_FRAMES = 6


def segment_of(scene: Scene, rig: fgpose.CameraRig, config: Config) -> Segment:
    """One joint enters with the second frame, one leaves after the first, one is never there; no camera sees another
    in the first two frames, so that its velocity fades."""
    skeleton, evidence = scene.observations.skeleton, gather(scene.observations.frames(slice(0, N_FRAMES)), rig, config)
    undistorted_px = evidence.undistorted_px.copy()
    undistorted_px[:2, :, skeleton.index("left_wrist")] = np.nan
    active = np.ones((N_FRAMES, skeleton.n_joints), dtype=bool)
    active[0, skeleton.index("head")] = False
    active[1:, skeleton.index("left_ankle")] = False
    active[:, skeleton.index("spine")] = False
    lengths_m = median_lengths(skeleton, evidence.guess_m)
    density = np.random.default_rng(0).uniform(0.3, 30.0, size=active.shape)
    seen = replace(evidence, undistorted_px=undistorted_px)
    return Segment(rig, skeleton, config, seen, active, lengths_m, 0.01, density, lengths_known=True)


def solved(segment: Segment) -> tuple[Float[np.ndarray, "frame kind joint 3"], list[np.ndarray]]:
    """Poses at the optimum, and the covariance of each frame."""
    problem = NormalEquations(segment)
    state = levenberg_marquardt(problem, problem.initial(), 100).state
    return problem.poses(state), list(problem.covariances(state))[::-1]


@pytest.mark.parametrize("model", ["constant_velocity", "random_walk", "none"])
def test_the_others_are_where_they_were(model: str, walking_scene: Scene, rig: fgpose.CameraRig) -> None:
    config = config_from_dict({"motion": {"model": model}, "solver": {"step_tolerance_m": 1e-9}})
    segment = segment_of(walking_scene, rig, config)
    poses, covariances = solved(segment)
    marginal, conditional = eliminate_first(segment.frames(slice(0, 2)), poses[:2])
    before = Predecessor(float(segment.evidence.time_s[0]), segment.active[0])
    rest = replace(segment.frames(slice(1, None)), before=before, marginal=marginal)
    rest_poses, rest_covariances = solved(rest)
    # What the tolerance of 1 nm leaves; velocities are 50 positions a second.
    np.testing.assert_allclose(rest_poses, poses[1:], atol=1e-6)
    np.testing.assert_allclose(conditional.given(rest_poses[0]), poses[0], atol=1e-6)
    found = [conditional.marginal(rest_covariances[0]), *rest_covariances]
    for active, of_rest, of_all in zip(segment.active, found, covariances, strict=True):
        estimated = np.ix_(*2 * [np.repeat(active, len(of_all) // len(active))])
        # Both lose six digits to the condition of the information, from 1 m to 1 mm.
        np.testing.assert_allclose(of_rest[estimated], of_all[estimated], rtol=1e-5, atol=1e-9)


def test_nobody_is_there_yet(walking_scene: Scene, rig: fgpose.CameraRig) -> None:
    segment = segment_of(walking_scene, rig, Config())
    two = replace(segment.frames(slice(0, 2)), active=np.zeros((2, segment.skeleton.n_joints), dtype=bool))
    marginal, conditional = eliminate_first(two, np.zeros((2, 2, segment.skeleton.n_joints, 3)))
    assert not marginal.information.any()
    assert not conditional.given(np.ones((2, segment.skeleton.n_joints, 3))).any()
