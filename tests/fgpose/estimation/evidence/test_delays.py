"""Cameras that are not synchronous: their delays are undone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import Float

import fgpose
from fgpose.config import Config, config_from_dict
from fgpose.estimation.evidence.delays import delays_s, image_motion_px, motion_m
from fgpose.estimation.evidence.gather import gather
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, Scene, motion_from_npz, ring_rig, simulate
from tests.conftest import MOCAP

# Two frames late and early. Their mean is zero: the time of a frame is the mean of the cameras' times.
OFFSETS_S = np.array([0.04, -0.04, 0.02, -0.02])
N_FRAMES = 60
SETTLED = 10  # frames after which an online estimate knows the velocities


@pytest.fixture(scope="module")
def walk(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> dict[str, Scene]:
    """A real walk at 1.5 m/s filmed by synchronous cameras, and by others."""
    truth_m, fps = motion_from_npz(MOCAP / "cmu_02_01_short.npz")
    return {
        name: simulate(
            truth_m[:N_FRAMES], skeleton, rig, fps, DetectionNoise(), NO_OCCLUSION, seed=0, offsets_s=offsets_s
        )
        for name, offsets_s in (("synchronous", np.zeros(4)), ("late", OFFSETS_S))
    }


def with_own_clocks(observations: fgpose.Observations, offsets_s: np.ndarray) -> fgpose.Observations:
    return replace(observations, time_s=observations.frame_time_s[:, None] + offsets_s)


def known_delays(walk: dict[str, Scene], by: str) -> tuple[fgpose.Observations, fgpose.CameraRig]:
    late, rig = walk["late"].observations, walk["late"].rig
    return (with_own_clocks(late, OFFSETS_S), rig) if by == "clocks" else (late, rig.with_time_offsets(OFFSETS_S))


@pytest.fixture(scope="module")
def smoothed(walk: dict[str, Scene]) -> dict[str, fgpose.Trajectory]:
    """Of synchronous cameras, of late ones as if they were synchronous, and with delays that are known either way."""
    config = config_from_dict({"solver": {"covariance": False}})
    sources = {name: (scene.observations, scene.rig) for name, scene in walk.items()}
    sources |= {by: known_delays(walk, by) for by in ("clocks", "rig")}
    return {name: fgpose.smooth(*source, config) for name, source in sources.items()}


def online_error_m(observations: fgpose.Observations, rig: fgpose.CameraRig, truth_m: np.ndarray) -> float:
    estimator = fgpose.Estimator(rig, observations.skeleton, config_from_dict({"online": {"covariance": False}}))
    positions_m = np.array([estimator.update(frame).positions_m for frame in observations])
    return float(np.mean(np.linalg.norm(positions_m - truth_m, axis=-1)[SETTLED:]))


@pytest.mark.slow
def test_known_delays_cost_next_to_nothing(walk: dict[str, Scene], smoothed: dict[str, fgpose.Trajectory]) -> None:
    truth_m = walk["synchronous"].truth_m
    error_m = {
        name: float(np.mean(np.linalg.norm(trajectory.positions_m - truth_m, axis=-1)))
        for name, trajectory in smoothed.items()
    }
    # 3 % more were measured on three clips, for at its ends the motion has to be carried on. Ignored, 1.5 m/s times up
    # to 0.04 s come on top of 13 mm: nearly three times as much.
    for by in ("clocks", "rig"):
        assert error_m[by] < min(1.1 * error_m["synchronous"], 0.5 * error_m["late"]), by


def test_a_trajectory_with_known_delays_is_that_of_synchronous_cameras(smoothed: dict[str, fgpose.Trajectory]) -> None:
    """Residuals are those of the images as they were taken: the usual 5 px, not the 60 mm or 15 px of the delay."""
    synchronous, late = smoothed["synchronous"], smoothed["rig"]
    assert late.residual_px is not None
    assert synchronous.residual_px is not None
    assert np.median(late.residual_px) < 1.05 * np.median(synchronous.residual_px)
    np.testing.assert_array_equal(late.time_s, synchronous.time_s)


@pytest.mark.slow
def test_known_delays_online(walk: dict[str, Scene], rig: fgpose.CameraRig) -> None:
    truth_m = walk["synchronous"].truth_m
    synchronous_m = online_error_m(walk["synchronous"].observations, rig, truth_m)
    ignored_m = online_error_m(walk["late"].observations, rig, truth_m)
    # Here the motion is predicted from its last velocity alone, which swings by metres a second at the feet: + 25 %.
    for by in ("clocks", "rig"):
        known_m = online_error_m(*known_delays(walk, by), truth_m)
        assert known_m < min(1.4 * synchronous_m, 0.7 * ignored_m), by


def test_clocks_and_offsets_of_the_rig_are_the_same_thing(smoothed: dict[str, fgpose.Trajectory]) -> None:
    np.testing.assert_allclose(smoothed["clocks"].positions_m, smoothed["rig"].positions_m, atol=1e-9)


@pytest.mark.parametrize("n_cameras", [3, pytest.param(4, marks=pytest.mark.slow)])
def test_no_delay_changes_nothing_at_all(n_cameras: int, skeleton: fgpose.Skeleton) -> None:
    """Not a digit: cameras that tell the same time are synchronous, and offsets of zero are none."""
    rig = ring_rig(n_cameras=n_cameras)
    truth_m, fps = motion_from_npz(MOCAP / "cmu_02_01_short.npz")
    observations = simulate(truth_m[:12], skeleton, rig, fps, DetectionNoise(), NO_OCCLUSION, seed=0).observations
    same = with_own_clocks(observations, np.zeros(n_cameras))
    assert not delays_s(same, rig.with_time_offsets(np.zeros(n_cameras))).any()
    expected_m = fgpose.smooth(observations, rig).positions_m
    np.testing.assert_array_equal(fgpose.smooth(same, rig).positions_m, expected_m)
    estimators = (fgpose.Estimator(rig, skeleton), fgpose.Estimator(rig, skeleton))
    for frame, frame_of_same in zip(observations, same, strict=True):
        estimates = (estimators[0].update(frame), estimators[1].update(frame_of_same))
        np.testing.assert_array_equal(estimates[0].positions_m, estimates[1].positions_m)


def test_delays_are_those_of_the_clocks_and_of_the_rig(skeleton: fgpose.Skeleton) -> None:
    """By hand, for two frames and three cameras; a camera without an image has that of the rig."""
    rig = ring_rig(n_cameras=3).with_time_offsets(np.array([0.0, 0.01, 0.0]))
    time_s = np.array([[0.0, 0.03, -0.03], [1.0, 1.02, np.nan]])
    observations = fgpose.Observations(skeleton, time_s, np.zeros((2, 3, 17, 2)), camera_names=rig.names)
    expected_s = [[0.0, 0.04, -0.03], [-0.01, 0.02, 0.0]]
    np.testing.assert_allclose(delays_s(observations, rig), expected_s, atol=1e-12)
    synchronous = replace(observations, time_s=np.array([0.0, 1.0]))
    np.testing.assert_array_equal(delays_s(synchronous, rig), [[0.0, 0.01, 0.0]] * 2)


def sideways(rig: fgpose.CameraRig, time_s: np.ndarray, speed_mps: float) -> Float[np.ndarray, "frame joint 3"]:
    """One point that moves to the right in the first camera's image, 4 m in front of it."""
    right, forward = rig.cameras[0].world_T_camera[:3, 0], rig.cameras[0].world_T_camera[:3, 2]
    return (rig.cameras[0].position_m + 4.0 * forward + speed_mps * time_s[:, None] * right)[:, None]


def test_the_image_of_a_point_that_moves_evenly() -> None:
    """f v t / d pixels to the right, within the recording and beyond its ends; each frame and camera its own delay."""
    rig = ring_rig(n_cameras=2)
    time_s = np.array([0.0, 0.02, 0.05, 0.06, 0.10])
    delay_s = np.array([[-0.03, 0.0], [0.01, 0.0], [0.0, 0.0], [-0.02, 0.0], [0.05, 0.0]])
    moved_px = image_motion_px(sideways(rig, time_s, 1.6), time_s, delay_s, rig)
    expected_px = rig.cameras[0].K[0, 0] * 1.6 * delay_s[:, 0] / 4.0
    np.testing.assert_allclose(moved_px[:, 0, 0, 0], expected_px, atol=1e-9)
    np.testing.assert_allclose(moved_px[:, 0, 0, 1], 0.0, atol=1e-9)
    np.testing.assert_allclose(moved_px[:, 1], 0.0, atol=1e-9)


def test_the_image_of_a_point_that_comes_late_and_of_one_seen_once() -> None:
    """Where the motion is not known the image does not move; nothing is made up for a joint of one frame."""
    rig = ring_rig(n_cameras=2)
    time_s = np.arange(6) / 50
    positions_m = np.repeat(sideways(rig, time_s, 1.6), 3, axis=1)
    positions_m[:3, 1] = np.nan
    positions_m[1:, 2] = np.nan
    moved_px = image_motion_px(positions_m, time_s, np.full((6, 2), 0.01), rig)
    moves_px = rig.cameras[0].K[0, 0] * 1.6 * 0.01 / 4.0
    np.testing.assert_allclose(moved_px[:, 0, 0, 0], moves_px, atol=1e-9)
    np.testing.assert_allclose(moved_px[:, 0, 1, 0], [0, 0, 0, *3 * [moves_px]], atol=1e-9)
    assert not moved_px[:, :, 2].any()


def test_a_time_offset_must_be_a_number(rig: fgpose.CameraRig) -> None:
    with pytest.raises(
        ValueError, match=f"camera {rig.names[1]}: the time offset, a drift or a jump of the clock is not finite"
    ):
        rig.with_time_offsets(np.array([0.0, np.nan, 0.0, 0.0]))
    np.testing.assert_array_equal(rig.with_time_offsets(OFFSETS_S).time_offsets_s, OFFSETS_S)


def test_a_detection_and_its_depth_are_moved_to_the_time_of_the_frame() -> None:
    """A point that moves along a straight line; each camera sees it later than the frame, by its own delay."""
    rig, skeleton = ring_rig(n_cameras=3), fgpose.Skeleton("point", ("point",), (), root=(0,))
    delay_s, time_s = np.array([[0.0, 0.05, 0.12]]), np.array([0.0, 0.1, 0.2])
    at_m = sideways(rig, time_s + delay_s.mean(), 1.6)
    late_m = np.stack([sideways(rig, time_s + by, 1.6) for by in delay_s[0].tolist()], axis=1)
    observations = fgpose.Observations(
        skeleton, time_s, rig.project_each(late_m), points3d_m=late_m, camera_names=rig.names
    )
    evidence = gather(observations, rig.with_time_offsets(delay_s[0]), Config(depth={"use": "always"}))
    known = evidence.on_time(at_m, motion_m(at_m, time_s, evidence.delay_s), rig)
    np.testing.assert_allclose(known.undistorted_px, rig.project(at_m), atol=1e-6)
    np.testing.assert_allclose(known.views_m, np.repeat(at_m[:, None], 3, axis=1), atol=1e-9)
