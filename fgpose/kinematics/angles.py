"""Joint angles of a trajectory, each with its standard deviation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from fgpose.kinematics import definitions
from fgpose.kinematics.definitions import angles_of
from fgpose.kinematics.landmarks import landmarks, points_of, z_up
from fgpose.kinematics.propagation import moved_by, rms_error_rad
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class JointAngles:
    """Joint angles over time, see definitions.py for what each is.

    Raises:
        ValueError: the arrays' shapes disagree.
    """

    names: tuple[str, ...]
    """left_knee_flexion, trunk_lateral_bending."""
    time_s: Float[np.ndarray, " frame"]
    angle_deg: Float[np.ndarray, "frame angle"]
    """NaN = not determined."""
    sigma_deg: Float[np.ndarray, "frame angle"]
    """NaN where the trajectory has no covariance."""

    def __post_init__(self) -> None:
        shape = (len(self.time_s), len(self.names))
        for name in ("angle_deg", "sigma_deg"):
            array = getattr(self, name)
            if array.shape != shape:
                raise ValueError(f"{name} must be {shape}, got {array.shape}")
            array.setflags(write=False)

    def __getitem__(self, name: str) -> Float[np.ndarray, " frame"]:
        """An angle by name, degrees. Raises ValueError for an unknown name."""
        if name not in self.names:
            raise ValueError(f"there is no angle {name!r}; there are {', '.join(self.names)}")
        return self.angle_deg[:, self.names.index(name)]


def angle_names(skeleton: Skeleton) -> tuple[str, ...]:
    """The angles that the joints of a skeleton determine; none for one without limbs."""
    return tuple(angles_of(points_of(np.zeros((0, skeleton.n_joints, 3)), landmarks(skeleton))))


def joint_angles(trajectory: Trajectory, world_up: Literal["z", "y"] = "z") -> JointAngles:
    """The joint angles that the trajectory's skeleton determines.

    Args:
        trajectory: of one person.
        world_up: which axis of its world points up.

    Raises:
        ValueError: the skeleton determines no angle.
    """
    joints, positions_m = _joints(trajectory), z_up(trajectory.positions_m, world_up)

    def angles_rad(positions_m: np.ndarray) -> Float[np.ndarray, "frame angle"]:
        return np.stack([angle for angle, _ in angles_of(points_of(positions_m, joints)).values()], axis=-1)

    angles = angles_deg(trajectory, world_up)
    angle_deg = np.stack(list(angles.values()), axis=-1)
    sigma_deg = np.full_like(angle_deg, np.nan)
    if trajectory.covariance_m2 is not None:
        used = sorted({joint for indices in joints.values() for joint in indices})
        covariance_m2 = z_up(z_up(trajectory.covariance_m2, world_up).swapaxes(-1, -2), world_up)
        error_rad = rms_error_rad(angles_rad, positions_m, moved_by(covariance_m2, used))
        sigma_deg = np.where(np.isfinite(angle_deg), np.rad2deg(error_rad), np.nan)
    return JointAngles(tuple(angles), trajectory.time_s, angle_deg, sigma_deg)


def angles_deg(
    trajectory: Trajectory, world_up: Literal["z", "y"] = "z", *, arms_in_zxy: bool = False
) -> dict[str, Float[np.ndarray, " frame"]]:
    """The angles of joint_angles by name, without their standard deviations, which take longer; NaN = not determined.

    Args:
        trajectory: of one person.
        world_up: which axis of its world points up.
        arms_in_zxy: with the angles of definitions.arms_in_zxy as well.

    Raises:
        ValueError: the skeleton determines no angle.
    """
    points = points_of(z_up(trajectory.positions_m, world_up), _joints(trajectory))
    angles = angles_of(points) | (definitions.arms_in_zxy(points) if arms_in_zxy else {})
    return {name: np.where(determined, np.rad2deg(angle), np.nan) for name, (angle, determined) in angles.items()}


def _joints(trajectory: Trajectory) -> dict[str, tuple[int, ...]]:
    """Landmarks of the skeleton. Raises ValueError if they determine no angle."""
    skeleton = trajectory.skeleton
    if not angle_names(skeleton):
        raise ValueError(
            f"skeleton {skeleton.name} determines no joint angle: it has neither hip, knee and ankle of a side nor "
            f"shoulder, elbow and wrist, but {', '.join(skeleton.joints)}"
        )
    return landmarks(skeleton)
