"""The rotation between two cameras from what each sees in 3D."""

from __future__ import annotations

import gtsam
import numpy as np

from fgpose.assessment.rigs import angle_deg
from fgpose.calibration.from_people.rig.procrustes import procrustes_pose

FIRST_T_SECOND = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.3, 1.2, -0.4), np.array([2.0, -0.3, 1.5])).matrix()
RNG = np.random.default_rng(0)
SECOND_M = np.array([0.2, 0.1, 4.0]) + RNG.normal(0, 0.4, (30, 12, 3))
FIRST_M = SECOND_M @ FIRST_T_SECOND[:3, :3].T + FIRST_T_SECOND[:3, 3]


def test_exact_joints_give_the_pose() -> None:
    found = procrustes_pose(FIRST_M, SECOND_M)

    assert found is not None
    np.testing.assert_allclose(found, FIRST_T_SECOND, atol=1e-9)  # rounding


def test_frames_that_are_wrong_and_places_that_are_deeper_do_not_turn_it() -> None:
    first_m = FIRST_M + np.array([0.0, 0.0, 0.5]) * RNG.normal(size=(30, 1, 1))  # the whole body, at a wrong depth
    first_m[::4] = first_m[::4, :, [1, 0, 2]]  # a quarter of the frames, another body
    first_m[3, 5] = np.nan

    found = procrustes_pose(first_m, SECOND_M)

    assert found is not None
    # Least squares is off by several degrees here; the sum of errors is not.
    assert angle_deg(found[:3, :3], FIRST_T_SECOND[:3, :3]) < 1.0


def test_too_little_in_common_gives_nothing() -> None:
    first_m = FIRST_M.copy()
    first_m[2:] = np.nan

    assert procrustes_pose(first_m, SECOND_M) is None
