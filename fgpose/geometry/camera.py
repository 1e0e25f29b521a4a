"""Calibrated cameras: intrinsics, lens distortion and pose.

Axes of a camera: x right, y down, z forward (OpenCV). ``world_T_camera`` takes points of the camera frame to the world
frame, GTSAM's direction; most calibration files store the inverse.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import gtsam
import numpy as np
from jaxtyping import Bool, Float

from fgpose.geometry.lens import LensModel, check_lens, with_distortion, without_distortion
from fgpose.geometry.rigid import check_pose, inverse, pose_of
from fgpose.geometry.vectors import norm
from fgpose.plain_files import naming
from fgpose.shown import Shown
from fgpose.shown.unknown_names import check_names

REFERENCE_FOCAL_PX = 1145.0
"""Of the cameras of Human3.6M. Parameters in pixels are those of an image with this focal length."""

_MIN_DEPTH_M = 1e-6  # keeps the division by the depth finite


@dataclass(frozen=True, eq=False, repr=False)
class Camera(Shown):
    """One calibrated camera.

    Raises:
        ValueError: the intrinsics are singular or skewed, the rotation is not a rotation, a number is not finite.
    """

    name: str
    size_px: tuple[int, int]
    """Width and height of the image that the calibration belongs to."""
    K: Float[np.ndarray, "3 3"]
    """Intrinsic matrix in pixels, without skew."""
    world_T_camera: Float[np.ndarray, "4 4"]
    """Pose of the camera in the world, metres."""
    distortion: Float[np.ndarray, " coefficients"]
    """OpenCV order: k1, k2, p1, p2[, k3[, k4, k5, k6]], or the four of the fisheye model; empty for none."""
    lens: LensModel = "pinhole"
    time_offset_s: float = 0.0
    """How much later than its time stamps say the camera takes its images."""
    start_s: float = 0.0
    """The part of time_offset_s that is not of the camera but of a recording: when that began."""
    clock_drift: float = 0.0
    """How much later still for each second of the time stamps: 0.001 if 29.97 Hz were taken for 30. What changes in
    time is accounted for by fgpose.calibration.on_common_clock, which the commands call."""
    clock_jumps: tuple[tuple[float, float], ...] = ()
    """Since when, by the time stamps, and how much later than before: 0.2 s where 6 images of 30 Hz were lost, and
    those after them numbered on."""
    moves: tuple[tuple[float, np.ndarray], ...] = ()
    """Since when, by the time stamps, in the order of time, and the pose (4, 4) that the camera has from then on."""

    def __post_init__(self) -> None:
        with naming(f"camera {self.name}"):
            for name in ("K", "world_T_camera", "distortion"):
                array = np.array(getattr(self, name), dtype=float)
                array.setflags(write=False)
                object.__setattr__(self, name, array)
                if not np.isfinite(array).all():
                    raise ValueError(f"{name} contains a number that is not finite")
            if not np.isfinite([self.time_offset_s, self.start_s, self.clock_drift, *np.ravel(self.clock_jumps)]).all():
                raise ValueError("the time offset, a drift or a jump of the clock is not finite")
            for name, shape in (("K", (3, 3)), ("world_T_camera", (4, 4)), ("distortion", (self.distortion.size,))):
                if getattr(self, name).shape != shape:
                    raise ValueError(f"{name} must be {shape}, got {getattr(self, name).shape}")
            check_lens(self.lens, self.distortion.size)
            self._check_intrinsics()
            for pose in (self.world_T_camera, *(pose for _, pose in self.moves)):
                check_pose(pose)

    def _check_intrinsics(self) -> None:
        K = self.K
        if min(self.size_px) <= 0:
            raise ValueError(f"the image size must be positive, got {self.size_px}")
        if K[0, 0] <= 0 or K[1, 1] <= 0 or not np.allclose(K[2], (0, 0, 1)):
            raise ValueError(f"K is singular or not an intrinsic matrix:\n{K}")
        if abs(K[0, 1]) > 1e-6 * K[0, 0] or abs(K[1, 0]) > 1e-6 * K[0, 0]:
            raise ValueError(f"K has a skew of {K[0, 1]:g}; only skew-free cameras are supported")

    def unchanging(self) -> Camera:
        """The same with an even clock that is not off, where it was first."""
        return replace(self, time_offset_s=0.0, start_s=0.0, clock_drift=0.0, clock_jumps=(), moves=())

    @classmethod
    def from_world_to_camera(
        cls,
        name: str,
        size_px: tuple[int, int],
        K: Float[np.ndarray, "3 3"],
        R: Float[np.ndarray, "3 3"],
        t_m: Float[np.ndarray, " 3"],
        distortion: Sequence[float] | np.ndarray = (),
        lens: LensModel = "pinhole",
    ) -> Camera:
        """Camera from the convention of most files: x_camera = R x_world + t, t in metres."""
        world_T_camera = inverse(pose_of(R, t_m))
        return cls(name, size_px, K, world_T_camera, np.asarray(distortion, dtype=float), lens)

    @property
    def position_m(self) -> Float[np.ndarray, " 3"]:
        """Centre of projection in the world frame."""
        return self.world_T_camera[:3, 3]

    @cached_property
    def camera_T_world(self) -> Float[np.ndarray, "4 4"]:
        return inverse(self.world_T_camera)

    def to_camera_frame(self, points_m: Float[np.ndarray, "*points 3"]) -> Float[np.ndarray, "*points 3"]:
        """World points in the camera frame, metres; the third coordinate is the depth."""
        return points_m @ self.camera_T_world[:3, :3].T + self.camera_T_world[:3, 3]

    def to_world_frame(self, points_m: Float[np.ndarray, "*points 3"]) -> Float[np.ndarray, "*points 3"]:
        """Points of the camera frame in the world frame, metres."""
        return points_m @ self.world_T_camera[:3, :3].T + self.position_m

    def project(self, points_m: Float[np.ndarray, "*points 3"]) -> Float[np.ndarray, "*points 2"]:
        """Undistorted pixels of world points: the pinhole image with the same K. NaN at or behind the camera."""
        normalized, _ = _normalized(self.to_camera_frame(points_m))
        return normalized * self.K[(0, 1), (0, 1)] + self.K[:2, 2]

    def ray(self, undistorted_px: Float[np.ndarray, "*points 2"]) -> Float[np.ndarray, "*points 3"]:
        """Unit directions in the world frame of the rays through undistorted pixels; they start at position_m."""
        normalized = (undistorted_px - self.K[:2, 2]) / np.diag(self.K)[:2]
        direction = np.concatenate([normalized, np.ones((*normalized.shape[:-1], 1))], axis=-1)
        direction /= norm(direction)[..., None]
        return direction @ self.world_T_camera[:3, :3].T

    @cached_property
    def distorts(self) -> bool:
        """Whether the pixels of the original image are others than the undistorted ones."""
        # A fisheye lens whose coefficients are all zero still maps the angle, not its tangent.
        return self.lens == "fisheye" or bool(self.distortion.any())

    def undistort(self, points_px: Float[np.ndarray, "*points 2"]) -> Float[np.ndarray, "*points 2"]:
        """Undistorted pixels, in double precision, of points measured in the original image.

        NaN stays NaN, and a point where the lens model has no inverse (far outside the calibrated field) becomes NaN.
        """
        if not self.distorts:
            return np.array(points_px, dtype=float)
        flat = without_distortion(np.asarray(points_px, dtype=float).reshape(-1, 2), self.K, self.distortion, self.lens)
        return flat.reshape(points_px.shape)

    def distort(self, undistorted_px: Float[np.ndarray, "*points 2"]) -> Float[np.ndarray, "*points 2"]:
        """Pixels in the original image of undistorted pixels: the inverse of undistort."""
        if not self.distorts:
            return undistorted_px.copy()
        flat = with_distortion(undistorted_px.reshape(-1, 2), self.K, self.distortion, self.lens)
        return flat.reshape(undistorted_px.shape)

    @cached_property
    def gtsam_intrinsics(self) -> gtsam.Cal3_S2:  # pyrefly: ignore[not-a-type]
        """The intrinsics of the undistorted image as GTSAM's native factors take them."""
        return gtsam.Cal3_S2(self.K[0, 0], self.K[1, 1], 0.0, self.K[0, 2], self.K[1, 2])

    @cached_property
    def gtsam(self) -> gtsam.PinholeCameraCal3_S2:  # pyrefly: ignore[not-a-type]
        """The undistorted camera as GTSAM's native factors take it."""
        return gtsam.PinholeCameraCal3_S2(gtsam.Pose3(self.world_T_camera), self.gtsam_intrinsics)


def _normalized(
    in_camera_m: Float[np.ndarray, "*points 3"],
) -> tuple[Float[np.ndarray, "*points 2"], Float[np.ndarray, "*points 1"]]:
    """Image of points in the camera frame at unit focal length, and their depth; NaN at or behind the camera."""
    depth_m = np.where(in_camera_m[..., 2:] > _MIN_DEPTH_M, in_camera_m[..., 2:], np.nan)
    return in_camera_m[..., :2] / depth_m, depth_m


@dataclass(frozen=True, eq=False, repr=False)
class CameraRig(Shown):
    """Several calibrated cameras in one world frame, in the order of every array's camera axis.

    Raises:
        ValueError: there is no camera, or two have the same name.
    """

    cameras: tuple[Camera, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "cameras", tuple(self.cameras))
        if not self.cameras:
            raise ValueError("a rig needs at least one camera")
        if len(set(self.names)) != len(self.names):
            raise ValueError(f"camera names must differ: {', '.join(self.names)}")

    @cached_property
    def names(self) -> tuple[str, ...]:
        return tuple(camera.name for camera in self.cameras)

    @property
    def n_cameras(self) -> int:
        return len(self.cameras)

    @cached_property
    def projection_matrices(self) -> Float[np.ndarray, "camera 3 4"]:
        """K [R|t] of every undistorted camera."""
        return np.stack([camera.K @ camera.camera_T_world[:3] for camera in self.cameras])

    def __getitem__(self, name: str) -> Camera:
        """A camera by name. Raises ValueError for an unknown name."""
        return self.subset([name]).cameras[0]

    def subset(self, names: Iterable[str]) -> CameraRig:
        """The named cameras, in the order given. Raises ValueError for an unknown name."""
        by_name = dict(zip(self.names, self.cameras, strict=True))
        names = tuple(names)
        check_names(names, self.names, "the calibration has no camera", "it has")
        return CameraRig(tuple(by_name[name] for name in names))

    def turned(self, rotation: Float[np.ndarray, "3 3"]) -> CameraRig:
        """The same cameras in a world that is turned: every position times this rotation."""
        turned_T_world = np.eye(4)
        turned_T_world[:3, :3] = rotation

        def turned(camera: Camera) -> Camera:
            moves = tuple((since_s, turned_T_world @ pose) for since_s, pose in camera.moves)
            return replace(camera, world_T_camera=turned_T_world @ camera.world_T_camera, moves=moves)

        return CameraRig(tuple(map(turned, self.cameras)))

    @cached_property
    def time_offsets_s(self) -> Float[np.ndarray, " camera"]:
        """How much later than its time stamps say each camera takes its images."""
        return np.array([camera.time_offset_s for camera in self.cameras])

    @cached_property
    def common_offset_s(self) -> float:
        """What all cameras are late by: the mean of their time offsets."""
        return float(self.time_offsets_s.mean())

    def without_common_offset(self) -> CameraRig:
        """The same cameras, late or early by their mean clock: theirs is the time of a frame, common_offset_s after the
        time that its stamps say."""
        return self.with_time_offsets(self.time_offsets_s - self.common_offset_s) if self.common_offset_s else self

    def with_time_offsets(self, offsets_s: Float[np.ndarray, " camera"]) -> CameraRig:
        """The same cameras with other time offsets."""
        pairs = zip(self.cameras, np.asarray(offsets_s, dtype=float).tolist(), strict=True)
        return CameraRig(tuple(replace(camera, time_offset_s=offset_s) for camera, offset_s in pairs))

    def with_starts(self, starts_s: Float[np.ndarray, " camera"]) -> CameraRig:
        """The same cameras in a recording that began at these times, with clocks that are not off otherwise."""
        pairs = zip(self.cameras, np.asarray(starts_s, dtype=float).tolist(), strict=True)
        return CameraRig(tuple(replace(camera, time_offset_s=start_s, start_s=start_s) for camera, start_s in pairs))

    def after_recording(self) -> CameraRig:
        """The same cameras as they are since: without the start, the rate and the lost images of a recording, and where
        they were left."""
        return CameraRig(
            tuple(
                replace(
                    camera.unchanging(),
                    world_T_camera=camera.moves[-1][1] if camera.moves else camera.world_T_camera,
                    time_offset_s=camera.time_offset_s - camera.start_s,
                )
                for camera in self.cameras
            )
        )

    def project_each(
        self, points_m: Float[np.ndarray, "*points camera joint 3"]
    ) -> Float[np.ndarray, "*points camera joint 2"]:
        """Undistorted pixels in every camera of its own world points; NaN behind it."""
        return np.stack([camera.project(points_m[..., c, :, :]) for c, camera in enumerate(self.cameras)], axis=-3)

    def project(self, points_m: Float[np.ndarray, "*points joint 3"]) -> Float[np.ndarray, "*points camera joint 2"]:
        """Undistorted pixels of world points in every camera; NaN behind a camera."""
        normalized, _ = _normalized(self._in_cameras(points_m))
        return normalized * self._focal_px + self._centre_px

    def px_per_m(self, points_m: Float[np.ndarray, "*points joint 3"]) -> Float[np.ndarray, "*points camera joint"]:
        """Scale of each camera's image at world points: root mean square, over the two axes of the image, of how far
        the image of a point moves at most for each metre that the point moves. NaN at or behind a camera."""
        normalized, depth_m = _normalized(self._in_cameras(points_m))
        return np.sqrt(np.vecdot(self._focal_px**2, 1 + normalized**2) / 2) / depth_m[..., 0]

    def linearized(
        self, points_m: Float[np.ndarray, "camera *points 3"]
    ) -> tuple[
        Float[np.ndarray, "camera *points 2"],
        Float[np.ndarray, "camera *points 2 3"],
        Float[np.ndarray, " camera *points"],
    ]:
        """Undistorted pixels in every camera of its own world points, their Jacobian by the point (px/m), and the depth
        of the points in metres. NaN at or behind the camera."""
        extra = (1,) * (points_m.ndim - 2)
        R = self.camera_T_world[:, :3, :3].reshape(-1, *extra, 3, 3)
        offset_m = self.camera_T_world[:, :3, 3].reshape(-1, *extra, 3)
        normalized, depth_m = _normalized((R @ points_m[..., None])[..., 0] + offset_m)
        focal_px, centre_px = (array.reshape(-1, *extra, 2) for array in (self._focal_px, self._centre_px))
        jacobian = (focal_px / depth_m)[..., None] * (R[..., :2, :] - normalized[..., None] * R[..., 2:, :])
        return normalized * focal_px + centre_px, jacobian, depth_m[..., 0]

    def _in_cameras(
        self, points_m: Float[np.ndarray, "*points joint 3"]
    ) -> Float[np.ndarray, "*points camera joint 3"]:
        """World points in the frame of every camera."""
        R, t_m = self.camera_T_world[:, :3, :3], self.camera_T_world[:, None, :3, 3]
        return points_m[..., None, :, :] @ R.swapaxes(1, 2) + t_m

    @cached_property
    def camera_T_world(self) -> Float[np.ndarray, "camera 4 4"]:
        return np.stack([camera.camera_T_world for camera in self.cameras])

    @cached_property
    def positions_m(self) -> Float[np.ndarray, "camera 3"]:
        """Of the cameras, in the world."""
        return np.stack([camera.position_m for camera in self.cameras])

    @cached_property
    def K(self) -> Float[np.ndarray, "camera 3 3"]:
        return np.stack([camera.K for camera in self.cameras])

    @cached_property
    def _focal_px(self) -> Float[np.ndarray, "camera 1 2"]:
        return np.diagonal(self.K, axis1=1, axis2=2)[:, None, :2]

    @cached_property
    def focal_px(self) -> Float[np.ndarray, " camera"]:
        """Of each camera: the geometric mean over the two axes of the image."""
        return np.sqrt(self._focal_px.prod(axis=-1))[:, 0]

    def in_own_px(self, reference_px: float) -> Float[np.ndarray, "camera 1"]:
        """A distance in an image with a focal length of REFERENCE_FOCAL_PX, in pixels of the image of each camera: the
        same angle, so that nothing depends on the resolution."""
        return (reference_px / REFERENCE_FOCAL_PX) * self.focal_px[:, None]

    @cached_property
    def _centre_px(self) -> Float[np.ndarray, "camera 1 2"]:
        return self.K[:, None, :2, 2]

    def undistort(
        self, points_px: Float[np.ndarray, "*frames camera joint 2"]
    ) -> Float[np.ndarray, "*frames camera joint 2"]:
        """Undistorted pixels of points measured in the original images."""
        return np.stack([camera.undistort(points_px[..., c, :, :]) for c, camera in enumerate(self.cameras)], axis=-3)

    def in_front(self, points_m: Float[np.ndarray, "*points 3"]) -> Bool[np.ndarray, "*points camera"]:
        """Whether each world point lies in front of each camera."""
        depths = [camera.to_camera_frame(points_m)[..., 2] for camera in self.cameras]
        return np.stack(depths, axis=-1) > _MIN_DEPTH_M
