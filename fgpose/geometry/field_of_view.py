"""What is in the image of a camera, and what is beyond it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.geometry.camera import CameraRig
from fgpose.geometry.vectors import norm

# The lens model is exact to 1e-6 px where it has an inverse; a point far outside the image that it folds back into the
# image is off by tens of pixels.
_MAX_ROUND_TRIP_PX = 1.0


def in_views(
    rig: CameraRig, points_m: Float[np.ndarray, "point 3"], margin: float = 0.0
) -> Bool[np.ndarray, "point camera"]:
    """Whether each world point lies in the image of each camera. What hides it is not known here.

    Args:
        rig: the cameras.
        points_m: in the world, metres; NaN lies in no image.
        margin: how far from the edges it has to lie, as a share of the sides.
    """
    inside = np.zeros((len(points_m), rig.n_cameras), dtype=bool)
    for number, camera in enumerate(rig.cameras):
        undistorted_px = camera.project(points_m)
        original_px, edge_px = camera.distort(undistorted_px), margin * np.array(camera.size_px)
        within = (original_px >= edge_px) & (original_px < camera.size_px - edge_px)
        inside[:, number] = candidates = within.all(axis=-1)
        if camera.distorts:
            back_px = camera.undistort(original_px[candidates])
            error_px = norm(back_px - undistorted_px[candidates])
            inside[candidates, number] = error_px < _MAX_ROUND_TRIP_PX
    return inside


def clipped(
    points_px: Float[np.ndarray, "*#points 2"], size_px: Int[np.ndarray, "*#points 2"]
) -> Bool[np.ndarray, "*points"]:
    """Whether points stand exactly on the border of their image, of this width and height: a network puts joints that
    it guesses outside the image there. They are somewhere beyond."""
    return np.asarray(((points_px == 0) | (points_px == size_px - 1) | (points_px == size_px)).any(axis=-1))
