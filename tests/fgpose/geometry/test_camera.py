"""Cameras: projection and distortion agree with GTSAM and OpenCV, bad calibrations are refused by name."""

from __future__ import annotations

from typing import Any, Literal

import cv2
import gtsam
import jaxtyping
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fgpose.geometry.camera import Camera, CameraRig

K = np.array([[1145.0, 0, 512.5], [0, 1143.5, 515.4], [0, 0, 1]])
R = Rotation.from_rotvec([1.3, -0.4, 0.7]).as_matrix()
T_M = np.array([0.3, -0.2, 4.5])
LENSES: dict[str, tuple[Literal["pinhole", "fisheye"], tuple[float, ...]]] = {
    "none": ("pinhole", ()),
    "pinhole 4": ("pinhole", (-0.2, 0.1, 0.001, -0.002)),
    "pinhole 5": ("pinhole", (-0.21, 0.24, -0.0009, -0.0008, -0.002)),
    "pinhole 8": ("pinhole", (-0.2, 0.12, 0.001, -0.002, 0.01, 0.02, 0.03, 0.001)),
    "fisheye": ("fisheye", (-0.02, 0.01, -0.003, 0.001)),
    "fisheye 0": ("fisheye", (0.0, 0.0, 0.0, 0.0)),
}


@pytest.fixture(params=LENSES)
def camera(request: pytest.FixtureRequest) -> Camera:
    lens, distortion = LENSES[request.param]
    return Camera.from_world_to_camera("left", (1000, 1000), K, R, T_M, distortion, lens)


@pytest.fixture
def points_m() -> np.ndarray:
    """World points within 1.2 m of the origin, all in front of the camera and within its image."""
    return np.random.default_rng(0).uniform(-0.7, 0.7, (50, 3))


def opencv_image(camera: Camera, points_m: np.ndarray) -> np.ndarray:
    projector = cv2.fisheye.projectPoints if camera.lens == "fisheye" else cv2.projectPoints
    rotation = Rotation.from_matrix(R).as_rotvec()
    image, _ = projector(points_m[:, None], rotation, T_M, camera.K, camera.distortion)
    return image[:, 0]


def test_projection_agrees_with_gtsam(camera: Camera, points_m: np.ndarray) -> None:
    expected = np.array([camera.gtsam.project(gtsam.Point3(*point)) for point in points_m])
    # The same formula in double precision; pixels of order 1e3.
    np.testing.assert_allclose(camera.project(points_m), expected, atol=1e-9)


def test_projection_into_the_original_image_agrees_with_opencv(camera: Camera, points_m: np.ndarray) -> None:
    original_px = camera.distort(camera.project(points_m))
    np.testing.assert_allclose(original_px, opencv_image(camera, points_m), atol=1e-8)


def test_undistorting_what_opencv_sees_gives_the_pinhole_image(camera: Camera, points_m: np.ndarray) -> None:
    # The iteration stops at a change of 1e-10 in normalised coordinates or pixels; it converges geometrically.
    np.testing.assert_allclose(camera.undistort(opencv_image(camera, points_m)), camera.project(points_m), atol=1e-6)


def test_distort_inverts_undistort_over_the_whole_image(camera: Camera) -> None:
    grid = np.stack(np.meshgrid(np.linspace(0, 1000, 11), np.linspace(0, 1000, 11)), axis=-1)
    np.testing.assert_allclose(camera.distort(camera.undistort(grid)), grid, atol=1e-6)


def test_rays_go_through_the_points(camera: Camera, points_m: np.ndarray) -> None:
    rays = camera.ray(camera.project(points_m))
    towards = points_m - camera.position_m
    np.testing.assert_allclose(rays, towards / np.linalg.norm(towards, axis=1, keepdims=True), atol=1e-12)


def test_frames_are_inverse_to_each_other(camera: Camera, points_m: np.ndarray) -> None:
    np.testing.assert_allclose(camera.to_camera_frame(points_m), points_m @ R.T + T_M, atol=1e-12)
    np.testing.assert_allclose(camera.to_world_frame(camera.to_camera_frame(points_m)), points_m, atol=1e-12)
    np.testing.assert_allclose(camera.world_T_camera @ camera.camera_T_world, np.eye(4), atol=1e-12)


def test_the_scale_of_the_image_is_how_far_a_point_moves_in_it(camera: Camera, points_m: np.ndarray) -> None:
    step_m = 1e-5
    jacobian = [(camera.project(points_m + step_m * axis) - camera.project(points_m)) / step_m for axis in np.eye(3)]
    # Of each axis of the image, the norm over the directions of the world. Differences are exact to 1e-5.
    expected = np.sqrt(np.mean(np.sum(np.square(jacobian), axis=0), axis=-1))
    np.testing.assert_allclose(CameraRig((camera,)).px_per_m(points_m)[0], expected, rtol=1e-4)
    behind_m = camera.position_m - points_m[:1] - 10 * camera.world_T_camera[:3, 2]
    assert np.isnan(CameraRig((camera,)).px_per_m(behind_m)).all()


def test_nothing_is_projected_at_or_behind_the_camera(camera: Camera) -> None:
    behind = camera.to_world_frame(np.array([[0.1, 0.2, -3.0], [0.0, 0.0, 0.0], [0.0, 0.0, 2.0]]))
    image = camera.project(behind)
    assert np.isnan(image[:2]).all()
    np.testing.assert_allclose(image[2], K[:2, 2], atol=1e-9)
    in_front = CameraRig((camera,)).in_front(behind)
    assert in_front.tolist() == [[False], [False], [True]]


def test_missing_points_stay_missing(camera: Camera) -> None:
    some = np.array([[[np.nan, np.nan], [500.0, 400.0]]])
    for image in (camera.undistort(some), camera.distort(some)):
        assert image.shape == some.shape
        assert np.isnan(image[0, 0]).all()
        assert np.isfinite(image[0, 1]).all()
    assert np.isnan(camera.undistort(some[:, :1])).all()


@pytest.mark.parametrize(
    ("lens", "distortion"), [("pinhole", (-0.3, 0.1, 0.001, -0.002, -0.02)), ("fisheye", (-0.5, 0.1, 0.0, 0.0))]
)
def test_a_point_that_no_undistorted_point_maps_to_is_missing(lens: Any, distortion: tuple[float, ...]) -> None:
    wide = Camera("wide", (1000, 1000), np.diag([500.0, 500.0, 1.0]), np.eye(4), np.array(distortion), lens)
    image = wide.undistort(np.array([[900.0, 0.0], [100.0, 0.0]]))
    assert np.isnan(image[0]).all()
    assert np.isfinite(image[1]).all()


def test_arrays_are_copied_and_frozen() -> None:
    intrinsics = K.copy()
    camera = Camera("left", (1000, 1000), intrinsics, np.eye(4), np.zeros(5))
    intrinsics[0, 0] = 1.0
    assert camera.K[0, 0] == K[0, 0]
    with pytest.raises(ValueError, match="read-only"):
        camera.K[0, 0] = 1.0


def changed(matrix: np.ndarray, index: tuple[int, int], value: float) -> np.ndarray:
    copy = matrix.copy()
    copy[index] = value
    return copy


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"K": changed(K, (0, 0), 0.0)}, "K is singular"),
        ({"K": changed(K, (1, 1), -1000.0)}, "K is singular"),
        ({"K": changed(K, (2, 2), 2.0)}, "K is singular or not an intrinsic matrix"),
        ({"K": changed(K, (0, 1), 3.0)}, "K has a skew of 3;"),
        ({"K": changed(K, (0, 2), np.nan)}, "K contains a number that is not finite"),
        ({"world_T_camera": np.diag([1.0, 1.0, -1.0, 1.0])}, "not a rotation matrix, it mirrors"),
        ({"world_T_camera": np.diag([2.0, 2.0, 2.0, 1.0])}, "not a rotation matrix"),
        ({"world_T_camera": changed(np.eye(4), (3, 0), 1.0)}, "last row of the pose must be 0 0 0 1"),
        ({"world_T_camera": changed(np.eye(4), (0, 3), np.inf)}, "world_T_camera contains a number that is not finite"),
        ({"distortion": np.zeros(3)}, "a pinhole lens takes 0, 4, 5, 8 coefficients, got 3"),
        ({"distortion": np.zeros(5), "lens": "fisheye"}, "a fisheye lens takes 4 coefficients, got 5"),
        ({"distortion": np.array([0, 0, 0, np.nan])}, "distortion contains a number that is not finite"),
        ({"size_px": (0, 1000)}, "image size must be positive"),
    ],
)
def test_a_bad_calibration_is_one_error_that_names_the_camera(change: dict[str, Any], message: str) -> None:
    good: dict[str, Any] = {"size_px": (1000, 1000), "K": K, "world_T_camera": np.eye(4), "distortion": np.zeros(0)}
    with pytest.raises(ValueError, match=f"camera left: .*{message}"):
        Camera("left", **(good | change))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"K": np.eye(2)}, r"K must be \(3, 3\), got \(2, 2\)"),
        ({"world_T_camera": np.eye(4)[:3]}, r"world_T_camera must be \(4, 4\), got \(3, 4\)"),
        ({"distortion": np.zeros((1, 5))}, r"distortion must be \(5,\), got \(1, 5\)"),
        ({"lens": "omnidirectional"}, "unknown lens 'omnidirectional'; known: pinhole, fisheye"),
    ],
)
def test_without_type_checks_a_wrong_shape_is_the_same_error(
    change: dict[str, Any], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the tests the annotations are checked first; in production nothing else stands before a wrong shape."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    good: dict[str, Any] = {"size_px": (1000, 1000), "K": K, "world_T_camera": np.eye(4), "distortion": np.zeros(0)}
    with pytest.raises(ValueError, match=f"camera left: {message}"):
        Camera("left", **(good | change))


def test_a_rig_projects_into_every_camera(rig: CameraRig) -> None:
    points_m = np.random.default_rng(0).uniform(-0.5, 0.5, (5, 17, 3)) + np.array([0, 0, 1])
    image = rig.project(points_m)
    assert image.shape == (5, 4, 17, 2)
    homogeneous = np.concatenate([points_m, np.ones((5, 17, 1))], axis=-1)
    for number, camera in enumerate(rig.cameras):
        np.testing.assert_array_equal(image[:, number], camera.project(points_m))
        by_matrix = homogeneous @ rig.projection_matrices[number].T
        np.testing.assert_allclose(image[:, number], by_matrix[..., :2] / by_matrix[..., 2:], atol=1e-9)
    np.testing.assert_array_equal(rig.undistort(image), image)


def test_cameras_are_chosen_by_name(rig: CameraRig) -> None:
    chosen = rig.subset((rig.names[2], rig.names[0]))
    assert chosen.cameras == (rig.cameras[2], rig.cameras[0])
    with pytest.raises(ValueError, match="no camera top; it has ring_0, ring_1"):
        rig.subset(["top"])
    assert rig[rig.names[2]] is rig.cameras[2]
    for unknown in ("top", 0):
        wrong: Any = unknown
        with pytest.raises(ValueError, match=f"no camera {unknown}; it has ring_0, ring_1"):
            rig[wrong]


def test_a_rig_needs_cameras_with_different_names(rig: CameraRig) -> None:
    with pytest.raises(ValueError, match="at least one camera"):
        CameraRig(())
    with pytest.raises(ValueError, match="names must differ: ring_0, ring_0"):
        CameraRig((rig.cameras[0], rig.cameras[0]))


@pytest.fixture
def several() -> CameraRig:
    """Three cameras around the points, of different lenses and focal lengths."""
    cameras = []
    for number, angle in enumerate((0.0, 2.0, 4.0)):
        turned = Rotation.from_rotvec([0.2, angle, 0.1]).as_matrix()
        K_own = np.diag([1000.0 + 100 * number, 1050.0, 1.0])
        K_own[:2, 2] = 500.0, 480.0 + number
        cameras.append(Camera.from_world_to_camera(f"c{number}", (1000, 1000), K_own, turned, T_M))
    return CameraRig(tuple(cameras))


def test_linearized_is_the_projection_of_own_points(several: CameraRig) -> None:
    own_m = np.random.default_rng(0).uniform(-0.7, 0.7, (3, 4, 5, 3))
    pixels, jacobian, depth_m = several.linearized(own_m)
    assert jacobian.shape == (3, 4, 5, 2, 3)
    for c, camera in enumerate(several.cameras):
        # The same formula in another order of sums.
        np.testing.assert_allclose(pixels[c], camera.project(own_m[c]), atol=1e-9)
        np.testing.assert_allclose(depth_m[c], camera.to_camera_frame(own_m[c])[..., 2], atol=1e-12)


def test_linearized_has_the_jacobian_of_the_projection(several: CameraRig) -> None:
    own_m, step_m = np.random.default_rng(1).uniform(-0.7, 0.7, (3, 20, 3)), 1e-5
    _, jacobian, _ = several.linearized(own_m)
    for axis in range(3):
        change_m = step_m * np.eye(3)[axis]
        after, before = (several.linearized(own_m + sign * change_m)[0] for sign in (1, -1))
        # Central differences err by the third derivative times step^2, 1e-8 px/m, and by rounding: 1e-13 / 1e-5.
        np.testing.assert_allclose(jacobian[..., axis], (after - before) / (2 * step_m), atol=1e-5)


def test_linearized_is_not_known_behind_the_camera(several: CameraRig) -> None:
    """Of one camera only: the others see the point."""
    camera = several.cameras[1]
    behind_m = np.zeros((3, 2, 3))
    behind_m[1, 0] = camera.position_m - camera.world_T_camera[:3, 2]
    behind_m[1, 1] = camera.position_m
    pixels, jacobian, depth_m = several.linearized(behind_m)
    for values in (pixels, jacobian, depth_m):
        assert np.isnan(values[1]).all()
        assert np.isfinite(values[[0, 2]]).all()


def test_focal_length_of_a_rig(several: CameraRig) -> None:
    np.testing.assert_allclose(several.focal_px, np.sqrt(1050.0 * np.array([1000.0, 1100.0, 1200.0])))
