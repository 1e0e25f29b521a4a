"""Detections that are too far from the body to be of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose.estimation.evidence.gather import gather
from fgpose.estimation.evidence.plausibility import beyond_reach, middles_m, off_body
from fgpose.io.skeletons import load_skeleton
from fgpose_benchmarks.synthetic import NO_NOISE, NO_OCCLUSION, Scene, motion_from_npz, ring_rig, simulate
from tests.conftest import MOCAP

BEHIND_HIM_M = np.array([[3.0, 0.0, 1.0]])
HEAD_TO_ANKLE_M = 2.1
HEIGHTS_M = {"toe": 0.0, "heel": 0.0, "ankle": 0.1, "knee": 0.55, "hip": 1.05, "shoulder": 1.7}


@pytest.fixture(scope="module")
def ankle(skeleton: fgpose.Skeleton) -> int:
    return skeleton.joints.index("left_ankle")


@pytest.fixture(scope="module")
def hallucinated(walking_scene: Scene, ankle: int) -> fgpose.Observations:
    """Two cameras take a thing behind the person for an ankle, and the others do not see it."""
    seen = walking_scene.observations.frames(slice(0, 30))
    points_px = seen.points2d_px.copy()
    points_px[:, :2, ankle] = walking_scene.rig.project(BEHIND_HIM_M)[:2, 0]
    points_px[:, :2, ankle] += np.random.default_rng(0).normal(0, 2, (30, 2, 2))
    missing = np.zeros(seen.confidence.shape, dtype=bool)
    missing[:, 2:, ankle] = True
    return replace(seen, points2d_px=points_px, points3d_m=None).without(missing)


@pytest.mark.parametrize(("off_m", "is_beyond"), [(1.99, False), (2.01, True)])
def test_rays_pass_the_middle_of_the_body_at_a_distance(off_m: float, is_beyond: bool, rig: fgpose.CameraRig) -> None:
    middle_m = np.array([0.2, -0.1, 1.0])
    points_px = np.full((1, rig.n_cameras, 1, 2), np.nan)
    for c, camera in enumerate(rig.cameras):
        to_middle_m = middle_m - camera.position_m
        distance_m = np.linalg.norm(to_middle_m)
        aside = np.cross(to_middle_m, [0.0, 0.0, 1.0])
        angle = np.arcsin(off_m / distance_m)
        ray = np.cos(angle) * to_middle_m / distance_m + np.sin(angle) * aside / np.linalg.norm(aside)
        points_px[0, c, 0] = camera.project(camera.position_m + ray)
    assert (beyond_reach(points_px, middle_m[None], rig) == is_beyond).all()
    assert not beyond_reach(points_px, np.full((1, 3), np.nan), rig).any()


def test_a_camera_that_looks_away_from_the_body(rig: fgpose.CameraRig) -> None:
    behind_m = rig.cameras[0].position_m - 3 * rig.cameras[0].world_T_camera[:3, 2]
    centre_px = np.full((1, rig.n_cameras, 1, 2), np.nan)
    centre_px[0, 0, 0] = rig.cameras[0].K[:2, 2]
    assert beyond_reach(centre_px, behind_m[None], rig)[0, 0, 0]


@pytest.mark.parametrize("clip", sorted(path.name for path in MOCAP.glob("*.npz")))
def test_nobody_reaches_so_far(clip: str) -> None:
    """Motion capture, as if of somebody 2.3 m tall."""
    truth_m, _ = motion_from_npz(MOCAP / clip)
    head_to_ankle_m = np.median(np.ptp(truth_m[..., 2], axis=1))
    tall_m = truth_m * max(HEAD_TO_ANKLE_M / head_to_ankle_m, 1.0)
    middle_m = middles_m(tall_m)
    assert np.isfinite(middle_m).all()
    assert not off_body(tall_m, middle_m).any()


def test_the_middle_of_a_whole_body_is_not_in_its_face() -> None:
    """Of its 133 joints 68 are of the face: from there a foot may be two metres away."""
    whole = load_skeleton("coco_wholebody_133")
    points_m = np.zeros((1, whole.n_joints, 3))
    points_m[0, :, 2] = 2.15  # arms and hands above the head
    for joint in whole.body:
        points_m[0, joint, 2] = next((z for name, z in HEIGHTS_M.items() if name in whole.joints[joint]), 2.0)
    rig = ring_rig(4, 6.0, 1.5)
    seen = fgpose.Observations(whole, np.zeros(1), rig.project(points_m), np.ones((1, 4, whole.n_joints)))
    evidence = gather(seen, rig, fgpose.Config())
    np.testing.assert_allclose(evidence.guess_m, points_m, atol=1e-3)


def test_few_joints_and_millimetres_make_no_body(walking_scene: Scene) -> None:
    truth_m = walking_scene.truth_m[:5]
    some_m = truth_m.copy()
    some_m[:, 3:] = np.nan
    assert np.isnan(middles_m(some_m)).all()
    assert np.isnan(middles_m(1000 * truth_m)).all()


def test_what_two_cameras_agree_on_elsewhere_is_no_guess(
    hallucinated: fgpose.Observations, rig: fgpose.CameraRig, ankle: int, walking_scene: Scene
) -> None:
    evidence = gather(hallucinated, rig, fgpose.Config())
    assert np.isnan(evidence.guess_m[:, ankle]).all()
    others = np.arange(hallucinated.skeleton.n_joints) != ankle
    error_m = np.linalg.norm((evidence.guess_m - walking_scene.truth_m[:30])[:, others], axis=-1)
    assert np.nanmax(error_m) < 0.3


def test_online_no_joint_begins_metres_away(
    hallucinated: fgpose.Observations, rig: fgpose.CameraRig, ankle: int
) -> None:
    """Before, it was 3 m off."""
    estimator = fgpose.Estimator(rig, hallucinated.skeleton)
    for frame in hallucinated:
        estimate = estimator.update(frame)
        assert estimate.status[ankle] == fgpose.Status.UNOBSERVABLE
        assert np.isnan(estimate.positions_m[ankle]).all()


def test_they_are_shown_as_hallucinated(
    hallucinated: fgpose.Observations, rig: fgpose.CameraRig, ankle: int, walking_scene: Scene
) -> None:
    """A camera that follows somebody else must be found by them, so they are not left out."""
    points_px = hallucinated.points2d_px.copy()
    points_px[10:, 2:, ankle] = walking_scene.observations.points2d_px[10:30, 2:, ankle]
    confidence = np.where(np.isfinite(points_px).all(axis=-1), 1.0, 0.0)
    trajectory = fgpose.smooth(replace(hallucinated, points2d_px=points_px, confidence=confidence), rig)
    assert trajectory.visibility is not None
    assert trajectory.residual_px is not None
    assert (trajectory.visibility[:, :2, ankle] < 0.5).all()
    assert (trajectory.residual_px[:, :2, ankle] > 50).all()
    assert np.linalg.norm(trajectory.positions_m - walking_scene.truth_m[:30], axis=-1)[10:, ankle].max() < 0.1


def test_a_views_own_3d_elsewhere_is_no_guess(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton, ankle: int) -> None:
    """One camera is right, another takes something else for the ankle, in its image and in space."""
    truth_m, fps = motion_from_npz(MOCAP / "cmu_03_03_b.npz")
    scene = simulate(truth_m[:5], skeleton, rig, fps, NO_NOISE, NO_OCCLUSION, seed=0)
    seen = scene.observations
    assert seen.points3d_m is not None
    points_px, views_m = seen.points2d_px.copy(), seen.points3d_m.copy()
    points_px[:, 1, ankle], views_m[:, 1, ankle] = rig.project(BEHIND_HIM_M)[1, 0], BEHIND_HIM_M
    missing = np.zeros(seen.confidence.shape, dtype=bool)
    missing[:, 2:, ankle] = True
    evidence = gather(replace(seen, points2d_px=points_px, points3d_m=views_m).without(missing), rig, fgpose.Config())
    np.testing.assert_allclose(evidence.guess_m[:, ankle], truth_m[:5, ankle], atol=0.02)
