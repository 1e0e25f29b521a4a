"""Time offsets of the cameras, learned frame by frame."""

from __future__ import annotations

import numpy as np
import pytest

import fgpose
from fgpose.config import CalibrationConfig, Config
from fgpose.estimation.clock_offsets import RunningOffsets
from fgpose.synthetic import walking

KNOWN_S = np.array([0.0, 0.2, -0.1, 0.05])
FPS = 50.0
UNIFORM = np.ones((4, 17))


def test_offsets_that_are_known_stay_where_nobody_moves(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    """The prior is around what the rig says, not around zero."""
    rig = rig.with_time_offsets(KNOWN_S)
    offsets, standing_m = RunningOffsets(rig, Config()), walking(1, FPS, skeleton)[0]
    for _ in range(20):
        offsets.add(1 / FPS, standing_m, np.zeros_like(standing_m), rig.project(standing_m), UNIFORM, rig)
    np.testing.assert_allclose(offsets.rig().time_offsets_s, KNOWN_S, atol=1e-12)


@pytest.mark.parametrize("sigma_s", [0.1, 0.002])
def test_offsets_of_a_moving_person(sigma_s: float, rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    """Found where the prior is weak; where it is strong, between what is known and what is seen."""
    config = Config(calibration=CalibrationConfig(offset_sigma_s=sigma_s))
    offsets, motion_m = RunningOffsets(rig, config), walking(60, FPS, skeleton)
    velocities_mps = np.gradient(motion_m, 1 / FPS, axis=0)
    late_s = np.array([0.0, 0.01, -0.01, 0.0])
    for position_m, velocity_mps in zip(motion_m, velocities_mps, strict=True):
        seen_px = rig.project_each(position_m + late_s[:, None, None] * velocity_mps)
        offsets.add(1 / FPS, position_m, velocity_mps, seen_px, UNIFORM, rig)
    found_s = offsets.rig().time_offsets_s
    assert found_s[0] == 0.0
    if sigma_s == 0.1:
        # 17 joints at 1.2 m/s for 1.2 s know an offset to about 2 ms: the prior of 100 ms takes 0.04 %. The rest is
        # the kernel and the curvature of the projection.
        np.testing.assert_allclose(found_s, late_s, atol=5e-4)
    else:
        assert 0.1 * 0.01 < found_s[1] < 0.9 * 0.01
