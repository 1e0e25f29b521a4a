"""Time offsets of the cameras, estimated from the recording itself."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pytest

import fgpose
from fgpose.calibration import Ending
from fgpose.config import CalibrationConfig, Config, ProjectionConfig, SolverConfig
from fgpose.estimation.online.clock_offsets import offset_information
from fgpose_benchmarks.synthetic import (
    NO_NOISE,
    NO_OCCLUSION,
    DetectionNoise,
    Scene,
    motion_from_npz,
    simulate,
    walking,
)
from tests.conftest import MOCAP

OFFSETS_S = np.array([0.0, 0.06, -0.04, 0.02])
STRIDE = 2  # 25 frames a second: as good, in half the time
STEP_S = STRIDE / 50
PRIOR_S = CalibrationConfig().offset_sigma_s


@pytest.fixture(scope="module")
def late(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> fgpose.Observations:
    """Two seconds of a real walk with a turn; all cameras but the first are off by half a frame to one and a half."""
    truth_m, fps = motion_from_npz(MOCAP / "cmu_03_03_b.npz")
    return filmed(truth_m[150:250], skeleton, rig, fps, OFFSETS_S, DetectionNoise())


def filmed(
    truth_m: np.ndarray,
    skeleton: fgpose.Skeleton,
    rig: fgpose.CameraRig,
    fps: float,
    offsets_s: np.ndarray,
    noise: DetectionNoise,
) -> fgpose.Observations:
    scene = simulate(truth_m, skeleton, rig, fps, noise, NO_OCCLUSION, seed=0, offsets_s=offsets_s)
    return replace(scene.observations, points3d_m=None, covariance3d_m2=None).frames(slice(None, None, STRIDE))


@pytest.mark.slow
def test_offsets_of_a_moving_person(late: fgpose.Observations, rig: fgpose.CameraRig) -> None:
    found = fgpose.calibration.estimate_time_offsets(late, rig)
    error_s = found.offsets_s - OFFSETS_S
    assert found.offsets_s[0] == found.sigma_s[0] == 0.0
    assert np.abs(error_s).max() < 0.2 * STEP_S
    # 0.2 to 0.4 frames are what a second or two of correlated errors of 5 px allow at walking speed.
    assert found.sigma_s[1:].max() < 0.5 * STEP_S
    assert (np.abs(error_s[1:]) < 3 * found.sigma_s[1:]).all()
    np.testing.assert_array_equal(found.rig.time_offsets_s, found.offsets_s)


@pytest.mark.slow
def test_the_offsets_of_a_rig_are_where_the_search_begins(late: fgpose.Observations, rig: fgpose.CameraRig) -> None:
    """From the right offsets and from none: the same, to the tolerance at which the search ends."""
    from_none = fgpose.calibration.estimate_time_offsets(late, rig).offsets_s
    from_right = fgpose.calibration.estimate_time_offsets(late, rig.with_time_offsets(OFFSETS_S)).offsets_s
    np.testing.assert_allclose(from_right, from_none, atol=0.06 * STEP_S)


@pytest.mark.slow
def test_a_person_who_stands_still_tells_nothing(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    standing_m = np.repeat(walking(1, 50.0, skeleton), 60, axis=0)
    exact = fgpose.calibration.estimate_time_offsets(filmed(standing_m, skeleton, rig, 50.0, OFFSETS_S, NO_NOISE), rig)
    np.testing.assert_allclose(exact.offsets_s, 0.0, atol=1e-9)
    np.testing.assert_allclose(exact.sigma_s[1:], PRIOR_S, rtol=1e-6)
    # The errors of detections look like motion, a little: the offsets stay within what is claimed.
    noisy = fgpose.calibration.estimate_time_offsets(
        filmed(standing_m, skeleton, rig, 50.0, OFFSETS_S, DetectionNoise()), rig
    )
    assert (noisy.sigma_s[1:] > 0.4 * PRIOR_S).all()
    assert (np.abs(noisy.offsets_s[1:]) < 2 * noisy.sigma_s[1:]).all()


def test_offsets_that_are_known_stay_where_nobody_moves(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    """The prior is around what the rig says, not around zero."""
    known_s = np.array([0.0, 0.2, -0.1, 0.05])
    standing_m = np.repeat(walking(1, 50.0, skeleton), 60, axis=0)
    seen = filmed(standing_m, skeleton, rig, 50.0, known_s, NO_NOISE)
    found = fgpose.calibration.estimate_time_offsets(seen, rig.with_time_offsets(known_s))
    np.testing.assert_allclose(found.offsets_s, known_s, atol=1e-6)  # the smoother moves by 1e-7 m
    np.testing.assert_allclose(found.sigma_s, [0.0, PRIOR_S, PRIOR_S, PRIOR_S], rtol=1e-6)
    assert found.converged


@pytest.mark.slow
def test_the_error_of_what_is_correlated_is_what_is_claimed(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    """At twice the rate nothing more is known: the errors are correlated over 0.15 s."""
    truth_m, fps = motion_from_npz(MOCAP / "cmu_03_03_b.npz")
    scene = simulate(truth_m[150:230], skeleton, rig, fps, DetectionNoise(), NO_OCCLUSION, seed=0, offsets_s=OFFSETS_S)
    seen = replace(scene.observations, points3d_m=None, covariance3d_m2=None)
    fast, slow = (
        fgpose.calibration.estimate_time_offsets(seen.frames(slice(None, None, each)), rig) for each in (1, 2)
    )
    # The kernel and the motion's ends differ a little; were frames independent it would be a factor of 0.7.
    np.testing.assert_allclose(fast.sigma_s[1:], slow.sigma_s[1:], rtol=0.1)
    # A prior that is narrow is felt as much at both rates: with 5 ms it holds three quarters or more of each offset.
    config = Config(calibration=CalibrationConfig(offset_sigma_s=0.005))
    fast, slow = (
        fgpose.calibration.estimate_time_offsets(seen.frames(slice(None, None, each)), rig, config) for each in (1, 2)
    )
    np.testing.assert_allclose(fast.offsets_s, slow.offsets_s, atol=0.005)


@pytest.mark.slow
def test_a_smoother_that_has_not_converged_is_told(late: fgpose.Observations, rig: fgpose.CameraRig) -> None:
    assert fgpose.calibration.estimate_time_offsets(late, rig).converged
    hasty = Config(solver=SolverConfig(max_iterations=1))
    assert fgpose.calibration.estimate_time_offsets(late, rig, hasty).ending is Ending.MOTION
    once = Config(calibration=CalibrationConfig(max_rounds=1))
    unchanged = fgpose.calibration.estimate_time_offsets(late, rig, once)
    assert unchanged.ending is Ending.ROUNDS
    np.testing.assert_array_equal(unchanged.offsets_s, 0.0)


def test_one_frame_and_one_camera_tell_nothing(late: fgpose.Observations, rig: fgpose.CameraRig) -> None:
    one_frame = fgpose.calibration.estimate_time_offsets(late.frames(slice(0, 1)), rig)
    np.testing.assert_array_equal(one_frame.offsets_s, 0.0)
    np.testing.assert_allclose(one_frame.sigma_s, [0.0, PRIOR_S, PRIOR_S, PRIOR_S])
    name = rig.names[1]
    one_camera = fgpose.calibration.estimate_time_offsets(late.frames(slice(0, 10)).subset([name]), rig.subset([name]))
    np.testing.assert_array_equal(one_camera.offsets_s, [0.0])
    np.testing.assert_array_equal(one_camera.sigma_s, [0.0])


def test_cameras_must_match(late: fgpose.Observations, rig: fgpose.CameraRig) -> None:
    with pytest.raises(ValueError, match=f"lacks camera {rig.names[3]}"):
        fgpose.calibration.estimate_time_offsets(late, rig.subset(rig.names[:3]))


@pytest.mark.parametrize("kernel", ["none", "cauchy"])
def test_information_and_gradient_against_numerical_ones(
    kernel: Literal["none", "cauchy"], walking_scene: Scene, rig: fgpose.CameraRig
) -> None:
    """Of the whole problem of one frame, all joints and all offsets, by central differences; then the joints are
    eliminated by the textbook's Schur complement."""
    config, frame = ProjectionConfig(kernel=kernel), slice(10, 11)
    problem = OneFrame(
        positions_m=walking_scene.truth_m[10],
        velocities_mps=np.gradient(walking_scene.truth_m, 1 / 30, axis=0)[10],
        detected_px=walking_scene.observations.points2d_px[10],
        weights=walking_scene.observations.confidence[10],
        rig=rig,
        config=config,
    )
    information, gradient = offset_information(
        problem.positions_m[None],
        problem.velocities_mps[None],
        walking_scene.observations.points2d_px[frame],
        walking_scene.observations.confidence[frame],
        np.full((1, *problem.weights.shape), config.sigma_px),
        rig,
        config,
    )
    hessian, slope = problem.hessian(), problem.slope()
    of_joints, across = hessian[4:, 4:], hessian[:4, 4:]
    expected = hessian[:4, :4] - across @ np.linalg.solve(of_joints, across.T)
    expected_gradient = slope[:4] - across @ np.linalg.solve(of_joints, slope[4:])
    # Central differences: 1e-6 of 1000 px and m; the complement is a difference of numbers ten times as large.
    np.testing.assert_allclose(information, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())
    np.testing.assert_allclose(gradient, expected_gradient, rtol=1e-4, atol=1e-4 * np.abs(expected_gradient).max())


@dataclass(frozen=True, eq=False)
class OneFrame:
    """Variables: four offsets, then the joints' coordinates. A camera that is dt late sees a joint at p + v dt."""

    positions_m: np.ndarray
    velocities_mps: np.ndarray
    detected_px: np.ndarray
    weights: np.ndarray
    rig: fgpose.CameraRig
    config: ProjectionConfig

    def residual_px(self, change: np.ndarray) -> np.ndarray:
        moved_m = self.positions_m + change[4:].reshape(-1, 3) + change[:4, None, None] * self.velocities_mps
        return self.rig.project_each(moved_m) - self.detected_px

    def half_robust_error(self, change: np.ndarray) -> float:
        squared = np.sum(self.residual_px(change) ** 2, axis=-1) / self.config.sigma_px**2
        if self.config.kernel == "cauchy":
            squared = self.config.kernel_scale**2 * np.log1p(squared / self.config.kernel_scale**2)
        return float(0.5 * np.nansum(self.weights * squared))

    def steps(self) -> np.ndarray:
        return 1e-5 * np.eye(4 + self.positions_m.size)

    def slope(self) -> np.ndarray:
        return np.array([self.half_robust_error(d) - self.half_robust_error(-d) for d in self.steps()]) / 2e-5

    def hessian(self) -> np.ndarray:
        """Gauss-Newton's, with the weights that the kernel gives."""
        slopes = np.array([(self.residual_px(d) - self.residual_px(-d)) / 2e-5 for d in self.steps()])
        squared = np.sum(self.residual_px(np.zeros(len(slopes))) ** 2, axis=-1) / self.config.sigma_px**2
        robust = 1.0 if self.config.kernel == "none" else 1.0 / (1.0 + squared / self.config.kernel_scale**2)
        weights = np.nan_to_num(self.weights * robust / self.config.sigma_px**2)
        return np.einsum("acji,cj,bcji->ab", np.nan_to_num(slopes), weights, np.nan_to_num(slopes))
