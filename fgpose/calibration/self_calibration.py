"""Poses and time offsets of the cameras at once, from the recording itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic

from fgpose.association.common_clock import on_common_clock
from fgpose.calibration.changes.change import with_changes
from fgpose.calibration.changes.find_changes import find_changes
from fgpose.calibration.everybody import everybody_of, on_everybody
from fgpose.calibration.moved_views import Recording
from fgpose.calibration.rig_refinement import RigRefinement, refine_rig, refinement
from fgpose.calibration.search import Found, search
from fgpose.calibration.time_offsets import TimeOffsets, estimate_time_offsets
from fgpose.calibration.used_parts import Ending
from fgpose.config import Config
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.changing_rig import is_changing
from fgpose.observations import Observations
from fgpose.people_observations import PeopleObservations
from fgpose.shown import Shown


@dataclass(frozen=True, eq=False, repr=False)
class SelfCalibration(Shown, Generic[Recording]):
    """A rig whose cameras agree better in place and time."""

    rig: CameraRig
    observations: Recording
    """The observations, their per-view 3D moved with the cameras that saw it."""
    refinement: RigRefinement[Recording]
    time_offsets: TimeOffsets
    objective: float
    """The objective of the calibration (fgpose.calibration.adjustment.problem); at most that of the given rig."""

    @property
    def ending(self) -> Ending:
        return self.refinement.ending

    @property
    def converged(self) -> bool:
        return self.ending.converged


@dataclass(frozen=True, eq=False, repr=False)
class CameraCalibration(Shown, Generic[Recording]):
    """A recording whose cameras have been calibrated on it."""

    rig: CameraRig
    observations: Recording
    refinement: RigRefinement[Recording] | None
    """None where the poses were held."""
    time_offsets: TimeOffsets | None
    """None where the clocks were held."""
    changed: CameraRig | None = None
    """By the time stamps that were given: what was found to change in time, before what is constant was calibrated.
    None: nothing; rig and observations are then of the same cameras, and by the same clocks, as they were given."""

    @property
    def ending(self) -> Ending:
        calibrated = self.refinement or self.time_offsets
        return Ending.SETTLED if calibrated is None else calibrated.ending

    @property
    def reassigned(self) -> tuple[float, ...]:
        """See RigRefinement.reassigned."""
        calibrated = self.refinement or self.time_offsets
        return () if calibrated is None else calibrated.reassigned


def self_calibrate(observations: Recording, rig: CameraRig, config: Config | None = None) -> SelfCalibration[Recording]:
    """Refine the poses of the cameras and estimate their time offsets, both at once.

    While the person walks in one direction, a late camera and a moved camera cause the same errors. If one were
    estimated first, it would absorb the error of the other. So both are unknowns of one bundle adjustment, with the
    motion smoothed anew between two of them (fgpose.calibration.search). The result is never worse than the given rig
    by the objective of that adjustment; where nothing is better it is the given rig. Of the recording the
    calibration.max_duration_s are used in which most is seen. Several people (fgpose.load_people) are told apart with
    the rig, see refine_rig, and share out that duration.

    Raises:
        ValueError: see refine_rig.
    """
    config = config or Config()
    found, reassigned = on_everybody(observations, rig, config, _both)
    refined = refinement(observations, rig, found, config, reassigned)
    offsets = TimeOffsets(found.rig.time_offsets_s, found.offset_sigma_s, found.rig, found.ending, reassigned)
    return SelfCalibration(found.rig, refined.observations, refined, offsets, found.objective)


def _both(people: Sequence[Observations], rig: CameraRig, config: Config) -> Found:
    return search(people, rig, config, poses=True, clocks=True)


def calibrate_cameras(
    observations: Recording, rig: CameraRig, config: Config | None = None, *, poses: bool, clocks: bool
) -> CameraCalibration[Recording]:
    """Refine the cameras' poses, estimate their time offsets, or both at once, as asked for.

    What changes in time is found first (fgpose.calibration.changes): with clocks jumps and rates, and cameras that were
    started at another moment, with poses cameras that were bumped while they filmed. The recording is put together with
    it (fgpose.calibration.on_common_clock), and what is constant is calibrated then.

    Raises:
        ValueError: see refine_rig, estimate_time_offsets and self_calibrate.
    """
    observations.check_cameras(rig.names)
    changed = _in_time(observations, rig, config or Config(), poses=poses, clocks=clocks)
    if changed is None:
        return _constant(observations, rig, config, poses=poses, clocks=clocks)
    found = _constant(*on_common_clock(observations, changed), config, poses=poses, clocks=clocks)
    return replace(found, changed=changed)


def _in_time(
    observations: Observations | PeopleObservations, rig: CameraRig, config: Config, *, poses: bool, clocks: bool
) -> CameraRig | None:
    """What changes in time."""
    if not poses and not clocks:
        return None
    found = find_changes(everybody_of(observations, rig, config), rig)
    changed = with_changes(rig, found.changes, poses=poses, clocks=clocks)
    return changed if is_changing(changed) or any(changed.time_offsets_s != rig.time_offsets_s) else None


def _constant(
    observations: Recording, rig: CameraRig, config: Config | None, *, poses: bool, clocks: bool
) -> CameraCalibration[Recording]:
    if poses and clocks:
        both = self_calibrate(observations, rig, config)
        return CameraCalibration(both.rig, both.observations, both.refinement, both.time_offsets)
    if poses:
        refined = refine_rig(observations, rig, config)
        return CameraCalibration(refined.rig, refined.observations, refined, None)
    if clocks:
        offsets = estimate_time_offsets(observations, rig, config)
        return CameraCalibration(offsets.rig, observations, None, offsets)
    return CameraCalibration(rig, observations, None, None)
