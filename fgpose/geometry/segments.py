"""Where two segments are nearest to each other."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.geometry.vectors import dot


def nearest_on_segments(
    a0_m: Float[np.ndarray, "*#shape 3"],
    a1_m: Float[np.ndarray, "*#shape 3"],
    b0_m: Float[np.ndarray, "*#shape 3"],
    b1_m: Float[np.ndarray, "*#shape 3"],
) -> tuple[Float[np.ndarray, "*shape"], Float[np.ndarray, "*shape"], Float[np.ndarray, "*shape"]]:
    """How far along a0-a1 and b0-b1 their nearest points lie, 0 to 1, and the distance of these in metres (Ericson,
    Real-Time Collision Detection, 5.1.9).

    A segment may be a point. Of parallel segments one of the nearest pairs is returned.
    """
    a, b, apart = a1_m - a0_m, b1_m - b0_m, a0_m - b0_m
    aa, bb = np.maximum(dot(a, a), 1e-12), np.maximum(dot(b, b), 1e-12)
    ab, a_apart, b_apart = dot(a, b), dot(a, apart), dot(b, apart)
    along_a = np.clip((ab * b_apart - a_apart * bb) / np.maximum(aa * bb - ab**2, 1e-12), 0.0, 1.0)
    along_b = np.clip((ab * along_a + b_apart) / bb, 0.0, 1.0)
    along_a = np.clip((ab * along_b - a_apart) / aa, 0.0, 1.0)
    # |apart + along_a a - along_b b|^2 without vectors of every pair; rounding leaves 1e-7 m where they touch.
    distance_m2 = dot(apart, apart) + along_a * (along_a * aa + 2 * a_apart - 2 * along_b * ab)
    distance_m2 += along_b * (along_b * bb - 2 * b_apart)
    return np.asarray(along_a), np.asarray(along_b), np.asarray(np.sqrt(np.maximum(distance_m2, 0.0)))
