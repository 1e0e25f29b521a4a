"""How far what moves in the images of two cameras is the body: only that tells their clocks.

Rays of a body that stands still meet at every lag as well, and errors of detections that last fit each other best at
some.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from fgpose.calibration.changes.rays import Rays
from fgpose.geometry.vectors import cross, dot

_HALF_SECOND_S = 0.5
# In half a second, in standard deviations of the angles between rays that meet, in the camera in which a joint moves
# less: of those three of who stands still that move most the 95 % quantile is 2.0 to 3.8, of who works or walks the
# median 6 to 8.
_BY_ERRORS = 3.0


def displacements(rays: Rays, index: Int[np.ndarray, " sample"]) -> Float[np.ndarray, "camera sample joint 3"]:
    """From the mean of the half second before to that of the half second after; NaN where half of either is not
    seen."""
    reach = max(round(_HALF_SECOND_S / rays.step_s), 1)
    n_times = rays.direction.shape[1]
    found = np.empty((rays.n_cameras, len(index), *rays.direction.shape[2:]), dtype=np.float32)
    before, after = np.maximum(index - reach, 0), np.minimum(index + reach, n_times)
    # Joint by joint: the sums over an hour of all joints of a camera take 90 MB.
    for c, joint in np.ndindex(rays.n_cameras, rays.direction.shape[2]):
        own = rays.direction[c, :, joint]
        seen = np.isfinite(own[..., :1])
        number = np.concatenate([np.zeros((1, 1)), np.cumsum(seen, axis=0)])
        total = np.concatenate([np.zeros((1, 3)), np.cumsum(np.where(seen, own, 0.0), axis=0, dtype=float)])
        of_before, of_after = number[index] - number[before], number[after] - number[index]
        known = np.minimum(of_before, of_after) >= 0.5 * reach
        with np.errstate(invalid="ignore", divide="ignore"):
            means = (total[after] - total[index]) / of_after - (total[index] - total[before]) / of_before
        found[c, :, joint] = np.where(known, means, np.nan)
    return found


def motion_share(
    moved: Float[np.ndarray, "2 sample joint 3"],
    ray: Float[np.ndarray, "sample joint 3"],
    baseline_m: Float[np.ndarray, "sample 1 3"],
    block: Int[np.ndarray, " sample"],
    n_reach: int,
    scale: float,
) -> Float[np.ndarray, "block joint"]:
    """The share that motion has in the mean square of the displacements of a joint, across the plane of its rays.

    Args:
        moved: of two cameras.
        ray: of the first.
        block: each sample's.
        n_reach: blocks, by which one camera may be later than the other.
        scale: standard deviation of the angles between rays that meet, radians.
    """
    across = cross(baseline_m, ray)
    with np.errstate(invalid="ignore", divide="ignore"):
        squared = (dot(moved, across) ** 2 / dot(across, across)).astype(float)
    known = np.isfinite(squared)
    total, number = np.zeros((2, 2, int(block.max()) + 1, squared.shape[2]))
    for own, seen, sums, numbers in zip(np.where(known, squared, 0.0), known, total, number, strict=True):
        np.add.at(sums, block, own)
        np.add.at(numbers, block, seen)
    one, other = total / np.maximum(number, 1.0)
    padded = np.pad(other, ((n_reach, n_reach), (0, 0)))
    other = np.max([padded[k : k + len(other)] for k in range(2 * n_reach + 1)], axis=0)
    least = np.minimum(one, other) / scale**2
    return np.maximum(1.0 - _BY_ERRORS**2 / np.maximum(least, 1e-9), 0.0)
