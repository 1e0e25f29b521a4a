"""Pictures of a board as a camera takes them: the print through a lens with its distortion, averaged over pixels."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from fgpose.calibration.board.board import Board
from fgpose.calibration.board.detection import opencv_charuco
from fgpose.calibration.board.lens import image_of, numbers_of
from fgpose.geometry.camera import Camera

_PX_PER_SQUARE = 40
_SUPERSAMPLED = 4  # along each side of a pixel
_GREY = 128.0  # of the room


def printed(board: Board) -> tuple[UInt8[np.ndarray, "height width"], Float[np.ndarray, " 2"]]:
    """The board from its front with a white margin of a square, and where in it the origin of its frame is; a square
    has 40 pixels."""
    image, origin_px = _black_on_white(board)
    return ~image if board.inverted else image, origin_px


def _black_on_white(board: Board) -> tuple[UInt8[np.ndarray, "height width"], Float[np.ndarray, " 2"]]:
    n, (columns, rows) = _PX_PER_SQUARE, board.size
    if board.kind == "charuco":
        image = np.asarray(opencv_charuco(board).generateImage((n * (columns + 2), n * (rows + 2)), marginSize=n))
        return image.astype(np.uint8), np.array([n, n], dtype=float)
    if board.kind == "chessboard":
        row, column = np.mgrid[0 : rows + 1, 0 : columns + 1]
        squares = np.where((row + column) % 2, 0, 255).astype(np.uint8)
        image = np.pad(np.kron(squares, np.ones((n, n), np.uint8)), n, constant_values=255)
        return image, np.array([2 * n, 2 * n], dtype=float)
    image = np.full((n * (rows + 3), n * (2 * columns + 3)), 255, np.uint8)
    origin = np.array([2 * n, 2 * n], dtype=float)
    for x, y in (board.points_m[:, :2] / board.square_m * n + origin - 0.5).tolist():
        centre = (round(x * 256), round(y * 256))
        cv2.circle(image, centre, round(0.45 * n * 256), 0, -1, cv2.LINE_AA, 8)
    return image, origin


def render(
    camera: Camera, world_T_board: Float[np.ndarray, "4 4"], board: Board, blur_px: float = 0.6
) -> UInt8[np.ndarray, "height width"]:
    """What the camera sees of the front of a board in a grey room; blur_px: standard deviation of the blur."""
    print_image, origin_px = printed(board)
    first, last = _box(camera, world_T_board, board)
    x, y = np.meshgrid(np.arange(first[0], last[0], dtype=float), np.arange(first[1], last[1], dtype=float))
    rays = camera.ray(camera.undistort(np.stack([x, y], axis=-1))) @ world_T_board[:3, :3]
    origin_m = (camera.position_m - world_T_board[:3, 3]) @ world_T_board[:3, :3]
    along = np.where(rays[..., 2] > 0, -origin_m[2] / rays[..., 2], np.nan)
    on_board_m = origin_m[:2] + along[..., None] * rays[..., :2]
    # The middle of the first pixel is at 0. Between pixels the board is where a straight line has it.
    at_px = on_board_m / board.square_m * _PX_PER_SQUARE + origin_px - 0.5
    at_px = np.where(np.isfinite(at_px), at_px, -1e4).astype(np.float32)
    finer = cv2.resize(at_px, None, fx=_SUPERSAMPLED, fy=_SUPERSAMPLED, interpolation=cv2.INTER_LINEAR)
    seen = cv2.remap(
        print_image.astype(np.float32), finer[..., 0], finer[..., 1], cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT, borderValue=_GREY,
    )  # fmt: skip
    width, height = camera.size_px
    image = np.full((height, width), _GREY, np.float32)
    image[first[1] : last[1], first[0] : last[0]] = cv2.resize(
        seen, (last[0] - first[0], last[1] - first[1]), interpolation=cv2.INTER_AREA
    )
    if blur_px:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), blur_px))
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def _box(camera: Camera, world_T_board: Float[np.ndarray, "4 4"], board: Board) -> tuple[list[int], list[int]]:
    """The part of the image in which the print is, as first and last pixel."""
    low_m, high_m = board.points_m.min(axis=0), board.points_m.max(axis=0)
    x, y = np.meshgrid(*(np.linspace(low - 2.5 * board.square_m, high + 2.5 * board.square_m, 9)
                         for low, high in zip(low_m[:2], high_m[:2], strict=True)))  # fmt: skip
    around_m = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    own_m = camera.to_camera_frame(around_m @ world_T_board[:3, :3].T + world_T_board[:3, 3])
    around_px, _, _ = image_of(own_m[own_m[:, 2] > 0.1], numbers_of(camera), camera.lens)
    size = np.array(camera.size_px)
    return (
        np.clip(np.floor(around_px.min(axis=0)), 0, size - 2).astype(int).tolist(),
        np.clip(np.ceil(around_px.max(axis=0)), 2, size).astype(int).tolist(),
    )
