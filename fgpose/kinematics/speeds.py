"""Speeds of the joints of a trajectory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int

from fgpose.kinematics.motion import centre_m, speeds_m_s
from fgpose.kinematics.quantities import Quantities
from fgpose.shown.wrong_types import check_type
from fgpose.trajectory import Trajectory

CENTRE = "centre"
"""The root of the body among the names of joints."""


@dataclass(frozen=True, eq=False, repr=False)
class JointSpeeds(Quantities):
    """Speeds of joints over time. Their standard deviations are not known: they need the covariance of neighbouring
    frames, which results do not have.

    Raises:
        ValueError: the arrays' shapes disagree.
    """

    kind: ClassVar[str] = "speed"
    unit: ClassVar[str] = "m/s"
    suffix: ClassVar[str] = "speed_m_s"

    speed_m_s: Float[np.ndarray, "frame joint"]
    """NaN in a gap and beside it, where frames are missing too."""
    frame_numbers: Int[np.ndarray, " frame"] | None = None
    """Those of the trajectory."""

    @property
    def value(self) -> Float[np.ndarray, "frame joint"]:
        return self.speed_m_s


def joint_speeds(trajectory: Trajectory) -> JointSpeeds:
    """The speed of every joint, and of the root of the body, which is called centre.

    Args:
        trajectory: of one person.

    Raises:
        ValueError: the times do not increase.
        TypeError: it is no trajectory.
    """
    check_type("joint_speeds", "trajectory", trajectory, Trajectory)
    speeds = speeds_m_s(with_centre_m(trajectory), trajectory.time_s)
    return JointSpeeds((*trajectory.skeleton.joints, CENTRE), trajectory.time_s, speeds, trajectory.frame_numbers)


def with_centre_m(trajectory: Trajectory) -> Float[np.ndarray, "frame point 3"]:
    """The joints, and the root of the body after them."""
    positions_m = trajectory.positions_m
    return np.concatenate([positions_m, centre_m(positions_m, trajectory.skeleton)[:, None]], axis=1)
