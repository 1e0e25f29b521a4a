"""From signals to clocks: correlation, shift of two cameras, clocks of all."""

from __future__ import annotations

import numpy as np
import pytest
from filmed_walk import true_offset_s, walk_scene, walk_tracks

from fgpose.calibration.from_people.starts.clocks import ClockShift, solve_clocks
from fgpose.calibration.from_people.starts.correlation import correlate, peaks
from fgpose.calibration.from_people.starts.epipolar_shift import fit_epipolar_shift
from fgpose.calibration.from_people.starts.motion_signals import MotionSignals, motion_signals
from fgpose.calibration.from_people.starts.views import View
from fgpose.calibration.from_people.walk import Track
from fgpose.estimation.noise import TELLING_HZ
from fgpose_benchmarks.synthetic import NO_CROWD_ERRORS, NO_NOISE
from fgpose_benchmarks.synthetic.uncalibrated import SimulatedClocks, SimulatedNetwork, WalkScene, film


def noise_signals(first: int, values: np.ndarray) -> MotionSignals:
    return MotionSignals(first, values, np.ones(values.shape, dtype=bool), 1.0)


def test_the_correlation_is_highest_at_the_shift_of_the_clocks() -> None:
    values = np.random.default_rng(0).standard_normal((5, 600))
    first, second = noise_signals(100, values[:, :400]), noise_signals(7, values[:, 150:])
    # What is sample 250 of the first clock is sample 7 of the second.
    correlation = correlate(first, second)
    best = correlation.score.argmax()
    assert correlation.shifts[best] == 243
    assert correlation.at(np.array([243, 10_000]))[1] == 0
    assert correlation.mirrored.at(np.array([-243]))[0] == correlation.score[best]
    second_best = correlation.score[peaks(correlation.score, 2)[1]]
    # Of 600 Gaussian numbers none is above 4.5 standard deviations; the true peak is the square root of 1250 of them.
    assert second_best < 4.5 < correlation.score[best] / 5


def test_unknown_samples_do_not_count() -> None:
    values = np.random.default_rng(1).standard_normal((5, 400))
    known = np.random.default_rng(2).random((5, 400)) < 0.5
    first = MotionSignals(0, np.where(known, values, 0.0), known, 1.0)
    correlation = correlate(first, noise_signals(0, values))
    assert correlation.shifts[correlation.score.argmax()] == 0


@pytest.mark.parametrize("in_3d", [True, False])
def test_the_motion_of_a_walker_is_recognised_in_another_view(in_3d: bool) -> None:
    scene, tracks = walk_scene(), walk_tracks()
    if not in_3d:
        tracks = tuple(Track(track.camera, track.time_s, track.points2d_px, track.confidence) for track in tracks)
    signals = [motion_signals(track, scene.observations.skeleton) for track in tracks]
    for camera in (1, 2):
        correlation = correlate(signals[0], signals[camera])
        shift_s = correlation.shifts[correlation.score.argmax()] / TELLING_HZ
        # Samples are 0.04 s apart; views from different sides see limbs that are not vertical at other moments.
        assert shift_s == pytest.approx(true_offset_s(scene, camera, 10.0), abs=0.1)


def test_an_image_that_is_turned_has_the_same_signals() -> None:
    skeleton, track = walk_scene().observations.skeleton, walk_tracks()[0]
    upright, turned_px = motion_signals(track, skeleton), track.points2d_px[..., ::-1] * np.array([-1.0, 1.0])
    turned = motion_signals(Track("a", track.time_s, turned_px, track.confidence, track.points3d_m), skeleton)
    np.testing.assert_allclose(turned.values, upright.values, atol=1e-9)


def test_without_noise_the_shift_and_the_rate_are_exact() -> None:
    scene = walk_scene()
    network = SimulatedNetwork(noise=NO_NOISE, min_bias_m=0.0, max_bias_m=0.0, mistakes=NO_CROWD_ERRORS, in_3d=False)
    exact = film(scene.motion, scene.rig, 3, network, SimulatedClocks((30.0, 25.0), 8.0, 40.0, 145.0))
    views = [_view(exact, camera) for camera in (0, 1)]
    fit = fit_epipolar_shift(views[0], views[1], true_offset_s(exact, 1, 15.0) + 0.06)
    assert fit is not None
    # Between images joints are taken to move straight on; a swinging foot is 4 mm beside its way, at 3 m/s.
    assert fit.clock.shift_s == pytest.approx(true_offset_s(exact, 1, fit.clock.middle_s), abs=1e-3)
    assert fit.misfit < 0.01


def _view(scene: WalkScene, camera: int) -> View:
    images = scene.observations.by_camera[scene.observations.camera_names[camera]]
    points2d_px = np.array([image.points2d_px[0] for image in images])
    time_s = np.array([image.time_s for image in images])
    track = Track("a", time_s, points2d_px, np.ones(points2d_px.shape[:2]))
    return View.of(track, scene.intrinsics.cameras[camera])


def test_a_wrong_moment_fits_worse() -> None:
    scene, tracks = walk_scene(), walk_tracks()
    views = [View.of(track, camera) for track, camera in zip(tracks, scene.intrinsics.cameras, strict=True)]
    right_s = true_offset_s(scene, 1, 10.0)
    right, late = (fit_epipolar_shift(views[0], views[1], right_s + by_s) for by_s in (0.0, 1.1))
    assert right is not None
    assert late is not None
    # About one gait cycle later: joints are in like places, but the walker is a metre further.
    assert right.misfit < 0.8 * late.misfit


def test_two_who_have_nothing_in_common_have_no_shift() -> None:
    scene, tracks = walk_scene(), walk_tracks()
    views = [View.of(track, camera) for track, camera in zip(tracks, scene.intrinsics.cameras, strict=True)]
    assert fit_epipolar_shift(views[0], views[1], 1000.0) is None


def exact_shift(offsets_s: np.ndarray, rates: np.ndarray, first: int, second: int, middle_s: float) -> ClockShift:
    common_s = middle_s * (1 + rates[second]) + offsets_s[second]
    of_first_s = (common_s - offsets_s[first]) / (1 + rates[first])
    rate = (1 + rates[second]) / (1 + rates[first]) - 1
    return ClockShift(of_first_s - middle_s, rate, middle_s, np.diag([1e-3, 1e-5]) ** 2)


def test_clocks_suit_all_pairs_and_one_wrong_pair_is_outvoted() -> None:
    offsets_s, rates = np.array([0.0, -12.3, 41.7, 3.3]), np.array([0.0, 1e-4, -5e-5, 2e-5])
    pairs = [(first, second) for first in range(4) for second in range(first + 1, 4)]
    shifts = {pair: exact_shift(offsets_s, rates, *pair, middle_s=30.0) for pair in pairs}
    wrong = shifts[1, 2]
    shifts[1, 2] = ClockShift(wrong.shift_s + 1.1, wrong.rate, wrong.middle_s, wrong.covariance)
    clocks = solve_clocks(shifts, 5, 0)
    # The wrong pair, a thousand sigmas off, still pulls with twice its sigma of 1 ms (Huber).
    np.testing.assert_allclose(clocks.offsets_s[:4], offsets_s, atol=2.5e-3)
    assert clocks.sigma_s[0] == 0
    assert np.isnan(clocks.offsets_s[4])
    del shifts[1, 2]
    clocks = solve_clocks(shifts, 4, 0)
    # Products of two rates are left out.
    np.testing.assert_allclose(clocks.offsets_s, offsets_s, atol=1e-5)
    np.testing.assert_allclose(clocks.rates, rates, atol=1e-7)
