"""How fast joints move, and how high they are."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.geometry.up_axis import WorldUp, z_up
from fgpose.sampling import are_gaps
from fgpose.skeleton import Skeleton


def speeds_m_s(
    positions_m: Float[np.ndarray, "frame ... 3"], time_s: Float[np.ndarray, " frame"]
) -> Float[np.ndarray, "frame ..."]:
    """Speed of every joint by second-order central differences (one-sided at both ends); NaN in a gap and beside it,
    where frames are missing too.

    Raises:
        ValueError: the times do not increase.
    """
    if not (np.diff(time_s) > 0).all():
        raise ValueError("time_s must increase to have speeds")
    if len(time_s) < 2:
        return np.full(positions_m.shape[:-1], np.nan)
    gaps = are_gaps(time_s)
    beside = np.concatenate([[False], gaps]) | np.concatenate([gaps, [False]])
    known = np.isfinite(positions_m).all(axis=-1) & ~beside.reshape(-1, *(1,) * (positions_m.ndim - 2))
    # At even times the difference of the neighbours says nothing of the frame itself.
    return np.where(known, np.linalg.norm(np.gradient(positions_m, time_s, axis=0), axis=-1), np.nan)


def centre_m(positions_m: Float[np.ndarray, "*frames joint 3"], skeleton: Skeleton) -> Float[np.ndarray, "*frames 3"]:
    """The root of the body, metres: the pelvis, or the middle of the hips."""
    return positions_m[..., list(skeleton.root), :].mean(axis=-2)


def heights_m(
    positions_m: Float[np.ndarray, "*points 3"], world_up: WorldUp = "z", floor_m: float = 0.0
) -> Float[np.ndarray, "*points"]:
    """Heights above the floor.

    Args:
        positions_m: in the world frame.
        world_up: what is up in it.
        floor_m: height of the floor above the origin.
    """
    return z_up(positions_m, world_up)[..., 2] - floor_m
