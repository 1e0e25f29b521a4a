"""Cameras calibrated from pictures of a board of which some are blurred by motion, through the whole chain.

    python benchmarks/board_pictures.py --seeds 3

The board of benchmarks/boards.py is rendered through lenses with their true distortion, with the blur of a lens and the
noise of a sensor, and moves during the exposure in a share of the pictures: along a random direction, by 4 to 16 px.
They are written as files, found again, their corners detected, and the rig is calibrated from them. Said are the
errors as in benchmarks/boards.py, and which pictures were left out as blurred: of those that moved, and of the others.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import cv2
import numpy as np

from fgpose.calibration.board.calibrate import CalibratedFromBoards, calibrate_from_boards
from fgpose.calibration.board.filmed import find_boards
from fgpose.calibration.board.sightings import BoardSightings
from fgpose.geometry.camera import CameraRig
from fgpose_benchmarks.synthetic.board_images import render
from fgpose_benchmarks.synthetic.boards import BoardScene, simulate_boards

from boards import errors  # isort: skip

_NOISE = 2.0  # of 255, of each pixel
_MOVED_PX = (4.0, 16.0)  # while a picture is taken
_LEAST_POINTS = 6  # of the board in the image: fewer are not rendered


def moved(image: np.ndarray, by_px: float, direction_rad: float) -> np.ndarray:
    """The mean of the image over a straight way."""
    half = int(np.ceil(by_px / 2)) + 1
    kernel = np.zeros((2 * half + 1, 2 * half + 1), np.float32)
    for along_px in np.linspace(-by_px / 2, by_px / 2, 64):
        x, y = half + along_px * np.cos(direction_rad), half + along_px * np.sin(direction_rad)
        column, row = int(x), int(y)
        for dy, dx in ((0, 0), (0, 1), (1, 0), (1, 1)):
            kernel[row + dy, column + dx] += abs(1 - dx - (x - column)) * abs(1 - dy - (y - row))
    return np.asarray(cv2.filter2D(image, -1, kernel / kernel.sum()))


def write_pictures(scene: BoardScene, folder: Path, share: float, rng: np.random.Generator) -> dict[str, set[int]]:
    """Of all cameras at all moments, in a folder for each; returns which were moved, by camera."""
    blurred: dict[str, set[int]] = {}
    for c, camera in enumerate(scene.rig.cameras):
        (folder / camera.name).mkdir()
        blurred[camera.name] = set()
        for t, pose in enumerate(scene.world_T_board):
            shown = scene.sightings.seen[t, c].sum() >= _LEAST_POINTS
            image = np.full(camera.size_px[::-1], 128, np.uint8)
            if shown:
                image = render(camera, pose, scene.sightings.board)
                if rng.random() < share:
                    image = moved(image, rng.uniform(*_MOVED_PX), rng.uniform(0, np.pi))
                    blurred[camera.name].add(t)
            noisy = image + rng.normal(0, _NOISE, image.shape)
            cv2.imwrite(str(folder / camera.name / f"{t:04d}.png"), np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
    return blurred


def left_out(sightings: BoardSightings, blurred: dict[str, set[int]]) -> tuple[int, int, int]:
    """Pictures that were named as blurred: of those that moved, of the others; and those that moved and are used."""
    named = {(each.camera, round(each.time_s)) for each in sightings.left_out if "blurred" in each.reason}
    were = {(camera, t) for camera, own in blurred.items() for t in own}
    used = {
        (sightings.camera_names[c], round(sightings.time_s[t])) for t, c in np.argwhere(sightings.shows_board).tolist()
    }
    return len(named & were), len(named - were), len(used & were)


def one(seed: int, n_cameras: int, share: float) -> tuple[CalibratedFromBoards, CameraRig, tuple[int, ...]]:
    """A rig from its pictures, the true one, how many pictures were blurred, and what left_out says."""
    scene, rng = simulate_boards(n_cameras, seed), np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as name:
        blurred = write_pictures(scene, Path(name), share, rng)
        sightings = find_boards(name, scene.sightings.board)
    counts = (sum(map(len, blurred.values())), *left_out(sightings, blurred))
    return calibrate_from_boards(sightings), scene.rig, counts


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5, help="rigs")
    parser.add_argument("--cameras", type=int, default=4)
    parser.add_argument(
        "--shares", type=float, nargs="+", default=[0.0, 0.25, 0.5], help="of pictures that are blurred"
    )
    options = parser.parse_args()
    for share in options.shares:
        found = [one(seed, options.cameras, share) for seed in range(options.seeds)]
        position_m, focal = np.swapaxes(np.array([errors(each.rig, true) for each, true, _ in found]), 0, 1)
        sigma_m = np.array([each.sigmas.position_m for each, _, _ in found])
        n_blurred, n_named, n_wrong, n_used = np.sum([counts for *_, counts in found], axis=0)
        rms_mm, rms = 1e3 * np.sqrt(np.mean(position_m**2)), np.sqrt(np.mean(focal**2))
        over = np.sqrt(np.mean((position_m / sigma_m) ** 2))
        print(
            f"{options.cameras} cameras, {options.seeds} rigs, {share:.0%} blurred: position RMS {rms_mm:.2f} mm, "
            f"focal length RMS {100 * rms:.3f} %, error over sigma {over:.2f}; of "
            f"{n_blurred} blurred pictures {n_named} left out by name, {n_used} used; {n_wrong} of the others left out",
            flush=True,
        )


if __name__ == "__main__":
    main()
