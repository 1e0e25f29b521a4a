"""A real chessboard before a real pair of cameras: fgpose and OpenCV, each on a half of the images.

    python benchmarks/real_boards.py --splits 12

Of each half a rig is calibrated. It is used to place the board in the images of the other half, where the remaining
reprojection errors are compared; and what the rigs of both halves say is compared with what they state, in standard
deviations (1 is right, more is too optimistic). OpenCV gets the same corners: calibrateCamera, then stereoCalibrate
with all free.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from scipy.optimize import least_squares

from fgpose.assessment.rig_alignment import rig_similarity
from fgpose.assessment.rigs import angle_deg
from fgpose.calibration.board.board import load_board
from fgpose.calibration.board.calibrate import CalibratedFromBoards, calibrate_from_boards
from fgpose.calibration.board.filmed import find_boards
from fgpose.calibration.board.sightings import BoardSightings

IMAGES, BOARD = Path(__file__).parents[1] / "tests/data/opencv_stereo", "chessboard:9x6:25mm"
Stereo = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Both lenses (K, distortion), then rotation and translation from the first camera to the second."""


def by_opencv(sightings: BoardSightings) -> Stereo:
    """Least squares, the five coefficients that are its default."""
    points_m = [sightings.board.points_m.astype(np.float32)] * len(sightings.time_s)
    points_px = [list(sightings.points_px[:, c].astype(np.float32)) for c in range(2)]
    size_px = sightings.sizes_px[0]
    left, right = (cv2.calibrateCamera(points_m, each, size_px, np.eye(3), np.zeros(5))[1:3] for each in points_px)
    flags = cv2.CALIB_USE_INTRINSIC_GUESS
    found = cv2.stereoCalibrate(points_m, points_px[0], points_px[1], *left, *right, size_px, flags=flags)
    return found[1], found[2], found[3], found[4], found[5], found[6].ravel()


def as_stereo(found: CalibratedFromBoards) -> Stereo:
    left, right = found.rig.cameras
    right_T_left = np.linalg.inv(right.world_T_camera) @ left.world_T_camera
    return left.K, left.distortion, right.K, right.distortion, right_T_left[:3, :3], right_T_left[:3, 3]


def held_out_px(stereo: Stereo, sightings: BoardSightings) -> np.ndarray:
    """Reprojection errors of views that the rig was not made from, each board placed where it fits both cameras."""
    left_K, left_lens, right_K, right_lens, rotation, translation = stereo
    points_m = sightings.board.points_m

    def errors_px(pose: np.ndarray, seen_px: np.ndarray) -> np.ndarray:
        turned, _ = cv2.Rodrigues(rotation @ cv2.Rodrigues(pose[:3])[0])
        left_px, _ = cv2.projectPoints(points_m, pose[:3], pose[3:], left_K, left_lens)
        right_px, _ = cv2.projectPoints(points_m, turned, rotation @ pose[3:] + translation, right_K, right_lens)
        return (np.stack([left_px[:, 0], right_px[:, 0]]) - seen_px).ravel()

    lengths = []
    for seen_px in sightings.points_px:
        _, turn, place = cv2.solvePnP(points_m, seen_px[0], left_K, left_lens)
        start = np.concatenate([turn.ravel(), place.ravel()])
        # A kernel, so that a corner that was found wrongly does not decide where its board is.
        fitted = least_squares(errors_px, start, loss="soft_l1", args=(seen_px,))
        lengths.append(np.linalg.norm(errors_px(fitted.x, seen_px).reshape(-1, 2), axis=1))
    return np.concatenate(lengths)


def halves(sightings: BoardSightings, seed: int) -> list[BoardSightings]:
    """The moments split at random."""
    order = np.random.default_rng(seed).permutation(len(sightings.time_s))
    return [sightings.at_moments(np.sort(part)) for part in np.array_split(order, 2)]


def in_sigmas(one: CalibratedFromBoards, other: CalibratedFromBoards) -> np.ndarray:
    """Differences of focal lengths, places and directions in the standard deviations that both state."""
    moved = rig_similarity(one.rig, other.rig, with_scale=False).rig(one.rig)
    apart_m = np.linalg.norm(moved.positions_m - other.rig.positions_m, axis=1)
    cameras = zip(moved.cameras, other.rig.cameras, strict=True)
    turned_deg = [angle_deg(a.world_T_camera[:3, :3], b.world_T_camera[:3, :3]) for a, b in cameras]
    differences = one.rig.focal_px / other.rig.focal_px - 1, apart_m, np.array(turned_deg)
    stated = [np.hypot(*pair) for pair in zip(*(_stated(each) for each in (one, other)), strict=True)]
    return np.array([np.abs(difference) / sigma for difference, sigma in zip(differences, stated, strict=True)])


def _stated(found: CalibratedFromBoards) -> tuple[np.ndarray, ...]:
    return found.sigmas.focal, found.sigmas.position_m, found.sigmas.direction_deg


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--splits", type=int, default=12, help="how often the images are split at random")
    splits = parser.parse_args(arguments).splits
    sightings = find_boards(IMAGES, load_board(BOARD))
    errors_px: dict[str, list[np.ndarray]] = {"fgpose": [], "OpenCV": []}
    apart, disagreements = [], []
    for seed in range(splits):
        parts = halves(sightings, seed)
        found = [calibrate_from_boards(part) for part in parts]
        for other, rig, own in zip(reversed(parts), found, parts, strict=True):
            errors_px["fgpose"].append(held_out_px(as_stereo(rig), other))
            errors_px["OpenCV"].append(held_out_px(by_opencv(own), other))
        apart.append(in_sigmas(found[0], found[1]))
        disagreements += [rig.sigmas.disagreement for rig in found]
    for name, values_px in errors_px.items():
        rms_px, median_px = np.mean([(np.sqrt(np.mean(each**2)), np.median(each)) for each in values_px], axis=0)
        print(f"{name}: held out, RMS {rms_px:.3f} px, median {median_px:.3f} px")
    for what, values in zip(("focal length", "place", "direction"), np.swapaxes(apart, 0, 1), strict=True):
        rms, within = np.sqrt(np.mean(values**2)), 100 * np.mean(values < 2)
        print(f"{what}: halves differ by {rms:.2f} sigma (RMS), {within:.0f} % within two")
    print(f"sigmas are {np.median(disagreements):.2f} times those of the corners' noise (median)")


if __name__ == "__main__":
    main()
