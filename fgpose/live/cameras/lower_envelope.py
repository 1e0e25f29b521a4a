"""The line below points that is as high as it can be: what delays are when nothing is in the way."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def lower_hull(xy: Float[np.ndarray, "point 2"]) -> list[int]:
    """Numbers of the points on the lower convex hull, from left to right; x increases strictly (Andrew's chain)."""
    hull: list[int] = []
    points = xy.tolist()
    for k, (x_k, y_k) in enumerate(points):
        while len(hull) > 1:
            (x_i, y_i), (x_j, y_j) = points[hull[-2]], points[hull[-1]]
            if (y_j - y_i) * (x_k - x_i) < (y_k - y_i) * (x_j - x_i):
                break
            hull.pop()
        hull.append(k)
    return hull


def envelope_line(
    xy: Float[np.ndarray, "point 2"],
    mean_x: float,
    weight: float,
    slope: float,
    slope_sigma: float,
) -> tuple[float, float]:
    """Slope, and height at mean_x, of the most probable line below all points.

    The points lie above the line by exponentially distributed distances; then the likelihood of a line is its height at
    the mean of all x: the linear programme of Moon, Skelly and Towsley (Estimation and removal of clock skew from
    network delay measurements, INFOCOM 1999). A normal distribution of the slope is added, because a few points
    do not determine it.

    Args:
        xy: x increases strictly.
        mean_x: of all points that the line is for, of which these may be the lowest only.
        weight: their number divided by their mean distance from the line.
        slope: expected.
        slope_sigma: of the expectation.
    """
    hull_x, hull_y = xy[lower_hull(xy)].T
    edges = (hull_y[1:] - hull_y[:-1]) / (hull_x[1:] - hull_x[:-1])
    # With slopes between these the line touches the hull at that point.
    bounds = np.concatenate([[-np.inf], edges, [np.inf]])
    wanted = slope + slope_sigma**2 * weight * (mean_x - hull_x)
    slopes = np.minimum(np.maximum(wanted, bounds[:-1]), bounds[1:])
    heights = hull_y + slopes * (mean_x - hull_x)
    best = int(np.argmax(weight * heights - 0.5 * ((slopes - slope) / slope_sigma) ** 2))
    return float(slopes[best]), float(heights[best])
