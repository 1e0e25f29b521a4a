"""Shares of the stature."""

from __future__ import annotations

import numpy as np
import pytest

import fgpose
from fgpose.estimation.initial_guess import median_lengths
from fgpose.kinematics.proportions import shares_of_stature
from fgpose_benchmarks.synthetic import motion_from_npz
from tests.conftest import MOCAP

SKELETONS = ("blazepose_33", "body_25", "body_25b", "coco_17", "h36m_17", "h36m_17_lt", "halpe_26", "mhr_70", "smpl_24")


@pytest.mark.parametrize("name", SKELETONS)
def test_limbs_of_every_skeleton_have_the_published_shares(name: str) -> None:
    skeleton = fgpose.load_skeleton(name)
    shares = dict(zip(skeleton.length_names, shares_of_stature(skeleton), strict=True))
    assert shares["left_shoulder-left_elbow"] == pytest.approx(0.186)
    assert shares["left_elbow-left_wrist"] == pytest.approx(0.146)
    assert shares["left_hip-left_knee"] == pytest.approx(0.245)
    assert shares["left_knee-left_ankle"] == pytest.approx(0.246)


def test_the_body_of_motion_capture_has_about_these(skeleton: fgpose.Skeleton) -> None:
    truth_m, _ = motion_from_npz(MOCAP / "cmu_03_03_b.npz")
    shares = shares_of_stature(skeleton)
    assert {name for name, share in zip(skeleton.length_names, shares, strict=True) if np.isnan(share)} == {
        "thorax-neck_base",
        "neck_base-head",
    }
    told = np.isfinite(shares)
    statures_m = median_lengths(skeleton, truth_m)[told] / shares[told]
    # Pelvis to hip, 0.11 m by the proportions, differs most between data sets.
    assert np.median(statures_m) == pytest.approx(1.65, abs=0.1)
    assert np.median(np.abs(statures_m / np.median(statures_m) - 1)) < 0.12


def test_names_that_are_no_joints_of_a_body_have_no_share() -> None:
    table = fgpose.Skeleton("gripper", ("left_finger", "wrist_of_robot"), ((0, 1),), (0,))
    np.testing.assert_array_equal(shares_of_stature(table), [np.nan])
