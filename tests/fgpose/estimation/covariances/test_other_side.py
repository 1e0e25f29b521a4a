"""Joints that one camera alone sees, and where else on its ray they may be."""

from __future__ import annotations

import numpy as np
import pytest

import fgpose
from fgpose.estimation.covariances.other_side import (
    SteadyDistances,
    may_have_crossed,
    off_across,
    other_side_m2,
    share_of_other_side,
)
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, motion_from_npz, simulate
from tests.conftest import MOCAP

ELLIPSOID = 7.815  # of 95 %, three degrees of freedom
CHAIN = fgpose.Skeleton("chain", ("a", "b", "c"), ((0, 1), (1, 2)), (0,))
Z = np.eye(3)[2]


def along_z(joints: list[bool]) -> np.ndarray:
    """Rays to these joints."""
    return np.where(np.array(joints)[None, :, None], Z, 0.0)


def test_the_other_point_is_as_far_from_the_holder() -> None:
    positions_m = np.array([[[0.0, 0.0, 4.0], [0.2, 0.0, 4.15], [0.4, 0.0, 4.1]]])
    ray = along_z([False, True, True])
    moment_m2 = other_side_m2(np.array([[0.0, 0.5, 0.25]]), ray, positions_m, CHAIN)[0]
    other_m = positions_m[0, 1] - 0.3 * Z
    assert np.linalg.norm(other_m - positions_m[0, 0]) == pytest.approx(0.25)
    np.testing.assert_allclose(moment_m2[0], 0.0)
    np.testing.assert_allclose(moment_m2[1], 0.5 * 0.3**2 * np.outer(Z, Z))
    # What the joint holds is where it is, and may itself be 0.1 m off.
    np.testing.assert_allclose(moment_m2[2], (0.5 * 0.3**2 + 0.25 * 0.1**2) * np.outer(Z, Z))


def test_a_bone_across_the_ray_may_go_either_way() -> None:
    """Of 0.25 m, whose ends are known to 20 mm each: 5 cm deep it seems 5 mm shorter, 20 cm deep 80 mm."""
    for deep_m, least, most in ((0.0, 0.5, 0.5), (0.05, 0.4, 0.47), (0.2, 0.0, 0.01)):
        end_m = [np.sqrt(0.25**2 - deep_m**2), 0.0, 4.0 + deep_m]
        positions_m = np.array([[[0.0, 0.0, 4.0], end_m, end_m]])
        covariance_m2 = np.broadcast_to(0.02**2 * np.eye(3), (1, 3, 3, 3))
        off = off_across(along_z([False, True, False]), positions_m, covariance_m2, CHAIN)
        assert np.isinf(off[0, [0, 2]]).all()
        assert least <= may_have_crossed(off)[0, 1] <= most


def test_it_is_known_until_it_was_across_and_from_when_it_is_next() -> None:
    off = np.full((9, 3), np.inf)
    off[2:7, 0] = [5.0, 0.0, 5.0, 0.0, 5.0]
    off[2:7, 1] = [5.0, 5.0, 0.0, 5.0, 5.0]
    observed = np.ones((9, 3), dtype=bool)
    observed[2:7] = False
    share = share_of_other_side(off, observed)
    # Between two moments it may have been on the other side; with one it cannot have come back.
    np.testing.assert_allclose(share[:, 0], [0, 0, 0, 0.5, 0.5, 0.5, 0, 0, 0], atol=1e-6)
    np.testing.assert_allclose(share[:, 1], [0, 0, 0, 0, 0.5, 0, 0, 0, 0], atol=1e-6)
    assert not share[:, 2].any()


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["window", "isam2"])
def test_an_arm_that_one_camera_sees_is_not_too_certain(
    solver: str, rig: fgpose.CameraRig, skeleton: fgpose.Skeleton
) -> None:
    truth_m, fps = motion_from_npz(MOCAP / "cmu_02_10.npz")
    truth_m = truth_m[:420:2]
    recorded = simulate(truth_m, skeleton, rig, fps / 2, DetectionNoise(), NO_OCCLUSION, seed=0).observations
    arm = [skeleton.joints.index(name) for name in ("left_elbow", "left_wrist")]
    alone = recorded.frame_time_s >= recorded.frame_time_s[0] + 2.0
    within = []
    for camera in range(rig.n_cameras):
        others = [c for c in range(rig.n_cameras) if c != camera]
        where = np.zeros(recorded.confidence.shape, dtype=bool)
        where[np.ix_(alone, others, arm)] = True
        estimator = fgpose.Estimator(rig, skeleton, fgpose.Config(online={"solver": solver}))
        estimates = [estimator.update(frame) for frame in recorded.without(where)]
        error_m = (np.stack([each.positions_m for each in estimates]) - truth_m)[alone][:, arm]
        covariance_m2 = np.stack([each.covariance_m2 for each in estimates if each.covariance_m2 is not None])
        inverse = np.linalg.inv(covariance_m2[alone][:, arm])
        within.append(np.mean(np.einsum("tji,tjik,tjk->tj", error_m, inverse, error_m) < ELLIPSOID))
    # 99 % each; as if the side were known, 50 to 94.
    assert min(within) > 0.95


HEAD_M = np.array([[0.0, 0.0, 0.0], [-0.03, 0.03, 0.03], [-0.1, 0.07, 0.01], [-0.1, -0.07, 0.01]])
"""Nose, left eye, both ears."""


def turning_heads_m(n_frames: int, rng: np.random.Generator) -> np.ndarray:
    """Frames of a head that turns by all angles and goes about, with errors of 5 mm."""
    angle = np.linspace(0, 2 * np.pi, n_frames)
    R = np.moveaxis(np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]), -1, 0)
    heads_m = np.tile(HEAD_M, (n_frames, 1, 1)) + rng.normal(0.0, 0.005, (n_frames, *HEAD_M.shape))
    heads_m[..., :2] = np.einsum("tik,tjk->tji", R, heads_m[..., :2])
    return heads_m + np.array([0.0, 0.0, 1.6]) + angle[:, None, None] * [0.3, 0.1, 0.0]


def test_distances_within_a_head_tell_on_which_side_of_the_eye_an_ear_is() -> None:
    rng = np.random.default_rng(0)
    distances, sure = SteadyDistances(4), np.ones((1, 4), dtype=bool)
    head_m = HEAD_M[None].copy()
    before_m = head_m[:, 2] + [0.14, 0.0, 0.0]  # 70 mm before the eye as it is 70 mm behind it
    assert distances.log_odds(2, before_m, head_m, sure)[0] == 0.0  # nothing is known
    heads_m = turning_heads_m(60, rng)
    distances.learn(heads_m[:20], np.ones((20, 4), dtype=bool))
    assert distances.log_odds(2, before_m, head_m, sure)[0] == 0.0  # less than a second
    distances.learn(heads_m[20:], np.ones((40, 4), dtype=bool))
    # It is 122 mm from the nose; there 81 mm, and 197 instead of 140 mm from the other ear: 3.8 times 15 mm off, which
    # is 73 to 1 in that distribution.
    assert distances.log_odds(2, before_m, head_m, sure)[0] < -np.log(50)
    wrong_m = head_m.copy()
    wrong_m[:, 2] = before_m
    assert distances.log_odds(2, head_m[:, 2], wrong_m, sure)[0] > np.log(50)
    assert distances.log_odds(2, before_m, head_m, np.zeros((1, 4), dtype=bool))[0] == 0.0


def test_distances_between_joints_that_move_tell_nothing() -> None:
    """One of them goes up and down by 200 mm, and its distances by 40 mm or more."""
    heads_m, distances = turning_heads_m(60, np.random.default_rng(0)), SteadyDistances(4)
    heads_m[:, 2] += 0.2 * np.sin(np.linspace(0, 20, 60))[:, None] * Z
    sure = np.ones((60, 4), dtype=bool)
    distances.learn(heads_m, sure)
    assert not distances.log_odds(2, heads_m[:, 2] + 0.3 * Z, heads_m, sure).any()
    assert distances.log_odds(3, heads_m[:, 3] + 0.3 * Z, heads_m, sure).max() < -np.log(50)
