from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from fgpose.assessment.metrics import mpjpe_m
from fgpose.config import Config, MotionConfig, OnlineConfig
from fgpose.estimation.estimator import Estimator
from fgpose.estimation.process_noise import RunningDensity, process_density
from fgpose.estimation.smoother import smooth
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, Scene, motion_from_npz, simulate
from tests.conftest import MOCAP

CONFIG = MotionConfig()
FPS = 50.0
PER_S = 1e6  # information of three cameras with errors of 12 mm at 50 Hz, 1/(m^2 s)


def density_of(
    positions_m: np.ndarray, time_s: np.ndarray, config: MotionConfig = CONFIG, per_s: float = PER_S
) -> np.ndarray:
    """Of frames that bring this information per second, however many they are."""
    step_s = np.gradient(time_s) if len(time_s) > 1 else np.ones(1)
    return process_density(positions_m, time_s, np.repeat(per_s * step_s[:, None], positions_m.shape[1], 1), config)


def swinging(amplitude_m: float, hertz: float, time_s: np.ndarray) -> np.ndarray:
    """One joint that swings along x."""
    positions_m = np.zeros((len(time_s), 1, 3))
    positions_m[:, 0, 0] = amplitude_m * np.sin(2 * np.pi * hertz * time_s)
    return positions_m


def measured_and_smoothed_m(
    density: float, assumed: float, fps: float, per_s: float, n_frames: int, rng: np.random.Generator
) -> np.ndarray:
    """What a Kalman smoother (Rauch, Tung, Striebel) leaves of a motion with white acceleration, which it assumes to
    have another density; an independent implementation."""
    step_s, error_m2 = 1 / fps, fps / per_s
    move = np.array([[1.0, step_s], [0.0, 1.0]])
    noise = np.array([[step_s**3 / 3, step_s**2 / 2], [step_s**2 / 2, step_s]])
    state, pushes = np.zeros((2, 4, 3)), np.linalg.cholesky(density * noise)
    measured_m = np.empty((n_frames, 4, 3))
    for frame in range(n_frames):
        measured_m[frame] = state[0] + rng.normal(size=(4, 3)) * np.sqrt(error_m2)
        state = np.tensordot(move, state, 1) + np.tensordot(pushes, rng.normal(size=(2, 4, 3)), 1)
    means, covariances, predicted, predictions = [], [], [], []
    mean, covariance = np.zeros((2, 4, 3)), np.diag([error_m2, 1.0])
    for each_m in measured_m:
        predicted.append(mean), predictions.append(covariance)
        gain = covariance[:, 0] / (covariance[0, 0] + error_m2)
        mean = mean + np.tensordot(gain, each_m - mean[0], 0)
        covariance = covariance - np.outer(gain, covariance[0])
        means.append(mean), covariances.append(covariance)
        mean, covariance = np.tensordot(move, mean, 1), move @ covariance @ move.T + assumed * noise
    for frame in reversed(range(n_frames - 1)):
        back = covariances[frame] @ move.T @ np.linalg.inv(predictions[frame + 1])
        means[frame] = means[frame] + np.tensordot(back, means[frame + 1] - predicted[frame + 1], 1)
    return np.stack([mean[0] for mean in means])


@pytest.mark.parametrize(("density", "fps"), [(2.0, 50.0), (60.0, 50.0), (30.0, 10.0), (300.0, 12.0)])
@pytest.mark.parametrize("start", [0.3, 300.0])
def test_white_acceleration_is_found_however_it_was_smoothed_at_first(density: float, fps: float, start: float) -> None:
    """Not less, as by taking smoothed accelerations for true ones, which end at the least density, nor where the
    bandwidth is as high as the frame rate: there the filter of continuous time finds half, and a third."""
    per_s, n_frames, found = 1e5, 1000, start
    for _ in range(12):
        smooth_m = measured_and_smoothed_m(density, found, fps, per_s, n_frames, np.random.default_rng(0))
        found = float(density_of(smooth_m, np.arange(n_frames) / fps, per_s=per_s).mean())
    # 1000 frames and 12 axes: some 2,000 measurements tell the density to 3 %, and the mean of logarithms takes some
    # percent more.
    assert found == pytest.approx(density, rel=0.15)


def test_density_follows_from_the_mean_square_acceleration_and_the_information() -> None:
    time_s = np.arange(200) / FPS
    # 2.5 Hz: the window of 0.4 s is one period. Root mean square acceleration A w^2 / sqrt(2) along one axis of three.
    squared = (0.1 * (2 * np.pi * 2.5) ** 2) ** 2 / 2 / 3
    # At b = 30 rad/s frames of 50 Hz show 0.97 of what a motion of that bandwidth has, and the differences miss 1 %.
    per_s = 1e4
    density = density_of(swinging(0.1, 2.5, time_s), time_s, per_s=per_s)[20:-20, 0]
    # With this density the mean square is q b / (2 sqrt 2), b^4 = q I.
    expected = density * (density * per_s) ** 0.25 / (2 * np.sqrt(2))
    np.testing.assert_allclose(expected, squared, rtol=0.06)


def test_density_does_not_depend_on_the_rate_or_its_regularity():
    rng = np.random.default_rng(0)
    slow_s = np.arange(200) / FPS
    uneven_s = np.sort(rng.uniform(0, 4.0, 1500))
    even = density_of(swinging(0.1, 1.5, slow_s), slow_s)
    uneven = density_of(swinging(0.1, 1.5, uneven_s), uneven_s)
    # what the differences of 50 Hz miss, and one period does not fit the window
    middle = (uneven_s > 0.5) & (uneven_s < 3.5)
    np.testing.assert_allclose(uneven[middle, 0], np.interp(uneven_s[middle], slow_s, even[:, 0]), rtol=0.06)


def test_a_pause_is_quiet_and_a_blow_is_not():
    time_s = np.arange(150) / FPS
    positions_m = swinging(0.2, 4.0, time_s)
    positions_m[:75] = 0.0
    density = density_of(positions_m, time_s)[:, 0]
    pause, blow = density[:60], density[90:]
    assert blow.min() > 10 * CONFIG.acceleration_density
    # Nothing resolves a pause but what is usual for the joint, which counts as one measurement.
    assert pause[0] < 0.5 * blow.min()


def test_what_is_not_known_is_not_taken_for_rest():
    """A joint that enters or leaves is as fast near the gap as it is elsewhere."""
    time_s = np.arange(300) / FPS
    positions_m = swinging(0.1, 2.5, time_s)
    everywhere = density_of(positions_m, time_s)
    positions_m[100:200] = np.nan
    density = density_of(positions_m, time_s)
    # near a gap the mean runs over half of a period or more, in which the square acceleration averages to the same
    np.testing.assert_allclose(density[80:98, 0], everywhere[80:98, 0], rtol=0.25)
    np.testing.assert_allclose(density[202:220, 0], everywhere[202:220, 0], rtol=0.25)


def test_what_no_camera_sees_has_the_density_that_is_usual_for_the_joint() -> None:
    """The accelerations that bones and motion predict for it tell nothing."""
    time_s = np.arange(300) / FPS
    information = np.full((300, 1), PER_S / FPS)
    everywhere = process_density(swinging(0.1, 2.5, time_s), time_s, information, CONFIG)
    information[100:200] = 0.0
    still_m = swinging(0.1, 2.5, time_s)
    still_m[110:190] = still_m[110]
    density = process_density(still_m, time_s, information, CONFIG)
    np.testing.assert_allclose(density[135:165], np.median(everywhere), rtol=0.1)


def test_joints_that_take_no_part_and_short_recordings_have_a_density():
    time_s = np.arange(6) / FPS
    nobody = np.full((6, 2, 3), np.nan)
    assert (density_of(nobody, time_s) == CONFIG.acceleration_density).all()
    for n_frames in (1, 2):
        short = density_of(nobody[:n_frames], time_s[:n_frames])
        assert (short == CONFIG.acceleration_density).all()
    unseen = density_of(np.zeros((6, 2, 3)), time_s, per_s=0.0)
    assert (unseen == CONFIG.acceleration_density).all()


def test_running_density_starts_as_configured_and_ends_where_the_motion_is():
    running = RunningDensity(2, CONFIG)
    np.testing.assert_allclose(running.density(), CONFIG.acceleration_density)
    for frame in range(100):  # ten times the memory of 0.2 s
        velocities_mps = np.array([[30.0 * frame / FPS, 0.0, 0.0], [np.nan, np.nan, np.nan]])
        running.add(frame / FPS, velocities_mps, np.full(2, PER_S / FPS))
    found = running.density()
    # 30 m/s^2 along one axis of three. Next to 40 measurements the density of 4 that it began with counts as four.
    mean_square = found[0] * (found[0] * PER_S) ** 0.25 / (2 * np.sqrt(2))
    assert 0.75 * 30.0**2 / 3 < mean_square < 30.0**2 / 3
    assert found[1] == pytest.approx(CONFIG.acceleration_density)


@pytest.mark.parametrize(
    ("changes", "density"),
    [({"model": "random_walk"}, 3.0), ({"model": "none"}, 7.0), ({"adaptive": False}, 7.0), ({}, None)],
    ids=str,
)
def test_only_accelerations_are_learned(changes: dict, density: float | None):
    """What is not learned is what the parameters say, at all times."""
    config = dataclasses.replace(CONFIG, acceleration_density=7.0, velocity_density=3.0, **changes)
    time_s = np.arange(100) / FPS
    positions_m = swinging(0.2, 2.5, time_s)
    running = RunningDensity(1, config)
    for at_s, velocity_mps in zip(time_s, np.gradient(positions_m, time_s, axis=0), strict=True):
        running.add(at_s, velocity_mps, np.full(1, PER_S / FPS))
    learned = density_of(positions_m, time_s, config), running.density()
    if density is None:
        assert min(np.median(found) for found in learned) > 14.0, "twice what is assumed before anything is known"
    else:
        assert {found.item() for densities in learned for found in densities.ravel()} == {density}


@pytest.fixture(scope="module")
def fast_and_slow(skeleton: Skeleton, rig: CameraRig) -> Scene:
    """Two seconds of standing, then walking played three times as fast."""
    truth_m, _ = motion_from_npz(MOCAP / "cmu_02_01_short.npz")
    motion_m = np.concatenate([np.repeat(truth_m[:1], 100, axis=0), truth_m[::3]])
    return simulate(motion_m, skeleton, rig, FPS, DetectionNoise(), NO_OCCLUSION, seed=0)


def errors_mm(scene: Scene, positions_m: np.ndarray) -> tuple[float, float]:
    """Of the slow part and of the fast one; the jump between the two is neither."""
    slow, fast = slice(25, 85), slice(115, len(positions_m))
    return 1e3 * mpjpe_m(positions_m[slow], scene.truth_m[slow]), 1e3 * mpjpe_m(positions_m[fast], scene.truth_m[fast])


@pytest.mark.slow
def test_batch_smooths_rest_more_and_fast_motion_less(fast_and_slow):
    fixed = Config(motion=MotionConfig(adaptive=False))
    slow_mm, fast_mm = errors_mm(fast_and_slow, smooth(fast_and_slow.observations, fast_and_slow.rig).positions_m)
    slow_fixed_mm, fast_fixed_mm = errors_mm(
        fast_and_slow, smooth(fast_and_slow.observations, fast_and_slow.rig, fixed).positions_m
    )
    assert slow_mm < slow_fixed_mm
    assert fast_mm < fast_fixed_mm


@pytest.mark.slow
def test_online_does_too(fast_and_slow):
    def lagged_m(config: Config) -> np.ndarray:
        estimator = Estimator(fast_and_slow.rig, fast_and_slow.observations.skeleton, config)
        positions_m = np.full_like(fast_and_slow.truth_m, np.nan)
        for frame in fast_and_slow.observations:
            lagged = estimator.update(frame).smoothed
            if lagged is not None:
                positions_m[lagged.frame] = lagged.positions_m
        return positions_m[:-15]  # the last are never one lag old

    config = Config(online=OnlineConfig(lag_s=0.2, covariance=False))
    slow_mm, fast_mm = errors_mm(fast_and_slow, lagged_m(config))
    fixed = dataclasses.replace(config, motion=MotionConfig(adaptive=False))
    slow_fixed_mm, fast_fixed_mm = errors_mm(fast_and_slow, lagged_m(fixed))
    assert slow_mm < slow_fixed_mm
    assert fast_mm < fast_fixed_mm
