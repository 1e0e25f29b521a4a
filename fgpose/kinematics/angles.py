"""Joint angles of a trajectory, each with its standard deviation."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int

from fgpose.geometry.up_axis import WorldUp, z_up, z_up_R_world
from fgpose.kinematics import definitions
from fgpose.kinematics.definitions import angles_of
from fgpose.kinematics.errors.propagation import Effect, effects_on
from fgpose.kinematics.errors.shared_errors import SharedErrors
from fgpose.kinematics.landmarks import landmarks, points_of
from fgpose.kinematics.quantities import Quantities
from fgpose.kinematics.ranges import AngleRanges, ranges_without_noise
from fgpose.sampling import parts_of
from fgpose.shown.wrong_types import check_type
from fgpose.skeleton import Skeleton
from fgpose.skeletons import named_skeleton
from fgpose.trajectory import Trajectory

_AT_ONCE = 250  # frames: what bones say of all joints of a whole body takes half a megabyte of each


@dataclass(frozen=True, eq=False, repr=False)
class JointAngles(Quantities):
    """Joint angles over time (left_knee_flexion, trunk_lateral_bending), see definitions.py for what each is.

    Raises:
        ValueError: the arrays' shapes disagree.
    """

    kind: ClassVar[str] = "angle"
    unit: ClassVar[str] = "deg"
    suffix: ClassVar[str] = "deg"

    angle_deg: Float[np.ndarray, "frame angle"]
    """NaN = not determined."""
    sigma_deg: Float[np.ndarray, "frame angle"]
    """NaN where the trajectory has no covariance."""
    frame_numbers: Int[np.ndarray, " frame"] | None = None
    """Those of the trajectory."""

    @property
    def value(self) -> Float[np.ndarray, "frame angle"]:
        return self.angle_deg

    @property
    def sigma(self) -> Float[np.ndarray, "frame angle"]:
        return self.sigma_deg

    def quantiles(self, shares: Sequence[float]) -> Float[np.ndarray, "share angle"]:
        """As quantiles_deg, which are on the circle."""
        return self.quantiles_deg(shares)

    def quantiles_deg(self, shares: Sequence[float]) -> Float[np.ndarray, "share angle"]:
        """Quantiles of each angle over time, NaN where it is never determined: on the circle, opened where no angle is
        for the farthest, so that one that goes on at -180 when it has reached 180 has no quantiles in between. They
        may be beyond 180, where the median is within.

        Args:
            shares: of the frames in which an angle is determined, from 0 to 1.
        """
        quantiles_deg = np.full((len(shares), len(self.names)), np.nan)
        for index, angle_deg in enumerate(self._opened_deg().T):
            known_deg = angle_deg[np.isfinite(angle_deg)]
            if len(known_deg):
                quantiles_deg[:, index] = np.quantile(known_deg, shares)
        return quantiles_deg

    def ranges(self, shares: Sequence[float]) -> AngleRanges:
        """The same quantiles without what noise adds to them, which makes extremes too extreme, each with a standard
        deviation of its own (fgpose.kinematics.ranges); as quantiles_deg where no standard deviation is known."""
        return ranges_without_noise(self.time_s, self._opened_deg(), self.sigma_deg, np.array(shares, dtype=float))

    def _opened_deg(self) -> Float[np.ndarray, "frame angle"]:
        """The angles, with whole turns added so that each goes on where it would jump."""
        opened_deg = np.array(self.angle_deg, dtype=float)
        for angle_deg in opened_deg.T:
            known = np.isfinite(angle_deg)
            if known.any():
                ordered_deg = np.sort(angle_deg[known] % 360)
                first_deg = ordered_deg[int(np.argmax(np.diff(ordered_deg, prepend=ordered_deg[-1] - 360)))]
                angle_deg[known] = (angle_deg[known] - first_deg) % 360 + first_deg
                angle_deg -= 360 * np.floor((np.median(angle_deg[known]) + 180) / 360)
        return opened_deg


def angle_names(skeleton: Skeleton | str) -> tuple[str, ...]:
    """The angles that the joints of a skeleton determine, also of one by its name; none for one without limbs."""
    skeleton = named_skeleton(skeleton)
    return tuple(angles_of(points_of(np.zeros((0, skeleton.n_joints, 3)), landmarks(skeleton))))


def joint_angles(trajectory: Trajectory, world_up: WorldUp = "z") -> JointAngles:
    """The joint angles that the trajectory's skeleton determines.

    Args:
        trajectory: of one person.
        world_up: what is up in its world.

    Raises:
        ValueError: the skeleton determines no angle.
        TypeError: it is no trajectory.
    """
    check_type("joint_angles", "trajectory", trajectory, Trajectory)
    angles = angles_deg(trajectory, world_up)
    angle_deg = np.stack(list(angles.values()), axis=-1)
    sigma_deg = np.full_like(angle_deg, np.nan)
    if trajectory.covariance_m2 is not None:
        turned = trajectory.turned(z_up_R_world(world_up))
        sigma_rad = _sigma_rad(turned, _joints(trajectory))
        sigma_deg = np.rad2deg(np.stack([sigma_rad[name] for name in angles], axis=-1))
        sigma_deg[np.isnan(angle_deg)] = np.nan
    return JointAngles(tuple(angles), trajectory.time_s, angle_deg, sigma_deg, trajectory.frame_numbers)


def _sigma_rad(trajectory: Trajectory, joints: dict[str, tuple[int, ...]]) -> dict[str, Float[np.ndarray, " frame"]]:
    """Of every angle; the world has z up."""
    assert trajectory.covariance_m2 is not None
    used = sorted({joint for indices in joints.values() for joint in indices})
    errors = SharedErrors.of(trajectory, used)
    sigma_rad = defaultdict[str, np.ndarray](lambda: np.zeros(trajectory.n_frames))
    for part in parts_of(trajectory.n_frames, _AT_ONCE):
        positions_m, covariance_m2 = trajectory.positions_m[part], trajectory.covariance_m2[part].astype(float)
        gradient_rad: dict[str, np.ndarray] = {}
        slots = np.searchsorted(errors.joints, used).tolist()
        for slot, effects in zip(slots, _effects(positions_m, covariance_m2, joints, used), strict=True):
            for name, effect in effects.items():
                of_all = gradient_rad.setdefault(name, np.zeros((len(positions_m), len(errors.joints), 3)))
                of_all[:, slot] = effect.gradient_rad
                sigma_rad[name][part] += effect.curved_rad2
        correlation = errors.correlation(positions_m, covariance_m2)
        for name, of_all in gradient_rad.items():
            flat = of_all.reshape(len(positions_m), -1)
            rad2 = np.einsum("ta,tab,tb->t", flat, correlation, flat, optimize=True)
            sigma_rad[name][part] = np.sqrt(np.maximum(rad2, 0.0) + sigma_rad[name][part])
    return sigma_rad


def _effects(
    positions_m: Float[np.ndarray, "frame joint 3"],
    covariance_m2: Float[np.ndarray, "frame joint 3 3"],
    joints: dict[str, tuple[int, ...]],
    used: Sequence[int],
) -> Iterator[dict[str, Effect]]:
    """Of the errors of these joints, one by one, on every angle that depends on them."""
    points = points_of(positions_m, joints)
    for joint in used:
        moved = {name: indices for name, indices in joints.items() if joint in indices}

        def angles_rad(position_m: np.ndarray, joint=joint, moved=moved) -> dict[str, Float[np.ndarray, " frame"]]:
            change_m = position_m - positions_m[:, joint]
            around = points | {name: points[name] + change_m / len(indices) for name, indices in moved.items()}
            return {name: angle for name, (angle, _) in angles_of(around, moved).items()}

        yield effects_on(angles_rad, positions_m[:, joint], covariance_m2[:, joint])


def angles_deg(
    trajectory: Trajectory, world_up: WorldUp = "z", *, arms_in_zxy: bool = False
) -> dict[str, Float[np.ndarray, " frame"]]:
    """The angles of joint_angles by name, without their standard deviations, which take longer; NaN = not determined.

    Args:
        trajectory: of one person.
        world_up: what is up in its world.
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
