"""How large somebody is in the image: the unit of distances that do not depend on how far away they are."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

STANDING = 0.1
"""Somebody who stands still tells a tenth of what a walker at one radius of the body (0.5 m) per second does."""
INLIER_SHARE = 0.2
"""Of the body's radius: joints of views that are further apart are not those of one person."""
# Somebody who walks towards the camera grows by a fifth in this time at most; a crouch or a missing joint is over.
_MEDIAN_S = 1.0


def body_radius(points: Float[np.ndarray, "*shape joint 2"]) -> Float[np.ndarray, "*shape"]:
    """Root mean square distance of the known joints from their mean, in the unit of the points; about 0.5 m of somebody
    upright. NaN with fewer than two joints."""
    known = np.isfinite(points).all(axis=-1, keepdims=True)
    count = known.sum(axis=-2, keepdims=True)
    mean = np.where(known, points, 0.0).sum(axis=-2, keepdims=True) / np.maximum(count, 1)
    square = np.where(known, points - mean, 0.0) ** 2
    radius = np.sqrt(square.sum(axis=(-1, -2)) / np.maximum(count[..., 0, 0], 1))
    return np.where((count[..., 0, 0] > 1) & (radius > 0), radius, np.nan)


def steady_radius(
    time_s: Float[np.ndarray, " image"], points: Float[np.ndarray, "image joint 2"]
) -> Float[np.ndarray, " image"]:
    """The same, as a running median over a second; in images that show nobody that of the nearest that does."""
    from scipy.ndimage import median_filter

    radius = body_radius(points)
    known = np.flatnonzero(np.isfinite(radius))
    if not known.size:
        return radius
    radius = np.interp(time_s, time_s[known], radius[known])
    step_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else _MEDIAN_S
    return median_filter(radius, size=max(round(_MEDIAN_S / step_s) | 1, 1), mode="nearest")


def mean_joint(points: Float[np.ndarray, "image joint 2"]) -> Float[np.ndarray, "image 2"]:
    """Centre of the known joints; NaN without any."""
    known = np.isfinite(points).all(axis=-1, keepdims=True)
    count = known.sum(axis=1)
    return np.where(count > 0, np.where(known, points, 0.0).sum(axis=1) / np.maximum(count, 1), np.nan)
