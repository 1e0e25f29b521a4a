"""A board before small cameras, rendered: few images, quickly found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from fgpose.calibration.board.board import Board
from fgpose.geometry.camera import Camera, CameraRig
from fgpose_benchmarks.synthetic.board_images import render
from fgpose_benchmarks.synthetic.boards import Way, simulate_boards

FILMED = Board("charuco", (6, 5), 0.16, 0.12, "DICT_4X4_50")
SHRUNK = 3.0  # Full HD becomes 640 x 360


def small(camera: Camera) -> Camera:
    """The same camera with smaller images."""
    K = camera.K.copy()
    # The middle of the first pixel is at 0.
    K[:2] /= SHRUNK
    K[:2, 2] += (1 / SHRUNK - 1) / 2
    width, height = camera.size_px
    return replace(camera, K=K, size_px=(round(width / SHRUNK), round(height / SHRUNK)))


def film(folder: Path, n_common: int = 6, seed: int = 3) -> CameraRig:
    """A folder of images for each of two cameras that stand side by side in a ring of four. Returns the true rig."""
    scene = simulate_boards(4, seed, board=FILMED, n_common=4 * n_common, n_near=6, radius_m=2.2)
    rig = CameraRig(tuple(small(camera) for camera in scene.rig.cameras[:2]))
    seen = scene.sightings.shows_board[:, :2]
    # The board on the floor, in the gap between both, and near to each of them.
    common = 1 + 4 * np.arange(n_common)
    moments = [0, *common.tolist(), *range(1 + 4 * n_common, 1 + 4 * n_common + 12)]
    for c, camera in enumerate(rig.cameras):
        (folder / camera.name).mkdir(parents=True)
        for number, t in enumerate(moments):
            width, height = camera.size_px
            image = np.full((height, width), 128, np.uint8)
            if seen[t, c]:
                image = render(camera, scene.world_T_board[t], FILMED, 0.5)
            cv2.imwrite(str(folder / camera.name / f"{number:03d}.png"), image)
    return rig


def film_carried(folder: Path, starts_s: tuple[float, float], fps: float = 10.0, seed: int = 3) -> CameraRig:
    """A video of each of two such cameras, which begin when they do, of the board on its way through the gap between
    both. Returns the true rig."""
    scene = simulate_boards(4, seed, board=FILMED, n_common=28, n_near=0, radius_m=2.2)
    rig = CameraRig(tuple(small(camera) for camera in scene.rig.cameras[:2]))
    seen = scene.sightings.shows_board[:, :2].all(axis=1)
    way = Way(scene.world_T_board[np.flatnonzero(seen)[:6]], FILMED, 0.4, 0.3)
    folder.mkdir(parents=True)
    for camera, start_s in zip(rig.cameras, starts_s, strict=True):
        path = str(folder / f"{camera.name}.mp4")
        video = cv2.VideoWriter(path, cv2.VideoWriter.fourcc(*"mp4v"), fps, camera.size_px)
        for at_s in np.arange(start_s, way.end_s, 1 / fps).tolist():
            image = render(camera, way.pose(at_s), FILMED, 0.5)
            video.write(np.repeat(image[..., None], 3, axis=2))
        video.release()
    return rig
