"""Which way is up in a world, and the rotation to one whose z is up. Everything that needs a vertical turns by it."""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Float

UpAxis = Literal["x", "y", "z", "+x", "-x", "+y", "-y", "+z", "-z"]
"""An axis of the world that points up; z is +z. -y is the world of a camera (OpenCV): y down, z away from it."""
WorldUp = UpAxis | tuple[float, float, float]
"""An axis, or a direction of any length where the world is tilted."""
UpChoice = Literal["auto", "x", "y", "z", "+x", "-x", "+y", "-y", "+z", "-z"]
"""What a user says; auto: as the body stands (kinematics/vertical.py)."""

SIGNED_AXES: tuple[Literal["+x", "-x", "+y", "-y", "+z", "-z"], ...] = ("+x", "-x", "+y", "-y", "+z", "-z")
# Rows: forward, left and up of a world with z up, in the axes of the world. Of +y they are those of OpenSim's and of
# most animation programs' world (z forward, x to the left), of -y those of a camera.
_Z_UP_R_WORLD = {
    "+z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "-z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "+y": ((0, 0, 1), (1, 0, 0), (0, 1, 0)),
    "-y": ((0, 0, 1), (-1, 0, 0), (0, -1, 0)),
    "+x": ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
    "-x": ((0, 1, 0), (0, 0, -1), (-1, 0, 0)),
}


def up_vector(world_up: WorldUp) -> Float[np.ndarray, " 3"]:
    """Of length 1, in the world. Raises ValueError unless it is an axis or a direction."""
    if isinstance(world_up, str):
        sign, axis = (-1.0 if world_up[:1] == "-" else 1.0), world_up[-1:]
        if axis not in ("x", "y", "z") or world_up not in (axis, f"+{axis}", f"-{axis}"):
            raise ValueError(f"the axis that points up must be one of {', '.join(SIGNED_AXES)}, got {world_up!r}")
        return sign * np.eye(3)["xyz".index(axis)]
    direction = np.array(world_up, dtype=float)
    length = float(np.linalg.norm(direction))
    if direction.shape != (3,) or not np.isfinite(length) or length == 0.0:
        raise ValueError(f"the direction that is up must be three numbers that are not all zero, got {world_up}")
    return direction / length


def nearest_axis(world_up: WorldUp) -> Literal["+x", "-x", "+y", "-y", "+z", "-z"]:
    """The axis nearest to what is up."""
    up = up_vector(world_up)
    return max(SIGNED_AXES, key=lambda axis: float(up_vector(axis) @ up))


def z_up_R_world(world_up: WorldUp) -> Float[np.ndarray, "3 3"]:
    """The rotation to a world with z up: exchanges and signs of axes; of a tilted world, after the shortest rotation
    that levels it."""
    axis = nearest_axis(world_up)
    exchanged = np.array(_Z_UP_R_WORLD[axis], dtype=float)
    if isinstance(world_up, str):
        return exchanged
    tilted = exchanged @ up_vector(world_up)
    across = np.cross(tilted, (0.0, 0.0, 1.0))
    cross = np.array([[0, -across[2], across[1]], [across[2], 0, -across[0]], [-across[1], across[0], 0]])
    # Rodrigues' formula between two unit vectors that are less than 90 degrees apart.
    return (np.eye(3) + cross + cross @ cross / (1.0 + tilted[2])) @ exchanged


def z_up(vectors: Float[np.ndarray, "*points 3"], world_up: WorldUp) -> Float[np.ndarray, "*points 3"]:
    """Vectors of a world in one with z up."""
    return _turned(vectors, z_up_R_world(world_up))


def from_z_up(vectors: Float[np.ndarray, "*points 3"], world_up: WorldUp) -> Float[np.ndarray, "*points 3"]:
    """The inverse of z_up."""
    return _turned(vectors, z_up_R_world(world_up).T)


def y_up(vectors: Float[np.ndarray, "*points 3"], world_up: WorldUp) -> Float[np.ndarray, "*points 3"]:
    """Vectors of a world in OpenSim's axes (x forward, y up, z right); of z up as Pose2Sim does, [Y, Z, X]."""
    return z_up(vectors, world_up)[..., [1, 2, 0]]


def _turned(
    vectors: Float[np.ndarray, "*points 3"], rotation: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, "*points 3"]:
    """Exact where axes are only exchanged."""
    order = np.abs(rotation).argmax(axis=1)
    if np.count_nonzero(rotation) == len(rotation):
        return vectors[..., order] * rotation[range(3), order]
    return vectors @ rotation.T
