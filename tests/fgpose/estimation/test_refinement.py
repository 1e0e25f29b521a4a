from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from fgpose.config import Config, RefinementConfig
from fgpose.estimation.evidence.fusion import fuse
from fgpose.estimation.refinement import refine
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status
from fgpose_benchmarks.synthetic import NO_NOISE, NO_OCCLUSION, Scene, simulate, walking

NAN = np.nan


def equation_5(
    pose_m: np.ndarray, detected_px: np.ndarray, rig: CameraRig, skeleton: Skeleton, px_per_mm: float
) -> np.ndarray:
    """The residuals whose squares eq. 5 sums, pixels: written from the paper, with nothing of the library's solver."""
    P, residuals = pose_m.reshape(-1, 3), []
    for camera, p in zip(rig.cameras, detected_px, strict=True):
        R, t_m = camera.camera_T_world[:3, :3], camera.camera_T_world[:3, 3]
        u = (P @ R.T + t_m) @ camera.K.T
        detected = np.isfinite(p).all(axis=-1)
        residuals.append((u[:, :2] / u[:, 2:] - p)[detected].ravel())
    joints = dict(zip(skeleton.joints, pose_m.reshape(-1, 3), strict=True))
    for upper, lower in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle")):
        left, right = (
            np.linalg.norm(joints[f"{side}_{upper}"] - joints[f"{side}_{lower}"]) for side in ("left", "right")
        )
        residuals.append([px_per_mm * 1000 * (left - right)])
    return np.concatenate(residuals)


def solved_by_scipy(observations: Observations, rig: CameraRig, px_per_mm: float) -> np.ndarray:
    start_m = fuse(observations, rig).positions_m
    poses_m = []
    for pose_m, detected_px in zip(start_m, rig.undistort(observations.points2d_px), strict=True):
        solution = least_squares(
            equation_5,
            pose_m.ravel(),
            args=(detected_px, rig, observations.skeleton, px_per_mm),
            xtol=1e-13,
            ftol=1e-13,
            gtol=1e-10,
        )
        poses_m.append(solution.x.reshape(-1, 3))
    return np.stack(poses_m)


@pytest.mark.parametrize("px_per_mm", [pytest.param(1.0, marks=pytest.mark.slow), 0.2, 5.0])
def test_is_the_minimum_of_equation_5(walking_scene, rig, px_per_mm):
    observations = walking_scene.observations.frames(slice(0, 60, 15))
    config = Config(refinement=RefinementConfig(px_per_mm=px_per_mm))
    refined = refine(observations, rig, config)
    expected_m = solved_by_scipy(observations, rig, px_per_mm)
    # 0.1 mm: the solver stops below a step of 1 um; the weak prior of 5 m gives way by (4 mm / 5 m)^2 of centimetres
    np.testing.assert_allclose(refined.positions_m, expected_m, atol=1e-4)
    assert refined.convergence is not None
    assert refined.convergence.converged


def test_is_the_minimum_of_equation_5_under_occlusion(mocap_scene, rig):
    """Detections that are 45 px off, and views that miss a joint, as long as two see it."""
    observations = mocap_scene.observations
    complete = np.flatnonzero((observations.seen.sum(axis=1) >= 2).all(axis=1) & ~observations.seen.all(axis=(1, 2)))
    for number in complete[:: len(complete) // 4].tolist():
        frame = observations.frames(slice(number, number + 1))
        np.testing.assert_allclose(refine(frame, rig).positions_m, solved_by_scipy(frame, rig, 1.0), atol=1e-4)


def test_the_unit_sets_how_much_symmetry_counts(walking_scene, rig):
    observations = walking_scene.observations.frames(slice(0, 60, 15))

    def asymmetry_m(positions_m: np.ndarray) -> float:
        pairs = observations.skeleton.limb_pairs
        lengths_m = [
            [np.linalg.norm(positions_m[:, a] - positions_m[:, b], axis=-1) for a, b in pair] for pair in pairs
        ]
        return float(np.mean([np.abs(left - right) for left, right in lengths_m]))

    differences_m = [
        asymmetry_m(refine(observations, rig, Config(refinement=RefinementConfig(px_per_mm=unit))).positions_m)
        for unit in (0.01, 0.3, 10.0)
    ]
    assert differences_m[0] > 2 * differences_m[1] > 4 * differences_m[2]


def test_finds_the_truth_when_the_detections_are_exact(rig, skeleton):
    """The 3D candidates are off; eq. 5 does not contain them but as a start."""
    truth_m = walking(4, 10.0, skeleton)
    scene = simulate(truth_m, skeleton, rig, 10.0, replace(NO_NOISE, camera_bias_m=0.1), NO_OCCLUSION, seed=0)
    fused_m = fuse(scene.observations, rig).positions_m
    assert np.linalg.norm(fused_m - truth_m, axis=-1).max() > 0.01
    # zero residual: a step below 1 um leaves far less
    np.testing.assert_allclose(refine(scene.observations, rig).positions_m, truth_m, atol=1e-6)


@pytest.mark.slow
def test_is_better_than_the_fused_pose_it_starts_from(walking_scene: Scene, rig: CameraRig):
    observations = walking_scene.observations
    truth_m = walking_scene.truth_m
    fused_m = fuse(observations, rig).positions_m
    refined_m = refine(observations, rig).positions_m
    errors_m = [np.linalg.norm(pose_m - truth_m, axis=-1).mean() for pose_m in (fused_m, refined_m)]
    # depth errors of 15 cm a view against 5 px of four views
    assert errors_m[1] < 0.7 * errors_m[0]


def test_frames_do_not_know_of_each_other(walking_scene, rig):
    observations = walking_scene.observations.frames(slice(0, 6))
    together_m = refine(observations, rig).positions_m
    alone_m = np.concatenate([refine(frame, rig).positions_m for frame in observations])
    # Solved together they share damping alone: each ends within the tolerance of a step, 1 um.
    np.testing.assert_allclose(together_m, alone_m, rtol=0, atol=1e-6)


def test_a_frame_that_does_not_converge_spoils_no_other(walking_scene, rig):
    """Its detections are anywhere: rounding decides before the step is short enough."""
    observations = walking_scene.observations.frames(slice(0, 6))
    points2d_px = observations.points2d_px.copy()
    points2d_px[2] = np.random.default_rng(0).uniform(0, 1000, points2d_px[2].shape)
    together, without = (
        refine(replace(observations, points2d_px=px), rig) for px in (points2d_px, observations.points2d_px)
    )
    assert together.convergence is not None
    assert not together.convergence.converged
    others = np.arange(6) != 2
    np.testing.assert_allclose(together.positions_m[others], without.positions_m[others], rtol=0, atol=2e-6)


def test_both_backends_find_the_same(mocap_scene: Scene, rig: CameraRig):
    observations = mocap_scene.observations.frames(slice(0, 12))
    found_m = [refine(observations, rig, Config(solver={"backend": name})).positions_m for name in ("numpy", "gtsam")]
    # Each ends within 1 um of the optimum, if the last step says how far it is.
    np.testing.assert_allclose(found_m[0], found_m[1], rtol=0, atol=5e-6)


def test_joints_that_equation_5_does_not_determine(walking_scene, rig):
    observations = walking_scene.observations.frames(slice(0, 3))
    points2d_px, points3d_m = observations.points2d_px.copy(), observations.points3d_m.copy()
    head, wrist = 10, 13
    points2d_px[0, :, head] = NAN
    points3d_m[0, :, head] = NAN
    points2d_px[1, 1:, wrist] = NAN
    points2d_px[2], points3d_m[2] = NAN, NAN
    partial = replace(observations, points2d_px=points2d_px, points3d_m=points3d_m, confidence=np.array(1.0))
    refined = refine(partial, rig)
    assert refined.status[0, head] == Status.UNOBSERVABLE
    assert np.isnan(refined.positions_m[0, head]).all()
    assert refined.status[1, wrist] == Status.PREDICTED
    # one ray and the limb's length hold it near the fused pose
    np.testing.assert_allclose(refined.positions_m[1, wrist], fuse(partial, rig).positions_m[1, wrist], atol=0.3)
    assert np.isnan(refined.positions_m[2]).all()
    assert (refined.status[2] == Status.UNOBSERVABLE).all()
    assert (refined.status[0] == Status.OBSERVED).sum() == 16


def test_reports_progress_and_what_did_not_converge(walking_scene, rig):
    observations = walking_scene.observations.frames(slice(0, 40))
    calls: list[tuple[int, int]] = []
    config = Config(solver={"max_iterations": 1})
    refined = refine(observations, rig, config, progress=lambda done, total: calls.append((done, total)))
    assert calls == [(32, 40), (40, 40)]
    assert refined.convergence is not None
    assert not refined.convergence.converged
    assert refined.convergence.iterations == 1
    assert refined.convergence.final_error < refined.convergence.initial_error
    assert refined.config == config


def test_residuals_are_distances_in_undistorted_pixels(walking_scene, rig):
    observations = walking_scene.observations.frames(slice(0, 3))
    refined = refine(observations, rig)
    distance_px = np.linalg.norm(rig.project(refined.positions_m) - observations.points2d_px, axis=-1)
    assert refined.residual_px is not None
    np.testing.assert_allclose(refined.residual_px, distance_px, rtol=1e-9)
    assert refined.camera_names == rig.names
