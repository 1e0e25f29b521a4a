"""What the uncertainty of joints makes of a function of them, by sigma points.

A limb that is almost straight has no plane, and an angle of three points has no gradient at zero: a Jacobian would
state nonsense there. So joints are moved by what their covariance says, along each of its axes and both ways, and the
mean square of what the angle does is taken by Gauss-Hermite quadrature of three points. Where an angle is linear this
is propagation by the Jacobian; of the length of a vector at zero it is the exact mean square.

Joints are taken for independent. Their errors are not, for bones couple them: but with the whole covariance of a frame,
from the graph, the share of errors within one standard deviation changed by at most 2 % for every angle but lateral
bending of the trunk (63 to 70 % on occluded recordings of the benchmark, 68 to 76 % on clean ones), because bones
couple joints along themselves and an angle depends on what is across them.

Nor are the errors of detections independent: a network that has one shoulder too far to the side has the other one so
too. A trajectory does not say how far. The sigma of the trunk's lateral bending, which follows what both shoulders and
both hips have in common, is therefore too small: with errors of real networks by a third (83 % of the
errors within 1.96 sigma), that of the shoulder's plane of elevation by a third where each camera has constant
errors of 10 to 30 mm (85 to 87 %). Others are too large instead, such as those of the spine.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Float

# Of the three points of Gauss-Hermite quadrature, in standard deviations: the outer two, of weight 1/6.
_STEP, _WEIGHT = np.sqrt(3.0), 1.0 / 6.0


def principal_axes(
    covariance_m2: Float[np.ndarray, "frame 3 3"],
) -> Float[np.ndarray, "3 frame 3"]:
    """Deviations of a point whose outer products add up to its covariance; NaN where that is unknown."""
    known = np.asarray(np.isfinite(covariance_m2).all(axis=(-2, -1)))[:, None, None]
    values, vectors = np.linalg.eigh(np.where(known, covariance_m2, 0.0))
    axes_m = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    return np.moveaxis(np.where(known, axes_m, np.nan), -1, 0)


def mean_squares_rad2(
    angles_rad: Callable[[np.ndarray], Mapping[str, Float[np.ndarray, " frame"]]],
    position_m: Float[np.ndarray, "frame 3"],
    covariance_m2: Float[np.ndarray, "frame 3 3"],
) -> dict[str, Float[np.ndarray, " frame"]]:
    """Mean square error of angles because of one joint: their variance, and the squared bias where they are curved.

    Args:
        angles_rad: as functions of the position of the joint, by name.
        position_m: as estimated.
        covariance_m2: of it.
    """
    at = angles_rad(position_m)
    mean_square = {name: np.zeros_like(angle) for name, angle in at.items()}
    for axis_m in principal_axes(covariance_m2):
        for step in (-_STEP, _STEP):
            for name, angle in angles_rad(position_m + step * axis_m).items():
                mean_square[name] += _WEIGHT * _wrapped(angle - at[name]) ** 2
    return mean_square


def _wrapped(angle_rad: np.ndarray) -> np.ndarray:
    return (angle_rad + np.pi) % (2 * np.pi) - np.pi
