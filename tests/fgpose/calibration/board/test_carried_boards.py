"""Cameras that were started by hand, from simulated corners of a board on its way, against the truth."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from fgpose.assessment.rig_alignment import rig_similarity
from fgpose.calibration.board.calibrate import calibrate_from_boards
from fgpose.calibration.board.lens import LensKind, numbers_of
from fgpose.calibration.board.placing import NotLinkedError
from fgpose.calibration.board.problem import BoardBundle, BoardProblem
from fgpose.calibration.board.starts.carried import CarriedBoard, calibrate_carried
from fgpose.calibration.board.starts.lags import find_starts
from fgpose.calibration.board.starts.tracks import BoardTrack, sightings_at
from fgpose.calibration.from_people.calibrated import Grade
from fgpose.geometry.camera import CameraRig
from fgpose_benchmarks.synthetic.boards import BOARD, CarriedScene, simulate_carried

FPS = 25.0
STARTS_S = (0.0, -3.217, 5.431)


def simulated(seed: int, noise_px: float = 0.2) -> CarriedScene:
    return simulate_carried(STARTS_S, seed, noise_px=noise_px, n_common=16, n_near=9, fps=FPS)


@pytest.fixture(scope="module")
def scene() -> CarriedScene:
    return simulated(0)


def coarse(scene: CarriedScene) -> list[BoardTrack]:
    """Five images a second."""
    return [replace(each, time_s=each.time_s[::5], points_px=each.points_px[::5]) for each in scene.tracks]


def carried(scene: CarriedScene, start_s: np.ndarray, n_moments: int = 240) -> CarriedBoard:
    end_s = max(float(track.time_s[-1]) + own_s for track, own_s in zip(scene.tracks, start_s.tolist(), strict=True))
    moments_s = np.linspace(start_s.min(), end_s, n_moments)
    return CarriedBoard(BOARD, scene.tracks, (1 / FPS,) * len(scene.tracks), start_s, moments_s)


def errors_m(found: CameraRig, true: CameraRig) -> np.ndarray:
    aligned = rig_similarity(found, true, with_scale=False).rig(found)
    return np.linalg.norm(aligned.positions_m - true.positions_m, axis=1)


def test_starts_are_found_from_the_motion(scene: CarriedScene) -> None:
    # A twentieth of the way from image to image: a board that is carried moves 8 mm in it.
    np.testing.assert_allclose(find_starts(coarse(scene), BOARD, scene.rig), scene.start_s, atol=0.01)


@pytest.mark.slow
def test_rig_lenses_and_starts_are_those_of_the_truth() -> None:
    """From starts that are 4 ms off."""
    scene = simulated(2)
    result = calibrate_carried(carried(scene, scene.start_s + np.array([0.0, 0.004, -0.004])), lens="pinhole")
    assert result.start_s is not None
    assert result.grade is not Grade.FAILED
    assert (np.abs(result.start_s - scene.start_s)[1:] < 3 * result.sigmas.start_s[1:]).all()
    assert (errors_m(result.rig, scene.rig) < 3 * result.sigmas.position_m).all()
    # Starts are of this recording, not of the cameras.
    np.testing.assert_array_equal(result.rig.time_offsets_s, 0.0)


@pytest.mark.slow
def test_starts_are_as_sure_as_is_said() -> None:
    """Of four rigs of three cameras."""
    of_sigma = []
    for seed in range(4):
        scene = simulated(seed)
        off = carried(scene, scene.start_s + np.array([0.0, 0.004, -0.004]))
        result = calibrate_carried(off, intrinsics=scene.rig)
        assert result.start_s is not None
        of_sigma += ((result.start_s - scene.start_s)[1:] / result.sigmas.start_s[1:]).tolist()
    # Of 8 numbers, of which pairs share the first camera, the root mean square of a true claim is 0.4 to 1.7.
    assert 0.3 < np.sqrt(np.mean(np.square(of_sigma))) < 1.7


@pytest.mark.slow
def test_without_noise_the_starts_are_exact() -> None:
    scene = simulated(1, 0.0)
    result = calibrate_carried(
        carried(scene, scene.start_s + np.array([0.0, 0.004, -0.004]), 120), intrinsics=scene.rig
    )
    assert result.start_s is not None
    # What a cubic leaves of the way between images: hundredths of a pixel at 500 px/s.
    np.testing.assert_allclose(result.start_s, scene.start_s, atol=5e-5)
    assert errors_m(result.rig, scene.rig).max() < 5e-4


def test_the_jacobian_of_the_clocks_is_that_of_differences(scene: CarriedScene) -> None:
    moments_s = np.linspace(5.0, 15.0, 6)
    seen = sightings_at(scene.tracks, BOARD, scene.start_s, moments_s, [0.06] * 3)
    result = calibrate_from_boards(
        sightings_at(scene.tracks, BOARD, scene.start_s, np.linspace(0.0, 60.0, 60), [0.06] * 3), intrinsics=scene.rig
    )
    problem = BoardProblem(seen, [LensKind(held=True)] * 3, np.full(3, 1e3))  # so large that the kernel is quadratic
    numbers = np.stack([numbers_of(camera) for camera in result.rig.cameras])
    poses = np.stack([camera.world_T_camera for camera in result.rig.cameras])
    boards = np.tile(result.world_T_board[0], (len(seen.time_s), 1, 1))
    state = replace(BoardBundle.on_time(poses, numbers, boards), late_s=np.array([0.0, 0.002, -0.003]))
    gradient, step = problem.gradient(state), 1e-5
    # Poses and clocks of two cameras: 7 unknowns each.
    for unknown in range(14):
        change = np.zeros(len(gradient))
        change[unknown] = step
        ahead, behind = (problem.error(problem.moved(state, sign * change)) for sign in (1, -1))
        assert (ahead - behind) / (2 * step) == pytest.approx(gradient[unknown], rel=1e-3, abs=1e-4)


@pytest.mark.slow
def test_a_camera_that_sees_another_motion_is_named(scene: CarriedScene) -> None:
    other = simulated(7).tracks[2]
    tracks = [*coarse(scene)[:2], replace(other, time_s=other.time_s[::5], points_px=other.points_px[::5])]
    message = "camera ring_2: at no time lag does it see the board move as the others do"
    with pytest.raises(NotLinkedError, match=re.escape(message)):
        find_starts(tracks, BOARD, scene.rig)


def test_between_images_corners_move_on_a_cubic() -> None:
    time_s = np.array([0.0, 0.04, 0.09, 0.12, 0.16, 1.0])
    way_px = 100 + 300 * time_s + 900 * time_s**2 - 2000 * time_s**3
    track = BoardTrack("cam", (640, 480), time_s, np.tile(way_px[:, None, None], (1, 24, 2)))
    at_s = np.array([0.05, 0.085, 0.13, 0.5])
    points_px, velocity = track.at(at_s, 0.06)
    expected_px = 100 + 300 * at_s + 900 * at_s**2 - 2000 * at_s**3
    np.testing.assert_allclose(points_px[:2, 0, 0], expected_px[:2], atol=1e-9)
    np.testing.assert_allclose(velocity[:2, 0, 0], (300 + 1800 * at_s - 6000 * at_s**2)[:2], atol=1e-6)
    # At the end of what was filmed there is a line only, and this is fast; then there is a gap.
    assert np.isnan(points_px[2:]).all()
