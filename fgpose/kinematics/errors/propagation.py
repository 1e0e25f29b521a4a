"""What the uncertainty of joints makes of a function of them, by sigma points.

A limb that is almost straight has no plane, and an angle of three points has no gradient at zero: a Jacobian would
state nonsense there. So joints are moved by what their covariance says, along each of its axes and both ways, and the
mean square of what the angle does is taken by Gauss-Hermite quadrature of three points. Where an angle is linear this
is propagation by the Jacobian; of the length of a vector at zero it is the exact mean square.

The differences of both ways are the gradient, by which errors of several joints add up as far as they are the same
(shared_errors); what is left of the mean square is curvature, of which each joint has its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

# Of the three points of Gauss-Hermite quadrature, in standard deviations: the outer two, of weight 1/6.
_STEP, _WEIGHT = np.sqrt(3.0), 1.0 / 6.0


@dataclass(frozen=True, eq=False)
class Effect:
    """Of the error of one joint on an angle."""

    gradient_rad: Float[np.ndarray, "frame 3"]
    """By errors in units of the symmetric root of the joint's covariance."""
    curved_rad2: Float[np.ndarray, " frame"]
    """Mean square error beyond that of the gradient: where the angle is curved, with its squared bias."""


def symmetric_root(
    covariance: Float[np.ndarray, "*joints 3 3"],
) -> tuple[Float[np.ndarray, "*joints 3 3"], Float[np.ndarray, "*joints 3 3"]]:
    """The symmetric matrix whose square is a covariance, and the inverse of it; 0 along what has no variance."""
    values, vectors = np.linalg.eigh(covariance)
    sigma = np.sqrt(np.maximum(values, 0.0))[..., None, :]
    inverse = np.divide(1.0, sigma, out=np.zeros_like(sigma), where=sigma > 0)
    return (vectors * sigma) @ vectors.swapaxes(-1, -2), (vectors * inverse) @ vectors.swapaxes(-1, -2)


def effects_on(
    angles_rad: Callable[[np.ndarray], Mapping[str, Float[np.ndarray, " frame"]]],
    position_m: Float[np.ndarray, "frame 3"],
    covariance_m2: Float[np.ndarray, "frame 3 3"],
) -> dict[str, Effect]:
    """What the error of a joint does to angles; NaN where its covariance is unknown.

    Args:
        angles_rad: as functions of the position of the joint, by name.
        position_m: as estimated.
        covariance_m2: of it.
    """
    known = np.asarray(np.isfinite(covariance_m2).all(axis=(-2, -1)))[:, None, None]
    values, vectors = np.linalg.eigh(np.where(known, covariance_m2, 0.0))
    vectors = np.where(known, vectors, np.nan)
    at = angles_rad(position_m)
    gradient_rad = {name: np.zeros((len(position_m), 3)) for name in at}
    curved_rad2 = {name: np.zeros(len(position_m)) for name in at}
    for axis in range(3):
        step_m = _STEP * vectors[:, :, axis] * np.sqrt(np.maximum(values[:, axis, None], 0.0))
        back, forth = (angles_rad(position_m + sign * step_m) for sign in (-1, 1))
        for name, angle in at.items():
            to_rad, fro_rad = _wrapped(forth[name] - angle), _wrapped(back[name] - angle)
            gradient_rad[name] += vectors[:, :, axis] * ((to_rad - fro_rad) / (2 * _STEP))[:, None]
            curved_rad2[name] += _WEIGHT * (to_rad + fro_rad) ** 2 / 2
    return {name: Effect(gradient_rad[name], curved_rad2[name]) for name in at}


def _wrapped(angle_rad: np.ndarray) -> np.ndarray:
    return (angle_rad + np.pi) % (2 * np.pi) - np.pi
