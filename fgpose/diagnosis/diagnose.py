"""The diagnosis of a recording, a rig and a result: what every command prints or carries."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from fgpose.association.recording import Association
from fgpose.config import Config
from fgpose.diagnosis.body.posture import wrong_up
from fgpose.diagnosis.body.sides import mirrored_body
from fgpose.diagnosis.body.skeletons import wrong_skeleton
from fgpose.diagnosis.body.units import wrong_unit
from fgpose.diagnosis.camera_faults_checks import moved_and_late_cameras
from fgpose.diagnosis.examined import Examined, NotJudgedError
from fgpose.diagnosis.finished import FinishedRecording
from fgpose.diagnosis.hypotheses.findings import disagreements
from fgpose.diagnosis.input_checks import blind, exchanged_sides, never_seen, repaired
from fgpose.diagnosis.result_checks import RESULT_CHECKS
from fgpose.diagnosis.seen.confidence import low_confidence
from fgpose.diagnosis.seen.frozen import frozen_cameras
from fgpose.diagnosis.seen.presence import nobody
from fgpose.finding import Finding, Severity, most_important
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations

InputCheck = Callable[[Examined], list[Finding]]
"""Looks at one thing. Raises NotJudgedError if the recording cannot tell."""

INPUT_CHECKS: Mapping[str, tuple[InputCheck, ...]] = {
    "files": (repaired,),
    "calibration": (disagreements, moved_and_late_cameras),
    "skeleton": (wrong_skeleton,),
    "unit": (wrong_unit,),
    "which way is up": (wrong_up,),
    "sides": (mirrored_body, exchanged_sides),
    "what is seen": (frozen_cameras, nobody, low_confidence, blind, never_seen),
}
"""By what they judge, as it is printed."""


@dataclass(frozen=True)
class Diagnosis:
    """What was found, and what could not be judged."""

    findings: tuple[Finding, ...]
    """The severest first, without those that others explain."""
    judged: tuple[str, ...]
    """What was looked at."""
    not_judged: Mapping[str, str]
    """What could not be judged, and why."""

    @property
    def worst(self) -> Severity | None:
        """Of all findings; None: there is none."""
        return self.findings[0].severity if self.findings else None


def diagnose(
    recording: Observations | Association,
    rig: CameraRig,
    config: Config | None = None,
    *,
    result: FinishedRecording | None = None,
    remarks: tuple[str, ...] = (),
    world_up: str = "+z",
) -> Diagnosis:
    """Look at the whole of a recording, at its rig and, if there is one, at its result.

    Args:
        recording: what the cameras saw of one person, or of everybody who was told apart, on the clock of the rig.
        rig: its cameras.
        config: the parameters that it is or was estimated with.
        result: what came out.
        remarks: what readers of files had to repair or to leave out.
        world_up: which axis of the world points up, "+x" to "-z"; "z" is as good as "+z".

    Raises:
        ValueError: the cameras of the recording and of the rig differ.
    """
    examined = Examined.of(recording, rig, config, result, remarks, world_up)
    found: list[Finding] = []
    not_judged: dict[str, str] = {}
    for what, checks in INPUT_CHECKS.items():
        for check in checks:
            try:
                found += check(examined)
            except NotJudgedError as reason:
                not_judged.setdefault(what, str(reason))
    judged = tuple(what for what in INPUT_CHECKS if what not in not_judged)
    if result is not None:
        found += result_findings(result)
        judged = (*judged, "result")
    return Diagnosis(most_important(found), judged, not_judged)


def diagnose_result(result: FinishedRecording) -> Diagnosis:
    """The same of a result whose detections may be gone."""
    return Diagnosis(most_important(result_findings(result)), ("result",), {})


def result_findings(result: FinishedRecording) -> list[Finding]:
    return [finding for check in RESULT_CHECKS for finding in check(result)]
