"""What at least two cameras observe."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.field_of_view import in_views
from fgpose.live.tracking.observed import Volume, observed_share, volume_points_m
from fgpose_benchmarks.synthetic import ring_rig


def parallel_rig(n_cameras: int) -> CameraRig:
    """Cameras half a metre apart along x that look along z."""
    K = np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]])
    poses = [np.eye(4) for _ in range(n_cameras)]
    for number, world_T_camera in enumerate(poses):
        world_T_camera[0, 3] = 0.5 * number
    return CameraRig(tuple(Camera(f"c{n}", (640, 480), K, world, np.zeros(0)) for n, world in enumerate(poses)))


def test_two_cameras_are_needed(rig: CameraRig) -> None:
    points_m = Volume((-0.5, -0.5, 0.5), (0.5, 0.5, 1.5)).points_m()
    assert observed_share(rig, rig.names, points_m) == 1.0
    assert observed_share(rig, rig.names[:2], points_m) == 1.0
    assert observed_share(rig, rig.names[:1], points_m) == 0.0
    assert observed_share(rig, (), points_m) == 0.0
    assert observed_share(rig, rig.names, np.zeros((0, 3))) == 0.0


def test_the_share_is_that_of_the_overlap_of_two_images() -> None:
    rig = parallel_rig(2)
    # At 5 m an image is 6.4 m wide; two of them, 0.5 m apart, overlap over 5.9 m.
    line_m = np.stack([np.linspace(-3.2, 3.2, 1000), np.zeros(1000), np.full(1000, 5.0)], axis=-1)
    assert observed_share(rig, rig.names, line_m) == pytest.approx(5.9 / 6.4, abs=0.002)
    assert not in_views(rig, line_m * (1.0, 1.0, -1.0)).any()
    # A tenth of the width from either edge.
    assert in_views(rig, line_m, margin=0.1)[:, 0].mean() == pytest.approx(0.8, abs=0.002)


def test_a_point_that_the_lens_model_folds_back_is_not_observed() -> None:
    camera = parallel_rig(1).cameras[0]
    # With this coefficient the distorted radius grows up to 1.15 focal lengths and falls beyond.
    barrel = replace(camera, distortion=np.array([-0.25, 0.0, 0.0, 0.0]))
    far_m = np.array([[1.99, 0.0, 1.0]])
    folded_px = barrel.distort(barrel.project(far_m))
    assert (folded_px >= 0).all()
    assert (folded_px < barrel.size_px).all()
    assert not in_views(CameraRig((barrel,)), far_m).any()
    assert in_views(CameraRig((barrel,)), np.array([[0.3, 0.0, 1.0]])).all()


def test_the_volume_of_a_rig_is_what_it_was_set_up_to_observe() -> None:
    rig = ring_rig()
    points_m = volume_points_m(rig)
    assert observed_share(rig, rig.names, points_m) == 1.0
    assert 0.0 < observed_share(rig, rig.names[:3], points_m) < 1.0
    # The cameras look at (0, 0, 1) from 4.57 m away.
    assert np.abs(points_m.mean(axis=0) - (0, 0, 1)).max() < 0.2
    assert np.abs(points_m - (0, 0, 1)).max() == pytest.approx(np.hypot(4.5, 0.7) / 2)


def test_cameras_that_look_in_parallel_and_one_alone() -> None:
    points_m = volume_points_m(parallel_rig(2))
    assert len(points_m)
    assert np.median(points_m[:, 2]) == pytest.approx(4.0, abs=1.5)
    assert volume_points_m(parallel_rig(1)).shape == (0, 3)


def test_a_volume_is_a_grid_with_its_faces() -> None:
    points_m = Volume((0.0, 0.0, 0.0), (1.0, 0.5, 0.3), spacing_m=0.25).points_m()
    np.testing.assert_allclose(points_m.min(axis=0), 0.0)
    np.testing.assert_allclose(points_m.max(axis=0), (1.0, 0.5, 0.3))
    assert len(points_m) == 5 * 3 * 3
    with pytest.raises(ValueError, match="low_m must be below high_m"):
        Volume((0.0, 0.0, 0.0), (1.0, 0.0, 1.0))
