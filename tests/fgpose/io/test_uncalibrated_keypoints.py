"""Keypoints of cameras without a calibration."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calibrated_walks import FPS, SKELETON, seen_px, true_rig, write_openpose

import fgpose
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.intrinsics import guessed_intrinsics
from fgpose.io.keypoints import check_sizes, likely_sizes_px, load_uncalibrated, save_observations
from fgpose.people_observations import Detections, PeopleObservations


@pytest.fixture(scope="module")
def keypoints(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_openpose(tmp_path_factory.mktemp("walk") / "pose", seen_px(true_rig())[:5])


def seen(*extents_px: tuple[float, float]) -> PeopleObservations:
    """One joint in the corner of what each camera saw, and one in the middle; NaN: it saw nobody."""
    skeleton = fgpose.Skeleton("two", ("a", "b"), ((0, 1),), (0,))
    images = [
        Detections(f"cam{c}", 0.0, np.array([[np.array(extent) / 2, extent]]), np.ones((1, 2)))
        for c, extent in enumerate(extents_px)
    ]
    return PeopleObservations(skeleton, tuple(f"cam{c}" for c in range(len(images))), tuple(images))


def test_cameras_have_the_names_of_the_keypoints(keypoints: Path) -> None:
    people = load_uncalibrated(keypoints, SKELETON, fps=FPS)
    assert people.camera_names == ("cam1", "cam2", "cam3")
    np.testing.assert_allclose(people.by_camera["cam2"][3].points2d_px[0], seen_px(true_rig())[3, 1], atol=1e-9)
    assert load_uncalibrated(keypoints, SKELETON, fps=FPS, cameras=("cam3", "cam1")).camera_names == ("cam3", "cam1")


def test_one_camera_cannot_be_calibrated(keypoints: Path) -> None:
    with pytest.raises(ValueError, match=r"pose: one camera \(cam1\) cannot be calibrated; two are needed"):
        load_uncalibrated(keypoints, SKELETON, fps=FPS, cameras=("cam1",))


@pytest.mark.filterwarnings("default")
def test_3d_in_the_world_of_a_calibration_is_left_out(tmp_path: Path) -> None:
    rig, observations = fgpose.files.load_recording("balance_blazepose")
    path = tmp_path / "seen.npz"
    save_observations(observations.frames(slice(0, 3)), path)
    # Without the calibration that it was made with, and with another one.
    others = CameraRig(tuple(replace(camera, world_T_camera=np.eye(4)) for camera in rig.cameras))
    for made_with in (None, others, rig.subset(rig.names[:2])):
        with pytest.warns(
            UserWarning, match=r"seen\.npz: its per-view 3D is in the world of the calibration that it was"
        ):
            people = load_uncalibrated(path, observations.skeleton, made_with=made_with)
        assert all(image.points3d_m is None for image in people.images)


def test_3d_goes_back_to_the_cameras_that_saw_it(tmp_path: Path) -> None:
    rig, observations = fgpose.files.load_recording("balance_blazepose")
    save_observations(observations.frames(slice(0, 3)), tmp_path / "seen.npz")
    people = load_uncalibrated(tmp_path / "seen.npz", observations.skeleton, made_with=rig)
    assert observations.points3d_m is not None
    for c, name in enumerate(rig.names):
        image = people.by_camera[name][2]
        assert image.points3d_m is not None
        expected_m = rig.cameras[c].to_camera_frame(observations.points3d_m[2, c])
        # Files have single precision.
        np.testing.assert_allclose(image.points3d_m[0], expected_m, atol=1e-5)
        assert (image.points3d_m[0, :, 2] > 1.0).all()  # in front of the camera


@pytest.mark.parametrize(
    ("extents_px", "sizes_px"),
    [
        # The person of the second camera stays in the left half, which is higher than wide.
        ([(1870.0, 900.0), (800.0, 1050.0)], [(1920, 1080), (1920, 1080)]),
        # Joints that are out of sight lie a little beyond the image.
        ([(1290.0, 730.0), (600.0, 500.0)], [(1280, 720), (1280, 720)]),
        # Upright and lying images.
        ([(1900.0, 1000.0), (1050.0, 1880.0)], [(1920, 1080), (1080, 1920)]),
        ([(1900.0, 1000.0), (np.nan, np.nan)], [(1920, 1080), (1920, 1080)]),
    ],
)
@pytest.mark.filterwarnings("default")
def test_the_size_of_images_from_where_joints_are(
    extents_px: list[tuple[float, float]], sizes_px: list[tuple[int, int]]
) -> None:
    with pytest.warns(UserWarning, match="taken to be cam0 .*; if that is wrong give --size, or intrinsics"):
        assert list(likely_sizes_px(seen(*extents_px))) == sizes_px


def test_no_size_without_joints_or_for_unheard_of_images() -> None:
    with pytest.raises(ValueError, match="no joint in any camera"):
        likely_sizes_px(seen((np.nan, np.nan), (np.nan, np.nan)))
    with pytest.raises(ValueError, match=r"joints reach to \(9\d\d\d, 100\) px, further than .*; give --size"):
        likely_sizes_px(seen((9999.0, 100.0), (10.0, 10.0)))


@pytest.mark.filterwarnings("default")
def test_intrinsics_for_images_of_another_size() -> None:
    people = seen((1870.0, 1000.0), (1800.0, 900.0))
    check_sizes(people, guessed_intrinsics(people.camera_names, [(1920, 1080)] * 2))
    with pytest.raises(ValueError, match=r"camera cam0: joints reach to \(18\d\d, 99\d\) px, .* 1280 x 720.*--size"):
        check_sizes(people, guessed_intrinsics(people.camera_names, [(1280, 720)] * 2))
    with pytest.warns(UserWarning, match=r"no camera saw a joint beyond 4\d % .*--size"):
        check_sizes(people, guessed_intrinsics(people.camera_names, [(3840, 2160)] * 2))
