"""Rooms with cameras: lenses of real cameras in the places where people put them, and the floor that is walked on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import Camera, CameraRig
from fgpose_benchmarks.synthetic.rig import look_at


@dataclass(frozen=True)
class StudioLens:
    """Intrinsics of a real camera."""

    size_px: tuple[int, int]
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    distortion: tuple[float, ...]
    """k1, k2, p1, p2[, k3]."""

    def camera(self, name: str, world_T_camera: Float[np.ndarray, "4 4"]) -> Camera:
        K = np.array([[self.focal_px[0], 0, self.centre_px[0]], [0, self.focal_px[1], self.centre_px[1]], [0, 0, 1]])
        return Camera(name, self.size_px, K, world_T_camera, np.array(self.distortion))

    @property
    def upright(self) -> StudioLens:
        """The camera turned by 90 degrees, clockwise as seen from behind it."""
        (width, height), (fx, fy), (cx, cy) = self.size_px, self.focal_px, self.centre_px
        k1, k2, p1, p2, *rest = self.distortion
        # New x is old y, new y is minus old x: so are the axes of the tangential distortion (p2 along x, p1 along y).
        return StudioLens((height, width), (fy, fx), (cy, width - cx), (k1, k2, -p2, p1, *rest))


# Human3.6M, cameras 54138969, 55011271, 58860488 and 60457274, rounded (Ionescu et al., 2014).
H36M = (
    StudioLens((1000, 1002), (1145.05, 1143.78), (512.54, 515.45), (-0.2071, 0.2478, -0.00098, -0.00142, -0.0031)),
    StudioLens((1000, 1000), (1149.68, 1147.59), (508.85, 508.06), (-0.1942, 0.2404, -0.00162, -0.00274, 0.0068)),
    StudioLens((1000, 1000), (1149.14, 1148.80), (519.82, 501.40), (-0.2083, 0.2555, 0.00148, -0.00076, -0.0025)),
    StudioLens((1000, 1002), (1145.51, 1144.77), (514.97, 501.88), (-0.1984, 0.2183, -0.00059, -0.00181, -0.0089)),
)
# The recordings balance_openpose and balance_blazepose, in portrait: cam_01 and cam_03.
BALANCE = (
    StudioLens((1088, 1920), (1681.24, 1681.08), (532.97, 948.14), (-0.00072, 0.00219, 0.0000095, 0.0000108)),
    StudioLens((1088, 1920), (1681.60, 1681.51), (513.21, 955.01), (-0.00073, 0.00215, -0.0000085, -0.0000081)),
)
# Webcams of the session 4_cam_recording of caliscope, cam_0 and cam_2; the mean of fx and fy would do as well.
WEBCAM = (
    StudioLens((1280, 720), (894.53, 896.88), (624.01, 361.28), (-0.3384, 0.0967, -0.00135, 0.00316, -0.0037)),
    StudioLens((1280, 720), (637.23, 633.57), (657.43, 378.18), (0.1695, -0.2495, -0.00075, 0.01251, 0.1562)),
)


@dataclass(frozen=True, eq=False)
class Studio:
    """Cameras and the floor that people walk on, around the origin of the world."""

    name: str
    description: str
    """In a sentence without a full stop."""
    rig: CameraRig
    floor_m: tuple[float, float]
    """Along x and y, walls included that nobody walks near to."""


# Nobody points all cameras at one spot, nor levels a tripod exactly.
_AIMS_M = np.array([(0.3, -0.2, 0.9), (-0.2, 0.3, 1.0), (0.1, 0.25, 0.8), (-0.3, -0.1, 1.05), (0.2, 0.0, 0.95)])
_ROLLS_DEG = (2.0, -1.5, 0.5, -3.0, 1.0)


def _placed(positions_m: Float[np.ndarray, "camera 3"], lenses: tuple[StudioLens, ...]) -> CameraRig:
    """Cameras that look at about the middle of a body at the origin, with the lenses in turn."""
    cameras = []
    for number, position_m in enumerate(positions_m):
        world_T_camera = look_at(position_m, _AIMS_M[number % len(_AIMS_M)])
        roll = np.deg2rad(_ROLLS_DEG[number % len(_ROLLS_DEG)])
        turn = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
        world_T_camera[:3, :3] = world_T_camera[:3, :3] @ turn
        cameras.append(lenses[number % len(lenses)].camera(f"cam_{number + 1}", world_T_camera))
    return CameraRig(tuple(cameras))


def _on_circle(
    n_cameras: int, radii_m: tuple[float, ...], heights_m: tuple[float, ...], arc_deg: float = 360.0
) -> Float[np.ndarray, "camera 3"]:
    """Evenly on an arc around the origin, radii and heights in turn; an arc of less than 360 degrees has a camera at
    each end."""
    step_deg = arc_deg / n_cameras if arc_deg == 360.0 else arc_deg / (n_cameras - 1)
    azimuth = np.deg2rad(30.0 + step_deg * np.arange(n_cameras))
    radius_m, height_m = (np.resize(np.array(values), n_cameras) for values in (radii_m, heights_m))
    return np.stack([radius_m * np.cos(azimuth), radius_m * np.sin(azimuth), height_m], axis=-1)


_MIXED = (H36M[0], BALANCE[0], WEBCAM[0], BALANCE[1], WEBCAM[1].upright)
_CORNERS_M = np.array([(2.8, 2.3, 2.4), (-2.8, 2.3, 2.4), (-2.8, -2.3, 2.4), (2.8, -2.3, 2.4)])


# World to camera of balance_openpose: rotation vectors, and translations in metres; and where the man stands.
_BALANCE_TURNS = (
    (1.6883, 1.0483, -0.4196),
    (1.3498, 1.5964, -1.1983),
    (0.8110, -2.1972, 1.3760),
    (1.4046, -1.3887, 0.4254),
)
_BALANCE_OFFSETS_M = (
    (0.3211, 0.9563, 2.8907),
    (-0.1115, 0.7766, 3.0676),
    (-0.7935, 0.3228, 4.3535),
    (0.5030, 0.0489, 4.4066),
)
_BALANCE_MAN_M = np.array([-0.96, 0.0, 0.0])


def _balance_rig() -> CameraRig:
    """The cameras of a real recording, around the man in it."""
    from scipy.spatial.transform import Rotation

    cameras = []
    for number, (turn, offset_m) in enumerate(zip(_BALANCE_TURNS, _BALANCE_OFFSETS_M, strict=True)):
        R = Rotation.from_rotvec(turn).as_matrix()
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = R.T, -R.T @ np.array(offset_m) - _BALANCE_MAN_M
        cameras.append(BALANCE[number // 2].camera(f"cam_{number + 1}", pose))
    return CameraRig(tuple(cameras))


STUDIOS = (
    Studio(
        "ring_3",
        "Three Human3.6M cameras on a ring, 1.5 m high",
        _placed(_on_circle(3, (4.5,), (1.5,)), H36M),
        (4.0, 4.0),
    ),
    Studio(
        "ring_4",
        "Four Human3.6M cameras on a ring, 1.7 m high",
        _placed(_on_circle(4, (4.5,), (1.7,)), H36M),
        (4.2, 4.2),
    ),
    Studio(
        "ring_8",
        "Eight cameras of six kinds on two rings, 2.7 and 1.2 m high",
        _placed(_on_circle(8, (4.5, 5.5), (2.7, 1.2)), (*H36M, *BALANCE)),
        (4.0, 4.0),
    ),
    Studio(
        "equal_4",
        "Four cameras with the same lens on two rings, 1.3 and 2.2 m high",
        _placed(_on_circle(4, (4.4, 5.0), (1.3, 2.2)), H36M[:1]),
        (4.2, 4.2),
    ),
    Studio(
        "balance_4",
        "The four portrait cameras of balance_openpose: a narrow view of a small floor",
        _balance_rig(),
        (2.6, 2.6),
    ),
    Studio(
        "mixed_5",
        "Five cameras, portrait and landscape, with four focal lengths, 0.8 to 2.2 m high",
        _placed(_on_circle(5, (4.2, 5.0, 3.6), (1.4, 2.2, 0.8)), _MIXED),
        (3.6, 3.6),
    ),
    Studio(
        "corners_4",
        "Webcams of two kinds in the corners of a room of 5.6 x 4.6 m, 2.4 m high",
        _placed(_CORNERS_M, WEBCAM),
        (4.4, 3.6),
    ),
    Studio(
        "corners_3",
        "Webcams of two kinds in three corners of a room of 5.6 x 4.6 m, 2.4 m high",
        _placed(_CORNERS_M[:3], WEBCAM),
        (4.4, 3.6),
    ),
    Studio(
        "one_sided_4",
        "Four Human3.6M cameras on an arc of 150 degrees",
        _placed(_on_circle(4, (4.8,), (1.3, 1.8), 150.0), H36M),
        (4.0, 4.0),
    ),
    Studio(
        "one_sided_6",
        "Six cameras of three kinds on an arc of 120 degrees",
        _placed(_on_circle(6, (5.0,), (1.2, 2.0, 1.6), 120.0), (*H36M[:2], WEBCAM[0])),
        (3.8, 3.8),
    ),
    Studio(
        "pair",
        "Two Human3.6M cameras, 75 degrees apart",
        _placed(_on_circle(2, (4.5,), (1.5,), 75.0), H36M),
        (3.8, 3.8),
    ),
)


def find_studio(name: str) -> Studio:
    """A studio by name. Raises ValueError, which lists them, for an unknown one."""
    for studio in STUDIOS:
        if studio.name == name:
            return studio
    raise ValueError(f"no studio {name!r}; there is {', '.join(studio.name for studio in STUDIOS)}")
