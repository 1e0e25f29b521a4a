from __future__ import annotations

import gtsam
import numpy as np
import pytest

from fgpose import graph
from fgpose.camera import CameraRig
from fgpose.config import MotionConfig, PriorConfig, ProjectionConfig
from fgpose.covariance import marginal_covariances
from fgpose.graph import FrameTime
from fgpose.keys import length_key, position_key, velocity_key
from fgpose.skeleton import Skeleton
from fgpose.synthetic import Scene
from fgpose_factors import noise_model, shared_bone_length_factor

MODELS = ["constant_velocity", "random_walk", "none"]


def comes_and_goes(n_frames: int, skeleton: Skeleton) -> np.ndarray:
    """One joint enters late, one leaves early, one is away for two frames, one is never there; frame 4 has few."""
    active = np.ones((n_frames, skeleton.n_joints), dtype=bool)
    active[:2, skeleton.index("head")] = False
    active[5:, skeleton.index("left_ankle")] = False
    active[2:4, skeleton.index("right_wrist")] = False
    active[:, skeleton.index("spine")] = False
    active[4, 6:14] = False
    return active


def small_recording(
    scene: Scene, rig: CameraRig, active: np.ndarray, motion: MotionConfig, with_lengths: bool
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """The factors of a recording, strung together frame by frame, with the shared lengths as callback factors."""
    observations, skeleton = scene.observations, scene.observations.skeleton
    problem, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    with_velocity = motion.model == "constant_velocity"
    before, was_active = FrameTime(-1, 0.0), np.zeros(skeleton.n_joints, dtype=bool)
    for frame, now in enumerate(active):
        at = FrameTime(frame, float(observations.frame_time_s[frame]))
        points_px, weights = observations.points2d_px[frame], observations.confidence[frame]
        factors = list(graph.projection_factors(rig, frame, points_px, weights, now, ProjectionConfig()))
        kept = now & was_active & (motion.model != "none")
        factors += graph.motion_factors(before, at, np.flatnonzero(kept).tolist(), motion)
        entering = np.flatnonzero(now & ~kept).tolist()
        truth_m = scene.truth_m[frame]
        factors += graph.prior_factors(frame, entering, truth_m, PriorConfig(), with_velocity=with_velocity)
        if with_lengths:
            for (start, end), length in zip(skeleton.bones, skeleton.length_of_bone, strict=True):
                if now[start] and now[end]:
                    keys = position_key(start, frame), position_key(end, frame)
                    factors.append(shared_bone_length_factor(keys, length_key(length), noise_model(1, 0.01)))
        for factor in factors:
            problem.add(factor)
        for joint in np.flatnonzero(now).tolist():
            values.insert(position_key(joint, frame), truth_m[joint])
            if with_velocity:
                values.insert(velocity_key(joint, frame), np.zeros(3))
        before, was_active = at, now
    if with_lengths:
        of_bones_m = skeleton.bone_lengths(scene.truth_m[0])
        joined = active[:, [a for a, _ in skeleton.bones]] & active[:, [b for _, b in skeleton.bones]]
        for length in {skeleton.length_of_bone[bone] for bone in np.flatnonzero(joined.any(axis=0))}:
            length_m = float(of_bones_m[skeleton.length_of_bone.index(length)])
            values.insert(length_key(length), length_m)
            problem.add(gtsam.PriorFactorDouble(length_key(length), length_m, noise_model(1, 0.3)))
    return problem, values


def check(scene: Scene, rig: CameraRig, active: np.ndarray, model: str, with_lengths: bool) -> None:
    motion = MotionConfig(model=model)  # pyright: ignore[reportArgumentType]
    problem, values = small_recording(scene, rig, active, motion, with_lengths)
    covariance_m2 = marginal_covariances(problem.linearize(values), active, with_velocity=model == "constant_velocity")
    marginals = gtsam.Marginals(problem, values)
    for frame, joint in np.ndindex(active.shape):
        if active[frame, joint]:
            expected_m2 = marginals.marginalCovariance(position_key(joint, frame))
            scale_m2 = np.abs(expected_m2).max()
            # relative to the largest entry: both lose about six digits to the condition of the information matrix
            np.testing.assert_allclose(covariance_m2[frame, joint], expected_m2, rtol=0, atol=1e-9 * scale_m2)
        else:
            assert np.isnan(covariance_m2[frame, joint]).all()


@pytest.mark.parametrize("with_lengths", [True, False])
@pytest.mark.parametrize("model", MODELS)
def test_equals_gtsams_marginals_where_joints_come_and_go(walking_scene, rig, skeleton, model, with_lengths):
    check(walking_scene, rig, comes_and_goes(8, skeleton), model, with_lengths)


@pytest.mark.parametrize("model", MODELS)
def test_equals_gtsams_marginals_with_a_frame_that_has_nobody(walking_scene, rig, skeleton, model):
    active = comes_and_goes(6, skeleton)
    active[2] = False
    check(walking_scene, rig, active, model, with_lengths=True)


@pytest.mark.parametrize("model", MODELS)
def test_equals_gtsams_marginals_of_one_frame(walking_scene, rig, skeleton, model):
    check(walking_scene, rig, np.ones((1, skeleton.n_joints), dtype=bool), model, with_lengths=True)


def test_two_exact_views_at_right_angles_have_the_covariance_of_the_textbook(rig, skeleton):
    """A point at the centre of the ring: each view measures two directions, to depth x sigma / focal length."""
    active = np.zeros((1, skeleton.n_joints), dtype=bool)
    active[0, 0] = True
    centre_m = np.zeros((skeleton.n_joints, 3))
    centre_m[0, 2] = 1.0
    pair = rig.subset(rig.names[:2])
    config = ProjectionConfig(sigma_px=3.0, kernel="none")
    problem, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for factor in graph.projection_factors(pair, 0, pair.project(centre_m), np.ones((2, 17)), active[0], config):
        problem.add(factor)
    values.insert(position_key(0, 0), centre_m[0])
    covariance_m2 = marginal_covariances(problem.linearize(values), active, with_velocity=False)[0, 0]
    information = np.zeros((3, 3))
    for camera in pair.cameras:
        R, depth_m = camera.camera_T_world[:3, :3], camera.to_camera_frame(centre_m[0])[2]
        sideways = R[:2]
        information += sideways.T @ sideways * (camera.K[0, 0] / depth_m / 3.0) ** 2
    np.testing.assert_allclose(covariance_m2, np.linalg.inv(information), rtol=1e-9, atol=1e-18)


@pytest.mark.parametrize("rows", [np.diag([1.0, 1.0, 0.0]), None])
def test_a_joint_that_nothing_holds_is_an_error_that_says_so(skeleton, rows):
    active = np.zeros((2, skeleton.n_joints), dtype=bool)
    active[:, 0] = True
    linear, noise = gtsam.GaussianFactorGraph(), gtsam.noiseModel.Unit.Create(3)
    linear.add(gtsam.JacobianFactor(position_key(0, 0), np.eye(3), np.zeros(3), noise))
    if rows is not None:
        linear.add(gtsam.JacobianFactor(position_key(0, 1), rows, np.zeros(3), noise))
    with pytest.raises(ValueError, match="not held by any factor"):
        marginal_covariances(linear, active, with_velocity=False)
