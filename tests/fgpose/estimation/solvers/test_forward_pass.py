"""Frames that are eliminated take nothing with them: optimum and covariances are those of all frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import Float

import fgpose
from fgpose.config import Config, config_from_dict
from fgpose.estimation.evidence.gather import gather
from fgpose.estimation.initial_guess import median_lengths
from fgpose.estimation.segment import LinkageBlocks, Predecessor, Segment
from fgpose.estimation.solvers.forward_pass import ForwardPass, pose_of, unknowns_of
from fgpose.estimation.solvers.levenberg_marquardt import levenberg_marquardt
from fgpose.estimation.solvers.normal_equations import NormalEquations
from fgpose.skeleton import BoneLengths, Skeleton
from fgpose_benchmarks.synthetic import Scene

N_FRAMES = 6


def segment_of(scene: Scene, rig: fgpose.CameraRig, config: Config, skeleton: Skeleton) -> Segment:
    """One joint enters with the second frame, one leaves after the first, one is never there; no camera sees another
    in the first two frames, so that its velocity fades."""
    evidence = gather(scene.observations.frames(slice(0, N_FRAMES)), rig, config)
    undistorted_px = evidence.undistorted_px.copy()
    undistorted_px[:2, :, skeleton.index("left_wrist")] = np.nan
    active = np.ones((N_FRAMES, skeleton.n_joints), dtype=bool)
    active[0, skeleton.index("head")] = False
    active[1:, skeleton.index("left_ankle")] = False
    active[:, skeleton.index("spine")] = False
    lengths_m = median_lengths(skeleton, evidence.guess_m)
    density = np.random.default_rng(0).uniform(0.3, 30.0, size=active.shape)
    seen = replace(evidence, undistorted_px=undistorted_px)
    known = BoneLengths(lengths_m, np.full_like(lengths_m, 0.01))
    return Segment(rig, skeleton, config, seen, active, lengths_m, density, known, lengths_known=True)


def without_shoulders(whole: Skeleton) -> Skeleton:
    """Arms that no bone joins to the body, nor to each other."""
    bones = [bone for bone in whole.bones if not {"left_shoulder", "right_shoulder"} & {whole.joints[bone[1]]}]
    return Skeleton("apart", whole.joints, bones, whole.root, whole.left_right)


def solved(
    segment: Segment,
) -> tuple[Float[np.ndarray, "frame kind joint 3"], list[LinkageBlocks], ForwardPass]:
    """Poses at the optimum, the covariance of each frame, and their elimination."""
    problem = NormalEquations(segment)
    state = levenberg_marquardt(problem, problem.initial(), 100).state
    matrix = problem.matrix(state)
    return problem.poses(state), [*problem.covariances(matrix)][::-1], ForwardPass(problem, state, matrix)


@pytest.mark.parametrize("n_linkages", [1, 2])
@pytest.mark.parametrize("n_eliminated", [1, 3])
@pytest.mark.parametrize("model", ["constant_velocity", "random_walk", "none"])
def test_the_others_are_where_they_were(
    model: str, n_eliminated: int, n_linkages: int, walking_scene: Scene, rig: fgpose.CameraRig
) -> None:
    config = config_from_dict({"motion": {"model": model}, "solver": {"step_tolerance_m": 1e-9}})
    whole = walking_scene.observations.skeleton
    skeleton = whole if n_linkages == 1 else without_shoulders(whole)
    assert len(skeleton.linkages) == n_linkages
    segment = segment_of(walking_scene, rig, config, skeleton)
    poses, covariances, forward = solved(segment)
    marginal, conditionals = None, []
    for _ in range(n_eliminated):
        marginal, conditional = forward.eliminate()
        conditionals.append(conditional)
    last = n_eliminated - 1
    before = Predecessor(float(segment.evidence.time_s[last]), segment.active[last])
    rest = replace(segment.frames(slice(n_eliminated, None)), before=before, marginal=marginal)
    rest_poses, found, _ = solved(rest)
    # What the tolerance of 1 nm leaves; velocities are 50 positions a second.
    np.testing.assert_allclose(rest_poses, poses[n_eliminated:], atol=1e-6)
    pose = unknowns_of(rest_poses[0], skeleton.linkages)
    for at in reversed(range(n_eliminated)):
        pose = conditionals[at].given(pose)
        np.testing.assert_allclose(pose_of(pose, len(poses[at]), skeleton.linkages), poses[at], atol=1e-6)
        found.insert(0, conditionals[at].marginal(found[0]))
    for active, of_rest, of_all in zip(segment.active, found, covariances, strict=True):
        for joints, rest_block, block in zip(skeleton.linkages, of_rest.blocks, of_all.blocks, strict=True):
            estimated = np.ix_(*2 * [np.repeat(active[list(joints)], len(block) // len(joints))])
            # Both lose six digits to the condition of the information, from 1 m to 1 mm.
            np.testing.assert_allclose(rest_block[estimated], block[estimated], rtol=1e-5, atol=1e-9)
