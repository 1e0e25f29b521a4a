"""A first rig from two cameras and what they see of the walker."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import gtsam
import numpy as np
import pytest
from walks import SKELETON, bare, position_errors_m, rotation_errors_deg, walk

from fgpose.assessment.rigs import rotation_errors_deg as errors_of_pairs_deg
from fgpose.calibration.from_people.rig import scaffold as module
from fgpose.calibration.from_people.rig.evidence import body_joints
from fgpose.calibration.from_people.rig.scaffold import Scaffold, largest_differences_deg, scaffold, scaffolds
from fgpose.geometry.camera import CameraRig
from fgpose_benchmarks.synthetic import DetectionNoise, ring_rig

RIG = ring_rig(3)
ROUGH_DEG = 10.0
WALK = walk(RIG, 150, DetectionNoise(), bias_m=0.03, views_3d=True)


@pytest.fixture(scope="module")
def found() -> Scaffold:
    return scaffold(WALK, bare(RIG))


def test_the_rig_is_roughly_right_and_in_the_frame_of_the_first_camera(found: Scaffold) -> None:
    np.testing.assert_allclose(found.rig.cameras[0].world_T_camera, np.eye(4), atol=1e-9)
    # The walker turns on the spot, almost, and so do errors of 30 mm: on a circle of 1 m that is far from noise.
    # Twisted poses are 30 degrees off and more.
    assert rotation_errors_deg(found.rig, RIG).max() < ROUGH_DEG
    assert position_errors_m(found.rig, RIG).max() < 4.5 * np.deg2rad(ROUGH_DEG)


def test_its_unit_is_that_of_the_views_3d(found: Scaffold) -> None:
    apart_m = [np.linalg.norm(rig.cameras[1].position_m - rig.cameras[0].position_m) for rig in (found.rig, RIG)]
    # The size of the body in 3D is from its noisy depths, 8 % too large as simulated.
    assert apart_m[0] == pytest.approx(apart_m[1], rel=0.15)


def test_figures_for_a_verdict(found: Scaffold) -> None:
    # Each view is turned by 6 degrees, two views by 6 to 12 relative to each other.
    off_diagonal = found.cross_check_deg[np.triu_indices(3, 1)]
    assert (off_diagonal > 2.0).all()
    assert (off_diagonal < 20.0).all()
    assert (found.residual < 0.25).all()  # of the body's radius, 0.45 m: 30 mm and triangulation add up to 0.1
    assert found.n_joints == (150 * len(body_joints(SKELETON)),) * 3
    assert found.rival_deg < 2 * ROUGH_DEG


def test_without_3d_a_torso_is_the_unit_and_nobody_is_the_referee() -> None:
    made = scaffold(replace(WALK, points3d_m=None), bare(RIG))

    assert np.isnan(made.cross_check_deg).all()
    assert rotation_errors_deg(made.rig, RIG).max() < ROUGH_DEG
    # The walker's own torso, shoulder to hip, is 0.51 m.
    apart_m = [np.linalg.norm(rig.cameras[1].position_m - rig.cameras[0].position_m) for rig in (made.rig, RIG)]
    assert apart_m[0] == pytest.approx(apart_m[1], rel=0.15)


def test_two_cameras_are_told_by_the_3d() -> None:
    pair = RIG.subset(RIG.names[:2])
    made = scaffold(walk(pair, 150, DetectionNoise(), bias_m=0.03, views_3d=True), bare(pair))

    assert rotation_errors_deg(made.rig, pair).max() < ROUGH_DEG


def test_a_camera_that_shares_nothing_is_named() -> None:
    points2d_px = WALK.points2d_px.copy()
    points2d_px[:, 2] = np.nan

    with pytest.raises(ValueError, match=r"cannot be placed: ring_0, ring_1 on one side and ring_2 on the other"):
        scaffold(replace(WALK, points2d_px=points2d_px), bare(RIG))


def test_nobody_is_seen_by_two_at_a_time() -> None:
    points2d_px = WALK.points2d_px.copy()
    points2d_px[:50, 1:] = points2d_px[50:100, [0, 2]] = points2d_px[100:, :2] = np.nan

    with pytest.raises(ValueError, match="no two of them see the walker at the same time"):
        scaffold(replace(WALK, points2d_px=points2d_px), bare(RIG))


def test_one_camera_is_not_enough() -> None:
    alone = RIG.subset(RIG.names[:1])

    with pytest.raises(ValueError, match="at least two are needed"):
        scaffolds(walk(alone, 20), bare(alone))


def turned(rig: CameraRig, sigma_rad: float, seed: int) -> CameraRig:
    rng, cameras = np.random.default_rng(seed), []
    for camera in rig.cameras:
        pose = camera.world_T_camera.copy()
        pose[:3, :3] = pose[:3, :3] @ gtsam.Rot3.Expmap(rng.normal(0, sigma_rad, 3)).matrix()
        cameras.append(replace(camera, world_T_camera=pose))
    return CameraRig(tuple(cameras))


@pytest.mark.parametrize("sigma_rad", [1e-7, 0.05, 2.0])
def test_differences_of_all_rigs_at_once_are_those_of_each_two(sigma_rad: float) -> None:
    rigs = [turned(ring_rig(5), sigma_rad, seed) for seed in range(4)]
    each = [max(errors_of_pairs_deg(rig, other).max() for other in rigs[:2]) for rig in rigs]
    # Rotations are known to 1e-16; an arccosine would know small angles to 1e-8.
    np.testing.assert_allclose(largest_differences_deg(rigs, rigs[:2]), each, rtol=1e-6, atol=1e-12)


def test_a_large_rig_begins_with_some_pairs_of_all_cameras(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[tuple[int, int]] = []
    monkeypatch.setattr(module._Views, "grown", lambda _, first, second, __: begun.append((first, second)))
    monkeypatch.setattr(module, "relative_poses", lambda *_: [module.RelativePose(np.eye(4), 0.0, 1.0, np.nan)])
    rig = ring_rig(14)
    views = module._Views.of(walk(rig, 20), bare(rig))

    views.all_grown(views.begun_with, np.random.default_rng(0))
    assert len(begun) == 66
    assert {camera for pair in begun for camera in pair} == set(range(14))
    views.all_grown(views.other_pairs, np.random.default_rng(0))
    assert sorted(begun) == list(combinations(range(14), 2))
