"""The image with which something of a camera changed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from fgpose.calibration.changes.change import Change, later_s
from fgpose.calibration.changes.lag_costs import angle, weighted
from fgpose.calibration.changes.rays import Rays, rays_of
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose_factors.robust_statistics import robust_sigma


def turning_point_s(
    people: Sequence[Observations],
    rig: CameraRig,
    before: Sequence[Change],
    after: Sequence[Change],
    c: int,
    step_s: float,
    near_s: float,
    reach_s: float,
) -> float:
    """By the stamps of a camera: before it the one changes suit its images best, from it on the others.

    Args:
        before, after: the changes, each as if it held all the time.
        c: the camera.
        step_s: of the grid on which rays are compared.
        near_s: about when, by the common clock.
        reach_s: how far from there it may be.
    """
    near = [part for own in people if (part := _near(own, near_s, 2 * reach_s + 1.0)) is not None]
    stamp_s = np.arange(near_s - reach_s, near_s + reach_s, step_s)
    stamp_s = stamp_s - float(later_s(after, c, np.array([near_s]))[0])
    with_before, with_after = (_cost(near, rig, changes, c, step_s, stamp_s) for changes in (before, after))
    total = np.cumsum(with_before - with_after)
    return float(stamp_s[int(np.argmin(np.concatenate([[0.0], total[:-1]])))]) - step_s / 2


def _near(own: Observations, near_s: float, reach_s: float) -> Observations | None:
    there = np.abs(own.frame_time_s - near_s) <= reach_s
    return own.frames(there) if there.sum() > 1 else None


def _cost(
    people: Sequence[Observations],
    rig: CameraRig,
    changes: Sequence[Change],
    c: int,
    step_s: float,
    stamp_s: Float[np.ndarray, " time"],
) -> Float[np.ndarray, " time"]:
    """Of the images with these stamps."""
    total = np.zeros(len(stamp_s))
    for own in people:
        rays = rays_of([own], rig, changes, step_s, 0)
        taken_s = stamp_s + later_s(changes, c, stamp_s) + rig.cameras[c].time_offset_s
        total += np.interp(taken_s, rays.time_s, _of_rays(rays, c), left=0.0, right=0.0)
    return total


def _of_rays(rays: Rays, c: int) -> Float[np.ndarray, " time"]:
    others = [o for o in range(rays.n_cameras) if o != c]
    baseline_m = (rays.centre_m[c] - rays.centre_m[others])[:, :, None]
    angles = angle(rays.direction[others], rays.direction[c][None], baseline_m)
    weight = np.minimum(rays.weight[others], rays.weight[c])
    scale = max(robust_sigma(angles), 1e-4) if np.isfinite(angles).any() else 1.0
    return weighted(angles, weight, scale).sum(axis=(0, 2))
