"""The covariance of joints that nobody sees."""

from __future__ import annotations

import numpy as np

from fgpose.config import SwingConfig
from fgpose.skeleton import Skeleton
from fgpose.uncertainty import with_swing


def widened(skeleton: Skeleton, unseen: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Added covariance and positions of a straight body, some joints unseen for a while."""
    positions_m = np.zeros((1, skeleton.n_joints, 3))
    for start, end in skeleton.bones:
        positions_m[0, end] = positions_m[0, start] + [0.0, 0.0, -0.3]
    unseen_s = np.zeros((1, skeleton.n_joints))
    for name, seconds in unseen.items():
        unseen_s[0, skeleton.index(name)] = seconds
    nothing = np.zeros((1, skeleton.n_joints, 3, 3))
    return with_swing(nothing, positions_m, unseen_s, skeleton, SwingConfig())[0], positions_m[0]


def test_a_seen_joint_keeps_its_covariance(skeleton: Skeleton) -> None:
    added, _ = widened(skeleton, {"right_wrist": 1.0})
    others = np.arange(skeleton.n_joints) != skeleton.index("right_wrist")
    assert not added[others].any()


def test_the_swing_is_across_the_bone(skeleton: Skeleton) -> None:
    """After a long time the end of a 0.3 m bone is off by L a across (two directions) and L a^2 / 2 along it."""
    added, _ = widened(skeleton, {"right_wrist": 1e3})
    angle = SwingConfig().angle_rad
    expected = np.diag([(0.3 * angle) ** 2 / 2, (0.3 * angle) ** 2 / 2, (0.3 * angle**2 / 2) ** 2])
    np.testing.assert_allclose(added[skeleton.index("right_wrist")], expected, rtol=1e-9)


def test_it_grows_with_time_and_along_the_limb(skeleton: Skeleton) -> None:
    elbow, wrist = skeleton.index("right_elbow"), skeleton.index("right_wrist")
    short, _ = widened(skeleton, {"right_wrist": 0.1})
    long, _ = widened(skeleton, {"right_wrist": 1.0})
    both, _ = widened(skeleton, {"right_wrist": 1.0, "right_elbow": 1.0})
    assert np.trace(short[wrist]) < np.trace(long[wrist]) < np.trace(both[wrist])
    np.testing.assert_allclose(both[wrist], long[wrist] + both[elbow])


def test_a_bone_of_length_zero_adds_nothing(skeleton: Skeleton) -> None:
    positions_m = np.zeros((1, skeleton.n_joints, 3))
    unseen_s = np.ones((1, skeleton.n_joints))
    nothing = np.zeros((1, skeleton.n_joints, 3, 3))
    assert not with_swing(nothing, positions_m, unseen_s, skeleton, SwingConfig()).any()
