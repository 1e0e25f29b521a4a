from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from adjusted_rigs import FPS, adjusted, moved, walker

from fgpose.calibration.from_people.verdict.coverage import coverage
from fgpose.calibration.from_people.verdict.cross_checks import cross_check_deg, third_views_mrad
from fgpose.calibration.from_people.verdict.handedness import handedness, mirrored_views
from fgpose.calibration.from_people.walk import Walk
from fgpose.geometry.camera import CameraRig
from fgpose_benchmarks.synthetic import ring_rig
from fgpose_factors.robust_statistics import known_median
from tests.wrong_rigs import turned

RIG = ring_rig(4, 4.5, 1.7, (0.0, 0.0, 0.9))
MIRROR = np.array([-1.0, 1.0, 1.0])


def medians_mrad(px: np.ndarray, confidence: np.ndarray, rig: CameraRig) -> np.ndarray:
    return np.array([known_median(own) for own in third_views_mrad(px, confidence, rig)])


def test_a_third_view_sees_what_the_others_say() -> None:
    truth_m, _ = walker(5.0, 0)
    px = RIG.project(truth_m)
    confidence = np.ones(px.shape[:-1])
    assert medians_mrad(px, confidence, RIG).max() < 1e-2  # the arccosine of 1 - 1e-15 is 4e-8
    mrad = medians_mrad(px, confidence, turned(RIG, 2, 2.0))
    assert mrad[2] == pytest.approx(1e3 * np.deg2rad(2.0), rel=0.05)
    assert mrad.argmax() == 2


def test_a_third_view_sees_a_roll() -> None:
    # It turns the body in the image, and hardly moves it.
    truth_m, _ = walker(5.0, 0)
    px = RIG.project(truth_m)
    rolled = np.zeros((4, 6))
    rolled[2, 2] = np.deg2rad(10.0)
    mrad = medians_mrad(px, np.ones(px.shape[:-1]), moved(RIG, rolled))
    assert mrad.argmax() == 2
    # A body of 0.45 m (RMS) at 4.5 m is 100 mrad from its middle; it need not be in the middle of the image.
    assert 17.0 < mrad[2] < 60.0


def test_detectors_that_differ_by_joint_do_not_look_like_a_wrong_camera() -> None:
    truth_m, skeleton = walker(5.0, 0)
    px = RIG.project(truth_m)
    # 30 mm of each joint in each view, at 4.5 m: 7 mrad, of which a mean over 17 joints leaves a quarter.
    px = px + 1145.0 * 0.03 / 4.5 / np.sqrt(2) * np.random.default_rng(0).standard_normal((1, 4, skeleton.n_joints, 2))
    assert medians_mrad(px, np.ones(px.shape[:-1]), RIG).max() < 5.0


def test_two_cameras_have_the_epipolar_plane() -> None:
    truth_m, _ = walker(5.0, 0)
    pair = RIG.subset(RIG.names[:2])
    px = pair.project(truth_m)
    confidence = np.ones(px.shape[:-1])
    assert medians_mrad(px, confidence, pair).max() < 1e-6
    rolled = np.zeros((2, 6))
    rolled[1, 0] = np.deg2rad(1.0)  # up in the image
    assert medians_mrad(px, confidence, moved(pair, rolled)) == pytest.approx(17.0, rel=0.3)


def test_a_camera_that_is_alone_cannot_be_judged() -> None:
    truth_m, _ = walker(5.0, 0)
    px, confidence = RIG.project(truth_m), np.ones((len(truth_m), 4, 17))
    confidence[::2, :3], confidence[1::2, 3] = 0.0, 0.0
    mrad = medians_mrad(px, confidence, RIG)
    assert np.isnan(mrad[3])
    assert np.isfinite(mrad[:3]).all()


def test_the_referee_finds_a_twist() -> None:
    truth_m, _ = walker(5.0, 0)
    points3d_m = np.stack([camera.to_camera_frame(truth_m) for camera in RIG.cameras], axis=1)
    points3d_m += 0.3  # places do not matter, the pose does
    points3d_m[:, 1] = np.nan
    off_deg = cross_check_deg(points3d_m, truth_m, turned(RIG, 2, 40.0))
    assert off_deg[[0, 3]] == pytest.approx(0.0, abs=1e-4)
    assert off_deg[2] == pytest.approx(40.0)
    assert np.isnan(off_deg[1])


def test_the_heart_is_on_the_left() -> None:
    truth_m, skeleton = walker(30.0, 1)
    assert handedness(truth_m, skeleton) > 0.6
    assert handedness(truth_m * MIRROR, skeleton) == pytest.approx(-handedness(truth_m, skeleton))
    case = adjusted(seed=1)
    assert handedness(case.joints_m, skeleton) > 0.4  # with a bias of 30 mm
    assert handedness(np.full_like(truth_m, np.nan), skeleton) == 0


def test_a_mirror_is_found_by_its_turns() -> None:
    truth_m, skeleton = walker(30.0, 1)
    points3d_m = np.stack([camera.to_camera_frame(truth_m) for camera in RIG.cameras], axis=1)
    # 80 mm in depth: what networks do.
    rng = np.random.default_rng(0)
    points3d_m += np.array([0.02, 0.02, 0.08]) * rng.standard_normal(points3d_m.shape)
    assert not mirrored_views(points3d_m, skeleton).any()
    # The detector names the sides of the body that it sees.
    points3d_m[:, 2] = (points3d_m[:, 2] * MIRROR)[:, skeleton.mirror]
    assert mirrored_views(points3d_m, skeleton).tolist() == [False, False, True, False]


def test_somebody_who_stands_still_is_as_good_as_his_image() -> None:
    truth_m, skeleton = walker(30.0, 1)
    points3d_m = np.stack([camera.to_camera_frame(truth_m[:1]) for camera in RIG.cameras], axis=1)
    assert not mirrored_views(points3d_m, skeleton).any()


def walk_of(joints_m: np.ndarray, rig: CameraRig) -> Walk:
    _, skeleton = walker(5.0, 0)
    px = rig.project(joints_m)
    inside = np.asarray(((px >= 0) & (px < 1000)).all(axis=-1))
    time_s = np.arange(len(joints_m)) / FPS
    return Walk(skeleton, rig.names, time_s, np.where(inside[..., None], px, np.nan), inside.astype(float))


def test_what_a_walk_covers() -> None:
    truth_m, _ = walker(30.0, 1)
    covered = coverage(walk_of(truth_m, RIG), RIG, truth_m)
    hips_m = truth_m[:, 0]
    depth_m = RIG.cameras[0].to_camera_frame(hips_m)[:, 2]
    assert (covered.near_m[0], covered.far_m[0]) == pytest.approx(tuple(np.quantile(depth_m, [0.05, 0.95])), rel=0.05)
    assert covered.depth_ratio[0] > 1.3
    assert 2.0 < covered.area_m2 < 9.0  # of 3 m by 3 m
    assert 0.2 < covered.common_share <= 1.0
    assert (covered.box_m[0] < covered.box_m[1]).all()
    assert covered.along_m == pytest.approx(np.sqrt(np.linalg.eigvalsh(np.cov(hips_m[:, :2].T))[1]), rel=0.1)
    assert (covered.seen_s > 20).all()


def test_a_line_is_narrow_and_a_place_is_small() -> None:
    truth_m, _ = walker(30.0, 1)
    line_m = truth_m.copy()
    line_m[..., 1] -= truth_m[:, :1, 1]
    covered = coverage(walk_of(line_m, RIG), RIG, line_m)
    assert covered.across_m.max() < 0.05
    assert covered.along_m.min() > 0.5
    place_m = truth_m - truth_m[:, :1] * [1.0, 1.0, 0.0]
    covered = coverage(walk_of(place_m, RIG), RIG, place_m)
    assert covered.along_m.max() < 0.05
    assert covered.image_share.max() < 0.7


def test_nobody_covers_nothing() -> None:
    truth_m, _ = walker(5.0, 0)
    walk = walk_of(truth_m, RIG)
    walk = replace(walk, points2d_px=np.full_like(walk.points2d_px, np.nan), confidence=np.zeros_like(walk.confidence))
    covered = coverage(walk, RIG, np.full_like(truth_m, np.nan))
    assert covered.area_m2 == 0
    assert np.isnan(covered.near_m).all()
    assert (covered.seen_s == 0).all()


def test_where_one_camera_alone_sees_the_person_is_not_covered() -> None:
    truth_m, _ = walker(5.0, 0)
    walk = walk_of(truth_m, RIG)
    alone = replace(walk, confidence=walk.confidence * np.array([1.0, 0.0, 0.0, 0.0])[:, None])
    covered = coverage(alone, RIG, truth_m)
    assert covered.area_m2 == 0
    assert np.isfinite(covered.near_m[0])
    assert np.isnan(covered.box_m).all()
