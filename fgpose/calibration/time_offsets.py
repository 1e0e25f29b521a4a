"""Time offset of each camera, estimated from the recording itself."""

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
    """How much later than its time stamps say each camera takes its images, by the clock of the first camera."""

    offsets_s: Float[np.ndarray, " camera"]
    sigma_s: Float[np.ndarray, " camera"]
    """Standard deviation; zero for the first camera, near calibration.offset_sigma_s if there was no motion."""
    rig: CameraRig
    """The rig with these offsets."""
    converged: bool = True
    """Whether the last round changed nothing, and its optimisers have converged."""


def estimate_time_offsets(observations: Observations, rig: CameraRig, config: Config | None = None) -> TimeOffsets:
    """Constant time offset of every camera but the first, whose own is held.

    A camera whose clock is off sees a moving joint displaced by the offset times the velocity of its image. In turns,
    the motion is smoothed with the offsets so far, and the offsets are estimated from the reprojection errors. In that
    step the joints are unknowns too (Schur complement); if they were held, it would take many more rounds. The prior
    are the offsets of the rig (calibration.offset_sigma_s): they stay if nothing moves. Of the recording the
    calibration.max_duration_s are used in which most is seen.

    Raises:
        ValueError: the cameras of the observations and of the rig differ.
    """
    observations.check_cameras(rig.names)
    found = search(observations, rig, config or Config(), poses=False, clocks=True)
    return TimeOffsets(found.rig.time_offsets_s, found.sigmas[:, 6], found.rig, found.converged)
