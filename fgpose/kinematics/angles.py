"""Joint angles of a trajectory, each with its standard deviation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from fgpose.kinematics.definitions import angles_of
from fgpose.kinematics.landmarks import landmarks, points_of
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
    return tuple(angles_of(points_of(np.zeros((skeleton.n_joints, 3)), landmarks(skeleton))))


def joint_angles(trajectory: Trajectory, world_up: Literal["z", "y"] = "z") -> JointAngles:
    """The joint angles that the trajectory's skeleton determines.

    Args:
        trajectory: of one person.
        world_up: which axis of its world points up.

    Raises:
        ValueError: the skeleton determines no angle.
    """
    names = angle_names(trajectory.skeleton)
    if not names:
        raise ValueError(f"skeleton {trajectory.skeleton.name} determines no joint angle: {_LACKS}")
    axes = [0, 1, 2] if world_up == "z" else [2, 0, 1]
    joints = landmarks(trajectory.skeleton)
    positions_m = trajectory.positions_m[..., axes]

    def angles_rad(positions_m: np.ndarray) -> Float[np.ndarray, "frame angle"]:
        return np.stack([angle for angle, _ in angles_of(points_of(positions_m, joints)).values()], axis=-1)

    determined = np.stack(
        [np.broadcast_to(where, len(positions_m)) for _, where in angles_of(points_of(positions_m, joints)).values()],
        axis=-1,
    )
    angle_rad = np.where(determined, angles_rad(positions_m), np.nan)
    sigma_rad = np.full_like(angle_rad, np.nan)
    if trajectory.covariance_m2 is not None:
        used = sorted({joint for indices in joints.values() for joint in indices})
        deviations_m = moved_by(trajectory.covariance_m2[..., axes, :][..., axes], used)
        sigma_rad = np.where(determined, rms_error_rad(angles_rad, positions_m, deviations_m), np.nan)
    return JointAngles(names, trajectory.time_s, np.rad2deg(angle_rad), np.rad2deg(sigma_rad))


_LACKS = "it has no hip, knee and ankle, and no shoulder, elbow and wrist"
