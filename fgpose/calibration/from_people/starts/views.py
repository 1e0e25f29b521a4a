"""A track as directions of rays, which can be asked for any time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.calibration.from_people.body_size import steady_radius
from fgpose.calibration.from_people.walk import Track
from fgpose.geometry.camera import Camera
from fgpose.geometry.epipolar_distance import essential_matrix
from fgpose.sampling import between_images, usual_step_s

# Half of the time over which a velocity is taken. Noise is less than that of one step, and a walker's swinging foot
# keeps its velocity for longer.
_HALF_S = 0.07
HALF_STRIDE_S, _MIN_STRIDES = 0.55, 10


@dataclass(frozen=True, eq=False)
class View:
    """One walker in the image at unit focal length, without distortion."""

    time_s: Float[np.ndarray, " image"]
    xy: Float[np.ndarray, "image joint 2"]
    """NaN = missing."""
    radius: Float[np.ndarray, " image"]
    """Of the body, running median."""
    camera_T_world: Float[np.ndarray, "4 4"] | None = None
    """None: it is not known where the camera is."""

    @staticmethod
    def of(track: Track, camera: Camera, *, placed: bool = False) -> View:
        """With the intrinsics of a camera, known or guessed.

        Args:
            placed: whether the pose of the camera is known; otherwise it does not matter.
        """
        xy = (camera.undistort(track.points2d_px) - camera.K[:2, 2]) / np.diag(camera.K)[:2]
        pose = camera.camera_T_world if placed else None
        return View(track.time_s, xy, steady_radius(track.time_s, xy), pose)

    @property
    def is_placed(self) -> bool:
        return self.camera_T_world is not None

    def essential_with(self, other: View) -> Float[np.ndarray, "3 3"]:
        """Essential matrix of two placed cameras: lines in this view of points in the other."""
        return essential_matrix(self._pose @ np.linalg.inv(other._pose))

    @property
    def projection(self) -> Float[np.ndarray, "3 4"]:
        """Matrix of a placed camera, of unit focal length."""
        return self._pose[:3]

    @property
    def _pose(self) -> Float[np.ndarray, "4 4"]:
        assert self.camera_T_world is not None
        return self.camera_T_world

    def at(self, time_s: Float[np.ndarray, " sample"]) -> Float[np.ndarray, "sample joint 2"]:
        """Joints between two images; NaN where not known in both."""
        return between_images(self.time_s, self.xy, time_s)

    def velocity_at(self, time_s: Float[np.ndarray, " sample"]) -> Float[np.ndarray, "sample joint 2"]:
        """Per second, from as long before as after."""
        return self._mean_velocity(time_s, _HALF_S)

    def fast_velocity_at(self, time_s: Float[np.ndarray, " sample"]) -> Float[np.ndarray, "sample joint 2"]:
        """The velocity less its mean over a stride: of the swinging limbs, not of the walk. 0 where not known."""
        half_s = min(HALF_STRIDE_S, float(np.ptp(self.time_s)) / _MIN_STRIDES)
        return np.nan_to_num(self.velocity_at(time_s) - self._mean_velocity(time_s, half_s))

    def _mean_velocity(
        self, time_s: Float[np.ndarray, " sample"], half_s: float
    ) -> Float[np.ndarray, "sample joint 2"]:
        """From as many whole images before as after: so they lie alike between their images, and what the detector gets
        wrong before and after is alike correlated with what it gets wrong at the time."""
        half_s = max(round(half_s / self._step_s), 1) * self._step_s
        return (self.at(time_s + half_s) - self.at(time_s - half_s)) / (2 * half_s)

    def radius_at(self, time_s: Float[np.ndarray, " sample"]) -> Float[np.ndarray, " sample"]:
        return np.interp(time_s, self.time_s, self.radius)

    @property
    def _step_s(self) -> float:
        return usual_step_s(self.time_s)
