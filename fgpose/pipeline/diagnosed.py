"""The diagnosis of what a run was made from and of what came out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TypeVar

import numpy as np

from fgpose.association.chosen_person import Chosen
from fgpose.association.recording import Association
from fgpose.calibration.rig_refinement import has_moved
from fgpose.config import Config
from fgpose.diagnosis.diagnose import Diagnosis, diagnose
from fgpose.finding import Code, Finding, Severity
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.up_axis import UpChoice, WorldUp
from fgpose.observations import Observations
from fgpose.people import PeopleObservations
from fgpose.pipeline.people import PeopleResult, PeopleSource
from fgpose.pipeline.results import Result
from fgpose.pipeline.source import Source
from fgpose.trajectory import Trajectory

AnyResult = TypeVar("AnyResult", Result, PeopleResult)


def diagnosed(result: AnyResult, world_up: UpChoice | WorldUp = "auto") -> AnyResult:
    """The result with what is probably wrong with it, which goes into its files.

    Args:
        result: of a run.
        world_up: which axis of its world is said to point up; see diagnose.

    Raises:
        ValueError: nothing is determined; the message says why, as far as it is known.
    """
    people = result.main if isinstance(result, PeopleResult) else {0: result.main}
    if not any(np.isfinite(each.positions_m).any() for each in people.values()):
        raise ValueError(nothing_determined(result.source))
    if isinstance(result, PeopleResult):
        recording, rig = result.association, result.association.rig
    else:
        recording, rig = result.source.observations, result.source.rig
    diagnosis = looked_at(recording, rig, people, result.config, world_up)
    chosen = result.source.chosen if isinstance(result.source, Source) else None
    if chosen is not None and chosen.n_people > 1:
        diagnosis = replace(diagnosis, findings=(*diagnosis.findings, _of_several(chosen)))
    diagnosis = replace(diagnosis, findings=(*diagnosis.findings, *_of_refined(result.source, result.config)))
    return replace(result, diagnosis=diagnosis)


def looked_at(
    recording: Observations | PeopleObservations | Association,
    rig: CameraRig,
    people: Mapping[int, Trajectory] | None = None,
    config: Config | None = None,
    world_up: UpChoice | WorldUp = "auto",
) -> Diagnosis:
    """As diagnose; a diagnosis that fails says so, whatever it is: no result must be lost because it cannot be
    judged."""
    try:
        return diagnose(recording, rig, people, config, world_up)
    except Exception as error:
        return Diagnosis((), (), {"anything": f"the diagnosis itself has failed, please report it: {error!r:.300}"})


def _of_several(chosen: Chosen) -> Finding:
    remedy = "With --people all everybody has a result; --person-region chooses somebody else."
    return Finding(Code.SEVERAL_PEOPLE, Severity.NOTE, f"This is {chosen}", remedy, 0.2)


def _of_refined(source: Source | PeopleSource, config: Config) -> list[Finding]:
    """That so many cameras were moved that nothing holds the world."""
    known = () if source.origin is None else source.origin.calibration.moved
    deg, metres = (np.array([getattr(each, name) for each in known]) for name in ("rotation_deg", "translation_m"))
    moved = has_moved(deg, metres, config) if known else np.zeros(0, dtype=bool)
    if moved.sum() < 2 or (~moved).sum() > 1:
        return []
    usual_cm = 100 * float(np.median(metres[moved]))
    reason = (
        f"{moved.sum()} of {len(known)} cameras were moved by the refinement, by about {usual_cm:.0f} cm: where the "
        "body is in the room is not known better than that, and no covariance contains it"
    )
    return [Finding(Code.CALIBRATION, Severity.DOUBTFUL, reason, "Calibrate again if places in the room matter.", 0.5)]


def nothing_determined(source: Source | PeopleSource) -> str:
    """Why there is no result, and what to do."""
    one = source if isinstance(source, Source) else source.one()
    findings = diagnose(one.observations, one.rig).findings
    what = "no joint is determined in any frame, so nothing is written"
    return ". ".join([what, *(finding.text for finding in findings[:1])])
