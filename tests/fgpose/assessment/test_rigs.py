"""Scores of a rig beside the true one: zero for the same rig in another world, and what is known of known changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fgpose.assessment import rigs
from fgpose.assessment.rig_alignment import fitted, rig_similarity
from fgpose.geometry.camera import CameraRig
from fgpose_benchmarks.synthetic import find_studio, walking
from tests.wrong_rigs import in_another_world

RIG = find_studio("mixed_5").rig
JOINTS_M = walking(40, 10.0)
WORLD_R = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()


def elsewhere(rig: CameraRig, scale: float = 1.7, R: np.ndarray = WORLD_R) -> CameraRig:
    return in_another_world(rig, scale, R, (1.0, 2.0, 3.0))


def with_camera(
    rig: CameraRig, number: int, R: np.ndarray | None = None, shift_m: np.ndarray | None = None
) -> CameraRig:
    """One camera turned in its own frame and moved in the world."""
    cameras = list(rig.cameras)
    pose = cameras[number].world_T_camera.copy()
    pose[:3, :3] = pose[:3, :3] @ (np.eye(3) if R is None else R)
    pose[:3, 3] += np.zeros(3) if shift_m is None else shift_m
    cameras[number] = replace(cameras[number], world_T_camera=pose)
    return CameraRig(tuple(cameras))


@pytest.mark.parametrize("n_cameras", [2, 3, 5])
def test_the_same_rig_in_another_world_is_perfect(n_cameras: int):
    rig = RIG.subset(RIG.names[:n_cameras])
    moved = elsewhere(rig)
    np.testing.assert_allclose(rigs.position_errors_m(moved, rig), 0.0, atol=1e-12)
    np.testing.assert_allclose(rigs.direction_errors_deg(moved, rig), 0.0, atol=1e-6)
    np.testing.assert_allclose(rigs.rotation_errors_deg(moved, rig), 0.0, atol=1e-6)
    assert rigs.scale_error(moved, rig) == pytest.approx(0.7)
    errors_m = rigs.induced_errors_m(moved, rig, JOINTS_M)
    assert np.isfinite(errors_m).mean() > 0.9
    # Undistortion is exact to 1e-4 px, 5 m and 640 px: below a micrometre for rays that meet at large angles.
    assert np.nanmax(errors_m) < 1e-5


def test_a_moved_camera_shows_in_its_place_and_not_in_rotations():
    moved = with_camera(RIG, 2, shift_m=np.array([0.0, 0.03, 0.0]))
    errors_m = rigs.position_errors_m(moved, RIG)
    assert errors_m.argmax() == 2
    # The alignment takes part of it: a fifth for one of five cameras, and somewhat more.
    assert 0.6 * 0.03 < errors_m[2] < 0.03
    np.testing.assert_allclose(rigs.rotation_errors_deg(moved, RIG), 0.0, atol=1e-6)


def test_a_turned_camera_shows_in_the_pairs_that_it_is_in():
    turn = Rotation.from_rotvec(np.deg2rad([0.0, 1.5, 0.0])).as_matrix()
    errors_deg = rigs.rotation_errors_deg(with_camera(RIG, 0, R=turn), RIG)
    # Pairs in the order of combinations: the first four are those of camera 0.
    np.testing.assert_allclose(errors_deg, [1.5] * 4 + [0.0] * 6, atol=1e-6)
    own_deg = rigs.direction_errors_deg(with_camera(RIG, 0, R=turn), RIG)
    assert own_deg.argmax() == 0
    assert 0.75 * 1.5 < own_deg[0] < 1.5


def test_scale_vertical_and_floor_are_those_of_the_world():
    tilt = Rotation.from_rotvec(np.deg2rad([2.0, 0.0, 0.0])).as_matrix()
    tilted = elsewhere(RIG, scale=1.02, R=tilt)
    assert rigs.scale_error(tilted, RIG) == pytest.approx(0.02)
    assert rigs.vertical_error_deg(tilted, RIG) == pytest.approx(2.0)
    # x_new = 1.02 R x + (1, 2, 3): z_new = 0 is 3 / 1.02 m below the floor on the axis of the tilt, hence beneath the
    # origin at (3 + 0) / (1.02 cos 2 degrees) along the tilted vertical; the foot point differs by its inclination.
    upright = elsewhere(RIG, scale=1.02, R=np.eye(3))
    assert rigs.floor_error_m(upright, RIG, np.zeros(3)) == pytest.approx(-3 / 1.02)


def test_the_floor_of_a_tilted_world_counts_beneath_the_point():
    tilt = Rotation.from_rotvec(np.deg2rad([0.0, 2.0, 0.0])).as_matrix()
    tilted = in_another_world(RIG, R=tilt)
    assert rigs.floor_error_m(tilted, RIG, np.zeros(3)) == pytest.approx(0.0, abs=1e-9)
    # 2 m away the plane is off by 2 m times the sine, and the foot point by its cosine.
    off_m = rigs.floor_error_m(tilted, RIG, np.array([2.0, 0.0, 0.0]))
    assert abs(off_m) == pytest.approx(2.0 * np.sin(np.deg2rad(2.0)), rel=2e-3)


def test_focal_lengths_and_starts_are_compared_camera_by_camera():
    cameras = [replace(camera, K=np.diag([1.01, 1.01, 1.0]) @ camera.K) for camera in RIG.cameras]
    np.testing.assert_allclose(rigs.focal_errors(CameraRig(tuple(cameras)), RIG), 0.01)
    own, true = (RIG.with_time_offsets(np.array(offsets)) for offsets in ([1.0, 2.0, 3, 4, 5.5], [0.0, 1.0, 2, 3, 4]))
    np.testing.assert_allclose(rigs.start_errors_s(own, true), [0.0, 0.0, 0.0, 0.0, 0.5])


def test_an_induced_error_is_what_a_shift_does_to_depth():
    # Of two cameras 75 degrees apart, one turned by 0.5 degrees: at 4.5 m a ray is off by 39 mm, and where it meets the
    # other by 39 mm / sin(75 degrees), nearly all of which a motion of the joints takes away.
    pair = find_studio("pair").rig
    turn = Rotation.from_rotvec(np.deg2rad([0.0, 0.5, 0.0])).as_matrix()
    errors_m = rigs.induced_errors_m(with_camera(pair, 1, R=turn), pair, JOINTS_M)
    assert 0.0005 < np.nanmean(errors_m) < 0.02
    assert np.isnan(rigs.induced_errors_m(pair, pair, JOINTS_M + 100.0)).all()


def test_a_similarity_is_the_one_that_was_applied():
    rng = np.random.default_rng(0)
    points_m = rng.standard_normal((20, 3))
    target_m = 0.8 * points_m @ WORLD_R.T + np.array([1.0, -2.0, 0.5])
    points_m[3] = np.nan
    found = fitted(points_m, target_m)
    assert found.scale == pytest.approx(0.8)
    np.testing.assert_allclose(found.R, WORLD_R, atol=1e-12)
    np.testing.assert_allclose(found.of(points_m)[4:], target_m[4:], atol=1e-12)
    assert fitted(points_m, target_m, with_scale=False).scale == 1.0
    # A mirror image is not a rotation.
    mirrored = fitted(points_m * np.array([1.0, 1.0, -1.0]), target_m)
    assert np.linalg.det(mirrored.R) == pytest.approx(1.0)
    with pytest.raises(ValueError, match="a similarity needs three points, 2 are known"):
        fitted(points_m[:2], target_m[:2])


def test_a_single_camera_has_no_scale():
    alone = RIG.subset(RIG.names[:1])
    assert rig_similarity(elsewhere(alone), alone).scale == 1.0
