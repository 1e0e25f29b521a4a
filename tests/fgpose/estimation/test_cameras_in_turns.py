"""Cameras that take turns: frames that hold one image, or in which one camera alone shows somebody."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import fgpose
from fgpose.config import Config
from fgpose.diagnosis import Severity
from fgpose.pipeline.load import load_source
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, simulate, walking

# Four cameras of 50 Hz, 5 ms apart.
FPS, N_FRAMES, N_CAMERAS = 200.0, 80, 4
TIME_S = np.arange(N_FRAMES) / FPS
IN_TURNS = np.arange(N_FRAMES)[:, None] % N_CAMERAS == np.arange(N_CAMERAS)
WITHOUT_COVARIANCE = Config(solver={"covariance": False}, online={"covariance": False})  # type: ignore[arg-type]
# 12 mm in batch and 15 online where all cameras are synchronous.
TOLERANCE_M = 0.025

Form = Callable[[fgpose.Observations, np.ndarray], fgpose.Observations]


def without_time(seen: fgpose.Observations, shows: np.ndarray) -> fgpose.Observations:
    """The other cameras have no image."""
    return showing_nobody(replace(seen, time_s=np.where(shows, TIME_S[:, None], np.nan)), shows)


def showing_nobody(seen: fgpose.Observations, shows: np.ndarray) -> fgpose.Observations:
    """The other cameras have images without anybody."""
    return replace(seen, points2d_px=np.where(shows[..., None, None], seen.points2d_px, np.nan))


@pytest.fixture(scope="module")
def seen(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> fgpose.Observations:
    """All cameras at all times."""
    truth_m = walking(N_FRAMES, FPS, skeleton)
    scene = simulate(truth_m, skeleton, rig, FPS, DetectionNoise(), NO_OCCLUSION, seed=0).observations
    return replace(scene, points3d_m=None, covariance3d_m2=None)


def error_m(time_s: np.ndarray, positions_m: np.ndarray, skeleton: fgpose.Skeleton) -> float:
    """Mean over frames and joints; NaN if one of them is not estimated."""
    truth_m = CubicSpline(TIME_S, walking(N_FRAMES, FPS, skeleton))(time_s)
    return float(np.linalg.norm(positions_m - truth_m, axis=-1).mean())


@pytest.mark.parametrize("form", [without_time, showing_nobody])
def test_their_images_make_frames(
    seen: fgpose.Observations, rig: fgpose.CameraRig, skeleton: fgpose.Skeleton, form: Form
) -> None:
    trajectory = fgpose.smooth(form(seen, IN_TURNS), rig, WITHOUT_COVARIANCE)
    assert trajectory.n_frames <= 22
    assert error_m(trajectory.time_s, trajectory.positions_m, skeleton) < TOLERANCE_M


@pytest.mark.parametrize("form", [without_time, showing_nobody])
def test_they_are_not_said_to_disagree(seen: fgpose.Observations, rig: fgpose.CameraRig, form: Form) -> None:
    """The diagnosis looks at the frames that the estimators make of them."""
    in_turns = form(seen, IN_TURNS)
    result = fgpose.smooth(in_turns, rig)
    assert fgpose.diagnose(in_turns, rig, result).worst in (None, Severity.NOTE)


@pytest.mark.slow
@pytest.mark.parametrize("form", [without_time, showing_nobody])
def test_online_they_join_frames(
    seen: fgpose.Observations, rig: fgpose.CameraRig, skeleton: fgpose.Skeleton, form: Form
) -> None:
    estimator = fgpose.Estimator(rig, skeleton, WITHOUT_COVARIANCE)
    estimates = [estimator.update(frame) for frame in form(seen, IN_TURNS)]
    # It takes 12 frames to know that cameras take turns, and 25 more to know their rate.
    later = [estimate for estimate in estimates if estimate.time_s > 0.2]
    time_s, positions_m = (np.array([getattr(each, name) for each in later]) for name in ("time_s", "positions_m"))
    assert error_m(time_s, positions_m, skeleton) < TOLERANCE_M


@pytest.mark.parametrize("form", [without_time, showing_nobody])
def test_the_images_of_several_people_make_frames(seen: fgpose.Observations, rig: fgpose.CameraRig, form: Form) -> None:
    people = fgpose.people.PeopleObservations.of_one(form(seen, IN_TURNS))
    together, _ = fgpose.calibration.on_common_clock(people, rig)
    assert together.n_frames <= 22
    assert np.median(together.n_showing) == N_CAMERAS


def test_frames_of_two_images_among_them_change_nothing(seen: fgpose.Observations, rig: fgpose.CameraRig) -> None:
    shows = IN_TURNS | (np.arange(N_FRAMES)[:, None] % 10 == 0) & (np.arange(N_CAMERAS) == 0)
    together, _ = fgpose.calibration.on_common_clock(without_time(seen, shows), rig)
    assert together.n_frames <= N_FRAMES / 2


def test_somebody_who_walks_from_camera_to_camera_stays_in_the_frames(
    seen: fgpose.Observations, rig: fgpose.CameraRig
) -> None:
    in_one_after_another = np.arange(N_FRAMES)[:, None] // (N_FRAMES // N_CAMERAS) == np.arange(N_CAMERAS)
    for form in (without_time, showing_nobody):
        given = form(seen, in_one_after_another)
        assert fgpose.calibration.on_common_clock(given, rig)[0] is given


def test_from_a_file(seen: fgpose.Observations, rig: fgpose.CameraRig, tmp_path: Path) -> None:
    fgpose.save_rig(rig, tmp_path / "rig.toml")
    fgpose.files.save_observations(without_time(seen, IN_TURNS), tmp_path / "seen.npz")
    source = load_source(tmp_path / "seen.npz", tmp_path / "rig.toml", seen.skeleton)
    assert source.observations.n_frames <= 22
