"""Speeds of joints, which show and take themselves apart as angles do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgpose.kinematics import JointSpeeds, joint_angles, joint_speeds
from fgpose.skeletons import named_skeleton
from fgpose.trajectory import Trajectory


def moving(n_frames: int = 6, fps: float = 50.0) -> Trajectory:
    """All joints go along x, joint j with j m/s."""
    skeleton, time_s = named_skeleton("h36m_17"), np.arange(n_frames) / fps
    positions_m = np.zeros((n_frames, skeleton.n_joints, 3))
    positions_m[..., 0] = time_s[:, None] * np.arange(skeleton.n_joints)
    return Trajectory(skeleton, time_s, positions_m, np.full(positions_m.shape[:2], 2))


def test_the_speed_of_each_joint_and_of_the_centre() -> None:
    trajectory = moving()
    speeds, skeleton = joint_speeds(trajectory), trajectory.skeleton
    assert speeds.names == (*skeleton.joints, "centre")
    np.testing.assert_allclose(speeds["left_wrist"], skeleton.index("left_wrist"))
    np.testing.assert_allclose(speeds["centre"], np.mean(skeleton.root))
    assert speeds.sigma is None
    np.testing.assert_allclose(speeds.quantiles((0.0, 1.0))[:, 3], 3.0)


def test_some_frames_and_some_joints() -> None:
    speeds = joint_speeds(moving())
    for part in (speeds[1:3], speeds.crop(1 / 50, 2 / 50)):
        assert isinstance(part, JointSpeeds)
        np.testing.assert_array_equal(part.time_s, speeds.time_s[1:3])
        np.testing.assert_allclose(part[["centre", "left_wrist"]], speeds[["centre", "left_wrist"]][1:3])
    with pytest.raises(ValueError, match=r"there is no speed 'left_wirst' \(did you mean left_wrist\?\)"):
        speeds["left_wirst"]
    with pytest.raises(ValueError, match=r"speed_m_s must be \(2, 1\), got \(3, 1\)"):
        JointSpeeds(("a",), np.zeros(2), np.zeros((3, 1)))


def test_parts_become_the_whole_again() -> None:
    """Speeds, and angles, which have standard deviations as well."""
    trajectory = moving(8)
    for whole in (joint_speeds(trajectory), joint_angles(trajectory)):
        again = type(whole).concatenate([whole[:1], whole[1:5], whole[5:]])
        assert type(again) is type(whole)
        np.testing.assert_array_equal(again.time_s, whole.time_s)
        np.testing.assert_array_equal(again.value, whole.value)
        assert (again.sigma is None) == (whole.sigma is None)
        with pytest.raises(ValueError, match="time must increase"):
            type(whole).concatenate([whole[5:], whole[:5]])
    numbered = replace(joint_speeds(trajectory), frame_numbers=np.arange(10, 18))
    np.testing.assert_array_equal(numbered.concatenate([numbered[:3], numbered[4:]]).frame_numbers,
                                  [10, 11, 12, 14, 15, 16, 17])  # fmt: skip
    assert numbered.concatenate([numbered[:3], replace(numbered[4:], frame_numbers=None)]).frame_numbers is None
    with pytest.raises(ValueError, match="there is nothing"):
        JointSpeeds.concatenate([])
    with pytest.raises(ValueError, match="speeds 0 and 1 are not of the same"):
        JointSpeeds.concatenate([numbered[:3], replace(numbered[4:], names=tuple(reversed(numbered.names)))])
