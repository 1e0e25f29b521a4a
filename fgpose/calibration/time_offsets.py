"""Estimating by how much each camera's clock is off, from the recording itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.calibration.search import search
from fgpose.config import Config
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations


@dataclass(frozen=True, eq=False)
class TimeOffsets:
    """How much later than its time stamps say each camera takes its images, the first camera's clock being right."""

    offsets_s: Float[np.ndarray, " camera"]
    sigma_s: Float[np.ndarray, " camera"]
    """Standard deviation; zero for the first camera, near calibration.offset_sigma_s where there was no motion to
    tell."""
    rig: CameraRig
    """The rig with these offsets."""
    converged: bool = True
    """Whether the offsets changed no more in the end, and the smoother that they rest on has converged."""


def estimate_time_offsets(observations: Observations, rig: CameraRig, config: Config | None = None) -> TimeOffsets:
    """Constant time offset of every camera but the first, whose own is held.

    Joints that move are seen too far ahead or behind by a camera whose clock is off, by the velocity of their image
    times the offset. In turns the motion is estimated with the offsets so far (fgpose.smooth), and the offsets from the
    reprojection errors that it leaves; in that step the joints are free to move along (Schur complement), without
    which it would take many more rounds. The offsets that the rig has are the prior (calibration.offset_sigma_s): where
    nothing moves they stay. Of the recording the calibration.max_duration_s are used in which most is seen.

    Raises:
        ValueError: the cameras of the observations and of the rig differ.
    """
    observations.check_cameras(rig.names)
    found = search(observations, rig, config or Config(), poses=False, clocks=True)
    return TimeOffsets(found.rig.time_offsets_s, found.sigmas[:, 6], found.rig, found.converged)
