"""Time offset of each camera, estimated from the recording itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.calibration.everybody import on_everybody
from fgpose.calibration.search import Found, search
from fgpose.calibration.used_parts import Ending
from fgpose.config import Config
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.people_observations import PeopleObservations
from fgpose.shown import Shown


@dataclass(frozen=True, eq=False, repr=False)
class TimeOffsets(Shown):
    """How much later than its time stamps say each camera takes its images, by the clock of the first camera."""

    offsets_s: Float[np.ndarray, " camera"]
    sigma_s: Float[np.ndarray, " camera"]
    """Standard deviation; zero for the first camera, near calibration.offset_sigma_s if there was no motion."""
    rig: CameraRig
    """The rig with these offsets."""
    ending: Ending = Ending.SETTLED
    reassigned: tuple[float, ...] = ()
    """See RigRefinement.reassigned."""

    @property
    def converged(self) -> bool:
        return self.ending.converged


def estimate_time_offsets(
    observations: Observations | PeopleObservations, rig: CameraRig, config: Config | None = None
) -> TimeOffsets:
    """Constant time offset of every camera but the first, whose own is held.

    A camera whose clock is off sees a moving joint displaced by the offset times the velocity of its image. In turns,
    the motion is smoothed with the offsets so far, and the offsets are estimated from the reprojection errors. In that
    step the joints are unknowns too (Schur complement); if they were held, it would take many more rounds. The prior
    are the offsets of the rig (calibration.offset_sigma_s): they stay if nothing moves. Of the recording the
    calibration.max_duration_s are used in which most is seen. Several people (fgpose.load_people) are told apart with
    the rig, see refine_rig; the duration is shared out among them, and the offsets are those that suit them together.

    Raises:
        ValueError: the cameras of the observations and of the rig differ.
    """
    found, reassigned = on_everybody(observations, rig, config or Config(), _clocks)
    return TimeOffsets(found.rig.time_offsets_s, found.offset_sigma_s, found.rig, found.ending, reassigned)


def _clocks(people: Sequence[Observations], rig: CameraRig, config: Config) -> Found:
    return search(people, rig, config, poses=False, clocks=True)
