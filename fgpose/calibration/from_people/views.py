"""A track as directions of rays, which can be asked for any time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.calibration.from_people.body_size import steady_radius
from fgpose.calibration.from_people.interpolation import between_images
from fgpose.calibration.from_people.walk import Track
from fgpose.geometry.camera import Camera

# Half of the time over which the velocity is taken. It must be the same before and after: the noise of a detection is
# then not correlated with the velocity at its time, which would shift the clocks.
_HALF_S = 0.07


@dataclass(frozen=True, eq=False)
class View:
    """One walker in the image at unit focal length, without distortion."""

    time_s: Float[np.ndarray, " image"]
    xy: Float[np.ndarray, "image joint 2"]
    """NaN = missing."""
    radius: Float[np.ndarray, " image"]
    """Of the body, running median."""

    @staticmethod
    def of(track: Track, camera: Camera) -> View:
        """With the intrinsics of a camera, known or guessed; its pose does not matter."""
        xy = (camera.undistort(track.points2d_px) - camera.K[:2, 2]) / np.diag(camera.K)[:2]
        return View(track.time_s, xy, steady_radius(track.time_s, xy))

    def at(self, time_s: Float[np.ndarray, " sample"]) -> Float[np.ndarray, "sample joint 2"]:
        """Joints between two images; NaN where not known in both."""
        return between_images(self.time_s, self.xy, time_s)

    def velocity_at(self, time_s: Float[np.ndarray, " sample"]) -> Float[np.ndarray, "sample joint 2"]:
        """Per second, from as long before as after."""
        half_s = max(_HALF_S, self._step_s)
        return (self.at(time_s + half_s) - self.at(time_s - half_s)) / (2 * half_s)

    def radius_at(self, time_s: Float[np.ndarray, " sample"]) -> Float[np.ndarray, " sample"]:
        return np.interp(time_s, self.time_s, self.radius)

    @property
    def _step_s(self) -> float:
        return float(np.median(np.diff(self.time_s))) if len(self.time_s) > 1 else 0.0
