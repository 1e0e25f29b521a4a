"""What uncalibrated cameras saw of one walker: each by its own clock, and together on a common one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.sampling import usual_step_s
from fgpose.shown import Shown
from fgpose.skeleton import Skeleton

SHORT_S = 5.0
"""A walk of less tells neither when a video began nor, in two halves, how certain a rig is."""


@dataclass(frozen=True, eq=False)
class Track:
    """One person as one camera saw them, by the clock of that camera."""

    camera: str
    time_s: Float[np.ndarray, " image"]
    """Of the images, increasing; the origin is that of the camera's clock, as the beginning of its video."""
    points2d_px: Float[np.ndarray, "image joint 2"]
    """Pixels of the original, distorted image; NaN = missing."""
    confidence: Float[np.ndarray, "image joint"]
    """In [0, 1]; 0 = missing."""
    points3d_m: Float[np.ndarray, "image joint 3"] | None = None
    """Joints as this view alone gives them, in the frame of the camera, metres; None: 2D only."""


@dataclass(frozen=True, eq=False, repr=False)
class Walk(Shown):
    """The walker in frames of a common clock.

    Detections are interpolated between two images of their camera to the time of the frame.
    """

    skeleton: Skeleton
    camera_names: tuple[str, ...]
    time_s: Float[np.ndarray, " frame"]
    """Increasing, by the clock of the first camera."""
    points2d_px: Float[np.ndarray, "frame camera joint 2"]
    """Pixels of the original, distorted image; NaN = missing."""
    confidence: Float[np.ndarray, "frame camera joint"]
    """In [0, 1]; 0 = missing."""
    points3d_m: Float[np.ndarray, "frame camera joint 3"] | None = None
    """In the frame of each camera, metres; NaN = missing; None: 2D only."""

    @property
    def seen(self) -> Bool[np.ndarray, "frame camera joint"]:
        return np.isfinite(self.points2d_px).all(axis=-1) & (self.confidence > 0)

    @property
    def shows_walker(self) -> Bool[np.ndarray, "frame camera"]:
        """Whether a camera sees a quarter of the joints: fewer are no person."""
        return np.asarray(self.seen.sum(axis=-1) >= self.skeleton.n_joints / 4)

    @property
    def step_s(self) -> float:
        """Usual time from frame to frame; 0 with one frame."""
        return usual_step_s(self.time_s) if len(self.time_s) > 1 else 0.0
