"""The diagnosis of what a run was made from and of what came out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from fgpose.association.chosen_person import Chosen
from fgpose.association.common_clock import on_common_clock
from fgpose.association.recording import Association, Progress, associate
from fgpose.calibration.rig_refinement import SIGNIFICANT_SIGMAS
from fgpose.config import Config
from fgpose.diagnosis.diagnose import Diagnosis, diagnose
from fgpose.finding import Code, Finding, Severity, severest_first
from fgpose.freed_memory import hand_back
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.up_axis import UpChoice, WorldUp
from fgpose.io.origin import Origin
from fgpose.observations import Observations
from fgpose.people_observations import PeopleObservations
from fgpose.pipeline.result import Result
from fgpose.pipeline.source import AnySource, Source
from fgpose.trajectory import Trajectory


def diagnosed(result: Result, world_up: UpChoice | WorldUp = "auto", progress: Progress | None = None) -> Result:
    """The result with what is probably wrong with it, which goes into its files.

    Args:
        result: of a run.
        world_up: which axis of its world is said to point up; see diagnose.
        progress: see diagnose.

    Raises:
        ValueError: nothing is determined; the message says why, as far as it is known.
    """
    if not any(np.isfinite(each.positions_m).any() for each in result.main.values()):
        raise ValueError(_nothing_determined(result))
    hand_back()
    source = result.source
    seen = result.seen, result.rig, result.main, result.config, world_up, source.with_unfollowed
    diagnosis = looked_at(*seen, progress)
    hand_back()
    diagnosis = diagnosis.after(source.origin.estimated if source.origin is not None else ())
    chosen = source.chosen
    of_several = [_of_several(chosen)] if chosen is not None and chosen.n_people > 1 else []
    of_refined = _of_refined(source.origin, result.config)
    findings = severest_first((*diagnosis.findings, *of_several, *of_refined, *_of_repairs(result.n_repairs)))
    return replace(result, diagnosis=replace(diagnosis, findings=findings))


@dataclass(frozen=True, eq=False)
class Subject:
    """Whom a diagnosis of a recording looks at, where nothing was estimated yet."""

    source: Source[Observations]
    """Of the one person, or of the one of several who is seen most."""
    everybody: Association | None
    """Who was told apart, where there are several; nobody may have been."""

    @staticmethod
    def of(
        source: AnySource, tell_apart: Callable[[PeopleObservations, CameraRig], Association] = associate
    ) -> Subject:
        """Of a recording of one person or of everybody (Source.one_or_all)."""
        seen, everybody = source.observations, None
        if isinstance(seen, PeopleObservations):
            succession = source.succession
            everybody = tell_apart(seen, source.rig) if succession is None else succession.association
        return Subject(source.one(), everybody)

    def diagnosis(self) -> Diagnosis:
        """What is probably wrong."""
        everybody = self.everybody
        seen = everybody if everybody is not None and everybody.people else self.source.observations
        return diagnose(seen, self.source.rig, with_unfollowed=self.source.with_unfollowed)


def diagnose_people(people: PeopleObservations, rig: CameraRig) -> Diagnosis:
    """What ``fgpose info`` finds in everybody's detections.

    Args:
        people: what the cameras saw, by their time stamps.
        rig: as it is in its file.

    Raises:
        ValueError: the cameras of people and rig differ.
    """
    seen, rig = on_common_clock(people, rig)
    return Subject.of(Source(rig, seen).one_or_all()).diagnosis()


def looked_at(
    recording: Observations | PeopleObservations | Association,
    rig: CameraRig,
    people: Mapping[int, Trajectory] | None = None,
    config: Config | None = None,
    world_up: UpChoice | WorldUp = "auto",
    with_unfollowed: Observations | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """As diagnose; a diagnosis that fails says so, whatever it is: no result must be lost because it cannot be
    judged."""
    try:
        return diagnose(recording, rig, people, config, world_up, with_unfollowed, progress)
    except Exception as error:
        return Diagnosis((), (), {"anything": f"the diagnosis itself has failed, please report it: {error!r:.300}"})


def _of_several(chosen: Chosen) -> Finding:
    remedy = "With --people all everybody has a result; --person-region chooses somebody else."
    return Finding(Code.SEVERAL_PEOPLE, Severity.NOTE, f"This is {chosen}", remedy, 0.2)


def _of_repairs(n_repairs: int) -> list[Finding]:
    if not n_repairs:
        return []
    times = "once" if n_repairs == 1 else f"{n_repairs} times"
    reason = f"GTSAM has failed {times}, and the graph of the last moments was begun anew from its estimates"
    remedy = "Compare with fgpose smooth, which does not need it; detections that contradict each other are a cause."
    return [Finding(Code.SOLVER_FAILURE, Severity.NOTE, reason, remedy, 0.2, numbers={"n_repairs": n_repairs})]


def _of_refined(origin: Origin | None, config: Config) -> list[Finding]:
    """That the refinement of the cameras may have shifted the world by more than the calibration is wrong."""
    shift_sigma_m = 0.0 if origin is None else origin.calibration.shift_sigma_m
    if shift_sigma_m < SIGNIFICANT_SIGMAS * config.calibration.translation_sigma_m:
        return []
    reason = (
        "the refinement moved the cameras so far that where they and the body are in the room is known to "
        f"{1000 * shift_sigma_m:.0f} mm along each axis (one standard deviation), and no covariance contains it"
    )
    remedy, numbers = "Calibrate again if places in the room matter.", {"shift_sigma_m": shift_sigma_m}
    return [Finding(Code.CALIBRATION, Severity.DOUBTFUL, reason, remedy, 0.5, numbers=numbers)]


def _nothing_determined(result: Result) -> str:
    """Why there is no result, and what to do."""
    source = result.source
    findings = diagnose(source.observations, source.rig, with_unfollowed=source.with_unfollowed).findings
    what = "no joint is determined in any frame, so nothing is written"
    if result.association is not None and not result.main:
        what = f"{result.association.why_nobody}: {what}"
    return ". ".join([what, *(finding.text for finding in findings[:1])])
