"""A board that somebody carries before cameras: near to each, and where several see it at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from fgpose.calibration.board.board import Board
from fgpose.calibration.board.lens import image_of, numbers_of
from fgpose.calibration.board.sightings import MIN_POINTS, BoardSightings
from fgpose.calibration.board.starts.tracks import BoardTrack
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.lens import LensModel
from fgpose_benchmarks.synthetic.rig import ring_rig

BOARD = Board("charuco", (7, 5), 0.09, 0.066, "DICT_5X5_100")
"""A1: 0.63 x 0.45 m."""
LENS = np.array([-0.12, 0.06, 0.0006, -0.0004, -0.01])
FISHEYE = np.array([-0.02, 0.005, -0.001, 0.0002])
_STEEPEST = 0.35  # cosine of the angle from which corners are still found
_BORDER_PX = 5
_WIDEST = {"pinhole": 1.3, "fisheye": 4.0}  # tangent of the angle to which the lens models are monotonic


@dataclass(frozen=True, eq=False)
class BoardScene:
    """What is true, and what was seen."""

    rig: CameraRig
    world_T_board: Float[np.ndarray, "moment 4 4"]
    sightings: BoardSightings


def board_rig(
    n_cameras: int, rng: np.random.Generator, model: LensModel = "pinhole", radius_m: float = 4.0
) -> CameraRig:
    """Cameras on a ring, Full HD, each with a lens that differs a little."""
    focal_px = {"pinhole": 1100.0, "fisheye": 700.0}[model]
    ring = ring_rig(n_cameras, radius_m, 1.9, focal_px=focal_px, size_px=(1920, 1080))
    distortion = LENS if model == "pinhole" else FISHEYE
    cameras = []
    for camera in ring.cameras:
        K = camera.K.copy()
        K[[0, 1], [0, 1]] *= 1 + rng.normal(0, 0.02)
        K[:2, 2] += rng.normal(0, 8.0, 2)
        own = distortion * (1 + rng.normal(0, 0.1, len(distortion)))
        cameras.append(replace(camera, K=K, distortion=own, lens=model))
    return CameraRig(tuple(cameras))


def simulate_boards(
    n_cameras: int = 4,
    seed: int = 0,
    *,
    noise_px: float = 0.2,
    n_common: int = 40,
    n_near: int = 12,
    model: LensModel = "pinhole",
    board: Board = BOARD,
    radius_m: float = 4.0,
) -> BoardScene:
    """A board lies on the floor first, is then carried through the middle, and held near to each camera.

    Args:
        n_cameras: of the ring.
        seed: of everything.
        noise_px: standard deviation of each coordinate of a corner.
        n_common: moments at which the board is in the middle of the ring.
        n_near: moments at which it is before each camera.
        model: of the lenses.
        board: which one.
        radius_m: of the ring.
    """
    rng = np.random.default_rng(seed)
    rig = board_rig(n_cameras, rng, model, radius_m)
    poses = np.stack([_on_floor(board), *_common(rig, n_common, board, rng), *_near(rig, n_near, board, rng)])
    points_px = np.stack([seen_px(rig, pose, board) for pose in poses])
    # Drawn for all corners, so that the noise of one does not depend on which others are seen.
    points_px = points_px + rng.normal(0, noise_px, points_px.shape)
    kept = np.isfinite(points_px).any(axis=(1, 2, 3))
    sizes = tuple(camera.size_px for camera in rig.cameras)
    sightings = BoardSightings(board, rig.names, sizes, np.flatnonzero(kept) * 1.0, points_px[kept])
    return BoardScene(rig, poses[kept], sightings)


@dataclass(frozen=True, eq=False)
class CarriedScene:
    """What is true, and what cameras that were started by hand saw of a board on its way."""

    rig: CameraRig
    start_s: Float[np.ndarray, " camera"]
    """When the cameras began, after the first."""
    tracks: tuple[BoardTrack, ...]


def simulate_carried(
    start_s: Sequence[float],
    seed: int = 0,
    *,
    noise_px: float = 0.2,
    n_common: int = 24,
    n_near: int = 9,
    fps: float = 25.0,
    speed_m_s: float = 0.8,
    hold_s: float = 0.5,
    board: Board = BOARD,
) -> CarriedScene:
    """A board that is carried from place to place, as in simulate_boards, and held still in each.

    Args:
        start_s: when each camera begins, seconds; the way begins at 0.
        seed: of everything.
        noise_px: standard deviation of each coordinate of a corner.
        n_common: places in the middle of the ring.
        n_near: places before each camera.
        fps: images per second of each camera; their phases differ as their starts do.
        speed_m_s: on the way, on average; a turn of a radian counts as half a metre.
        hold_s: for which it is held in each place.
        board: which one.
    """
    rng = np.random.default_rng(seed)
    rig = board_rig(len(start_s), rng)
    near, common = _near(rig, n_near, board, rng), _common(rig, n_common, board, rng)
    # All places before one pair of cameras after each other, so that both see it on its way.
    before_pairs = [common[number] for c in range(rig.n_cameras) for number in range(c, n_common, rig.n_cameras)]
    places = np.stack([_on_floor(board), *before_pairs, *near])
    way = Way(places, board, speed_m_s, hold_s)
    tracks = []
    for camera, own_start_s in zip(rig.cameras, start_s, strict=True):
        alone = CameraRig((camera,))
        time_s = np.arange(0.0, way.end_s - own_start_s, 1 / fps)
        points_px = np.stack([seen_px(alone, way.pose(at_s + own_start_s), board)[0] for at_s in time_s.tolist()])
        points_px += rng.normal(0, noise_px, points_px.shape)
        tracks.append(BoardTrack(camera.name, camera.size_px, time_s, points_px))
    return CarriedScene(rig, np.array(start_s) - start_s[0], tuple(tracks))


class Way:
    """From place to place, without jerks."""

    def __init__(self, places: Float[np.ndarray, "place 4 4"], board: Board, speed_m_s: float, hold_s: float) -> None:
        middle = board.points_m.mean(axis=0)
        self._middle = middle
        self._middles_m = places[:, :3, :3] @ middle + places[:, :3, 3]
        self._turns = Rotation.from_matrix(places[:, :3, :3])
        turned = (self._turns[:-1].inv() * self._turns[1:]).magnitude()
        moved_m = np.hypot(np.linalg.norm(np.diff(self._middles_m, axis=0), axis=1), 0.5 * turned)
        self._begin_s = np.append(0.0, np.cumsum(moved_m / speed_m_s + hold_s))
        self._hold_s = hold_s
        self.end_s = float(self._begin_s[-1] + hold_s)

    def pose(self, at_s: float) -> Float[np.ndarray, "4 4"]:
        """world_T_board; before the way it lies where that begins."""
        place = int(np.clip(np.searchsorted(self._begin_s, at_s, side="right") - 1, 0, len(self._begin_s) - 2))
        left_s, arrives_s = self._begin_s[place] + self._hold_s, self._begin_s[place + 1]
        share = float(np.clip((at_s - left_s) / (arrives_s - left_s), 0.0, 1.0))
        # Speed and acceleration are zero at both ends.
        share = share**3 * (10 - 15 * share + 6 * share**2)
        turn = (self._turns[place].inv() * self._turns[place + 1]).as_rotvec()
        R = (self._turns[place] * Rotation.from_rotvec(share * turn)).as_matrix()
        middle_m = (1 - share) * self._middles_m[place] + share * self._middles_m[place + 1]
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = R, middle_m - R @ self._middle
        return pose


def seen_px(
    rig: CameraRig, world_T_board: Float[np.ndarray, "4 4"], board: Board
) -> Float[np.ndarray, "camera point 2"]:
    """Exactly what the cameras see; NaN: not seen, or too few corners to be used."""
    in_world_m = board.points_m @ world_T_board[:3, :3].T + world_T_board[:3, 3]
    seen = np.full((rig.n_cameras, board.n_points, 2), np.nan)
    for c, camera in enumerate(rig.cameras):
        own_m = camera.to_camera_frame(in_world_m)
        image_px, _, _ = image_of(own_m, numbers_of(camera), camera.lens)
        depth_m = np.maximum(own_m[:, 2], 1e-3)
        inside = ((image_px > _BORDER_PX) & (image_px < np.array(camera.size_px) - 1 - _BORDER_PX)).all(axis=1)
        inside &= (own_m[:, 2] > 0.2) & (np.linalg.norm(own_m[:, :2], axis=1) / depth_m < _WIDEST[camera.lens])
        towards = in_world_m.mean(axis=0) - camera.position_m
        # The board is seen from its front.
        if world_T_board[:3, 2] @ towards > _STEEPEST * np.linalg.norm(towards) and inside.sum() >= MIN_POINTS:
            seen[c, inside] = image_px[inside]
    return seen


def _on_floor(board: Board) -> Float[np.ndarray, "4 4"]:
    """Face up."""
    return _about_middle(np.diag([1.0, -1.0, -1.0]), np.zeros(3), board)


def _common(rig: CameraRig, n: int, board: Board, rng: np.random.Generator) -> list[np.ndarray]:
    """In the middle, towards the gap between two cameras that stand beside each other, so that both see it."""
    poses = []
    for number in range(n):
        c = number % rig.n_cameras
        pair = rig.positions_m[[c, (c + 1) % rig.n_cameras]]
        middle_m = np.array([*rng.uniform(-0.9, 0.9, 2), rng.uniform(0.5, 1.8)])
        poses.append(_facing(middle_m, pair.mean(axis=0), rng.normal(0, 0.25, 3), board))
    return poses


def _near(rig: CameraRig, n: int, board: Board, rng: np.random.Generator) -> list[np.ndarray]:
    """All over the image of each camera."""
    poses = []
    for camera in rig.cameras:
        for number in range(n):
            column, row = number % 4, number // 4 % 3
            size = np.array(camera.size_px)
            at_px = size * (np.array([column + 0.5, row + 0.5]) / (4, 3)) + rng.normal(0, 60.0, 2)
            direction = camera.ray(np.clip(at_px, 100, size - 100)[None])[0]
            middle_m = camera.position_m + rng.uniform(0.9, 1.5) * direction
            poses.append(_facing(middle_m, camera.position_m, rng.normal(0, 0.35, 3), board))
    return poses


def _facing(
    middle_m: Float[np.ndarray, " 3"], towards_m: Float[np.ndarray, " 3"], turn: Float[np.ndarray, " 3"], board: Board
) -> Float[np.ndarray, "4 4"]:
    """The front towards a point, but for a turn."""
    into = (middle_m - towards_m) / np.linalg.norm(middle_m - towards_m)
    right = np.cross(into, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(into, right), into], axis=1) @ Rotation.from_rotvec(turn).as_matrix()
    return _about_middle(R, middle_m, board)


def _about_middle(
    R: Float[np.ndarray, "3 3"], middle_m: Float[np.ndarray, " 3"], board: Board
) -> Float[np.ndarray, "4 4"]:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = R, middle_m - R @ board.points_m.mean(axis=0)
    return pose
