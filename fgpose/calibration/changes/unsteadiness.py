"""Cameras that do not stand still: held in the hand, on a mast, or with images that electronic stabilisation shifts.

What all joints of a camera are off by at one moment, more than joints that err each by itself, is an error of the
camera, or of the point in which the cameras meet, which errs with them. In half a second a camera that stands a little
wrong changes that by millimetres; one that shakes by centimetres. The variances of all cameras are fitted to the
squares of what is seen (variance components).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from fgpose.calibration.changes.change import Change
from fgpose.calibration.changes.rays import Rays, grid_step_s, rays_of
from fgpose.estimation.covariances.detection_errors import invertible
from fgpose.estimation.evidence.plausibility import known_medians
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.sampling import parts_of

WITHIN_S = 0.5
"""A hand moves in that time, and so does an image that is stabilised; who walks is hardly elsewhere."""
# Where joints are off each by itself by more, as where one is taken for another, they tell nothing of the camera.
_ALIKE_M = 0.04
_LEAST_JOINTS = 0.5  # of those that are compared
_LEAST_S = 4.0
_USUAL = 0.95  # of the moments; where somebody goes over to somebody else, it is not the camera that moves


def unsteadiness_m(
    people: Sequence[Observations], rig: CameraRig, changes: Sequence[Change]
) -> Float[np.ndarray, " camera"]:
    """By how much the images of each camera move within WITHIN_S: the standard deviation along each axis of the image,
    in metres where the people are; NaN where too little is seen. Of two cameras only one has any, for both together.

    Args:
        people: what the cameras saw of each, by their stamps.
        rig: the cameras.
        changes: of clocks and poses, that are undone before.
    """
    from scipy.optimize import nnls

    step_s = grid_step_s(people)
    lag = max(1, round(WITHIN_S / step_s))
    rays = rays_of(people, rig, changes, step_s, lag)
    parts = [_moved(rays.between(part.start, part.stop + lag), lag) for part in parts_of(len(rays.time_s) - lag)]
    moved_m2, shares = (np.concatenate(each, axis=-1) for each in zip(*parts, strict=True))
    if moved_m2.shape[-1] * step_s < _LEAST_S:
        return np.full(rig.n_cameras, np.nan)
    together_m2 = np.nansum(moved_m2, axis=0)
    rows = np.isfinite(moved_m2) & (together_m2 <= np.quantile(together_m2, _USUAL))
    of_difference_m2, _ = nnls(shares.swapaxes(0, 1)[:, rows].T, moved_m2[rows])
    return np.where(rows.any(axis=1), np.sqrt(of_difference_m2 / 2), np.nan)


def _moved(rays: Rays, lag: int) -> tuple[Float[np.ndarray, "camera moment"], Float[np.ndarray, "camera other moment"]]:
    """The squares of how far the images of each camera move between two moments, at which at least two cameras tell;
    and how much of the variance of each other camera is in each square."""
    off_m, by_chance_m2, across = _off(rays)
    moved_m2 = np.sum((off_m[:, lag:] - off_m[:, :-lag]) ** 2, axis=-1) - by_chance_m2[:, lag:] - by_chance_m2[:, :-lag]
    tells = np.isfinite(moved_m2)
    compared = tells.sum(axis=0) >= 2
    across = np.where(tells[..., None, None], across[:, :-lag], 0.0)[:, compared]
    inverse = np.linalg.inv(invertible(across.sum(axis=0)))
    seen = np.eye(len(across))[:, :, None, None, None] * across - across[:, None] @ inverse @ across[None]
    return moved_m2[:, compared], np.sum(seen**2, axis=(-2, -1))


def _off(
    rays: Rays,
) -> tuple[
    Float[np.ndarray, "camera moment 3"], Float[np.ndarray, "camera moment"], Float[np.ndarray, "camera moment 3 3"]
]:
    """By how much the rays of each camera miss the joints all alike, where those of all cameras meet (least squares),
    NaN where they do not; how much of its square joints that err each by itself make; and the part across the ray,
    A = I - d d', of each camera.

    Shifts s_k of the images put a point off by M^-1 sum(A_k s_k), M being the sum of all A. So of s_k
    [c = k] A_c - A_c M^-1 A_k is seen in camera c.
    """
    seen = rays.weight > 0
    across = np.eye(3) - rays.direction[..., :, None] * rays.direction[..., None, :]
    across = np.where(seen[..., None, None], across, 0.0)
    enough = (seen.sum(axis=0) >= 2)[..., None]
    inverse = np.linalg.inv(invertible(across.sum(axis=0)))
    centre_m = np.nan_to_num(rays.centre_m)[:, :, None, :, None]
    point_m = inverse @ np.sum(across @ centre_m, axis=0)
    miss_m = np.where(seen[..., None] & enough, (across @ (point_m - centre_m))[..., 0], np.nan)
    off_m = np.stack([known_medians(of_camera) for of_camera in miss_m])
    apart_m = np.linalg.norm(miss_m - off_m[:, :, None], axis=-1, keepdims=True)
    apart_m = np.stack([known_medians(of_camera)[:, 0] for of_camera in apart_m])
    shows = seen.mean(axis=2) >= _LEAST_JOINTS
    tells = shows & (apart_m < _ALIKE_M)
    off_m[~tells | (shows & ~tells).any(axis=0)] = np.nan
    middle = np.where(seen[..., None], rays.direction, 0.0).sum(axis=2)
    middle /= np.maximum(np.linalg.norm(middle, axis=-1, keepdims=True), 1e-9)
    # Of two axes half of all errors are within 1.18 sigma; the variance of a median is pi / 2 times that of a mean.
    by_chance_m2 = 2 * (np.pi / 2) * (apart_m / 1.18) ** 2 / np.maximum(seen.sum(axis=2), 1)
    return off_m, by_chance_m2, np.eye(3) - middle[..., :, None] * middle[..., None, :]
