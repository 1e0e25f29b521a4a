"""The interface through which the rest of fgpose shows a calibration from people. Does not import Rerun."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import CameraRig
from fgpose.viewer.recording import Recording

WALK = "walk"
"""The name of the walker's trajectory in the recording."""


@dataclass(frozen=True, eq=False)
class CalibrationScene:
    """What is shown of a calibration besides the cameras, the detections and the walker."""

    time_s: Float[np.ndarray, " frame"]
    position_sigma_m: Float[np.ndarray, " camera"]
    """Of the place of each camera, root of the sum over the axes; NaN: not known."""
    path_m: Float[np.ndarray, "frame 3"]
    """Where the walker's hips were, world frame; NaN: not known."""
    epipolar_px: Float[np.ndarray, "frame camera other"]
    """How far the joints in each camera are from the epipolar lines of each other one; NaN: not seen by both."""
    report: str
    """Markdown: the verdict, and a table of the cameras."""
    before: CameraRig | None = None
    """The same cameras as they were before; those that have moved since are shown there too."""


class CalibrationRecording(Recording):
    """A recording of one person who walked through the scene, and of how well the cameras are calibrated by it."""

    def log_calibration(self, scene: CalibrationScene) -> None:
        """Show the covariances of the cameras, the way of the hips, what of the floor was covered, how well every pair
        of cameras agrees in each frame, and the verdict.

        Raises:
            ValueError: a shape differs from the number of frames or of cameras, or the cameras before are others.
        """
