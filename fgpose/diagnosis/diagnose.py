"""The diagnosis of a recording, a rig and a result: what every command prints or carries."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace

from fgpose.association.chosen_person import main_person
from fgpose.association.common_clock import single_images_together
from fgpose.association.recording import Association, Progress, associate
from fgpose.config import Config
from fgpose.diagnosis.body.hands import exchanged_hands
from fgpose.diagnosis.body.sides import mirrored_body
from fgpose.diagnosis.body.skeletons import wrong_skeleton
from fgpose.diagnosis.body.tempo import slow_motion
from fgpose.diagnosis.body.world import wrong_given_up, wrong_unit, wrong_up
from fgpose.diagnosis.camera_checks import (
    blind_cameras,
    calibration_findings,
    disagreeing_cameras,
    few_cameras,
    hallucinating_cameras,
    misplaced_joints,
)
from fgpose.diagnosis.changes.camera_faults_checks import lenses_that_show, moved_and_late_cameras
from fgpose.diagnosis.clock_checks import drifting_cameras, late_cameras, missing_frames, pauses, undetermined_clocks
from fgpose.diagnosis.consequences import EXPLAINS, most_important
from fgpose.diagnosis.examined import Examined, NotJudgedError
from fgpose.diagnosis.finished import FinishedRecording
from fgpose.diagnosis.gravity_checks import wrong_falls
from fgpose.diagnosis.hypotheses.findings import disagreements
from fgpose.diagnosis.input_checks import causes_of_unfollowed, off_centre, repaired, unusual_steps
from fgpose.diagnosis.motion_checks import (
    contradicted,
    gaps,
    impossible_speeds,
    motionless,
    perhaps_exchanged,
    perhaps_same,
    short_lives,
    turns,
    unobservable,
)
from fgpose.diagnosis.reflections import reflections
from fgpose.diagnosis.seen.clipped import Clipped
from fgpose.diagnosis.seen.interpolated import interpolated_keypoints
from fgpose.diagnosis.seen.keypoints import low_confidence, smoothed_keypoints
from fgpose.diagnosis.seen.noisy import noisy_keypoints
from fgpose.diagnosis.seen.order import sorted_as_text
from fgpose.diagnosis.seen.own_3d import foreign_3d
from fgpose.diagnosis.seen.placeholders import Placeholders
from fgpose.diagnosis.seen.presence import blind, identity_switches, never_seen, nobody, somebody_else
from fgpose.diagnosis.seen.repeated import frozen_cameras, repeated_images
from fgpose.diagnosis.seen.things import Things
from fgpose.diagnosis.solution_checks import equal_confidences, large_errors, not_converged, other_bones, outside
from fgpose.diagnosis.steps import Steps
from fgpose.diagnosis.swapped_sides import exchanged_sides, swapping_cameras
from fgpose.finding import Code, Finding, Severity
from fgpose.freed_memory import hand_back
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.up_axis import UpChoice, WorldUp, z_up_R_world
from fgpose.kinematics.vertical import find_up
from fgpose.observations import Observations
from fgpose.people_observations import PeopleObservations
from fgpose.shown import Shown
from fgpose.shown.wrong_types import check_type
from fgpose.trajectory import Trajectory

InputCheck = Callable[[Examined], list[Finding]]
"""Looks at one thing. Raises NotJudgedError if the recording cannot tell."""

INPUT_CHECKS: Mapping[str, tuple[InputCheck, ...]] = {
    "files": (repaired,),
    "calibration": (disagreements, off_centre, causes_of_unfollowed),
    "frame rate": (unusual_steps, pauses, slow_motion, sorted_as_text),
    "clocks and poses over time": (moved_and_late_cameras,),
    "lenses": (lenses_that_show,),
    "skeleton": (wrong_skeleton,),
    "unit": (wrong_unit,),
    "which way is up": (wrong_up,),
    "sides": (mirrored_body, exchanged_sides, exchanged_hands),
    "what is seen": (
        foreign_3d,
        frozen_cameras,
        repeated_images,
        smoothed_keypoints,
        interpolated_keypoints,
        noisy_keypoints,
        nobody,
        somebody_else,
        identity_switches,
        low_confidence,
        blind,
        never_seen,
    ),
}
"""By what they judge, as it is printed."""

RESULT_CHECKS: tuple[Callable[[FinishedRecording], list[Finding]], ...] = (
    wrong_given_up,
    not_converged,
    other_bones,
    few_cameras,
    calibration_findings,
    large_errors,
    disagreeing_cameras,
    late_cameras,
    drifting_cameras,
    wrong_falls,
    impossible_speeds,
    undetermined_clocks,
    swapping_cameras,
    blind_cameras,
    hallucinating_cameras,
    misplaced_joints,
    outside,
    equal_confidences,
    unobservable,
    gaps,
    contradicted,
    turns,
    short_lives,
    perhaps_exchanged,
    perhaps_same,
    motionless,
    reflections,
    missing_frames,
)
"""Of what came out."""

_ESTIMATES = {"poses": "--refine-calibration", "clocks": "--estimate-time-offsets"}


@dataclass(frozen=True, repr=False)
class Diagnosis(Shown):
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

    def after(self, estimated: Collection[str]) -> Diagnosis:
        """Without advice that was followed.

        Args:
            estimated: what of the cameras was estimated on the recording: poses, clocks.
        """
        return replace(self, findings=tuple(_after(finding, estimated) for finding in self.findings))

    def tells_of(self, code: Code) -> bool:
        """Whether a finding says this, or something that explains it."""
        return any(code is each.code or code in EXPLAINS.get(each.code, ()) for each in self.findings)


def diagnose(
    recording: Observations | PeopleObservations | Association,
    rig: CameraRig,
    result: Trajectory | Mapping[int, Trajectory] | None = None,
    config: Config | None = None,
    world_up: UpChoice | WorldUp = "auto",
    with_unfollowed: Observations | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Look at the whole of a recording, at its rig and, if there is one, at its result.

    Args:
        recording: what the cameras saw of one person, or of everybody, on the clock of the rig (on_common_clock).
        rig: its cameras.
        result: what came out, of one person or by the number of the person.
        config: the parameters that it is or was estimated with.
        world_up: which axis of the world is said to point up; auto: as body and cameras stand.
        with_unfollowed: of one person who was chosen among several, the recording with whom cameras show in which
            nobody is followed (Source.with_unfollowed); None: there is no such camera.
        progress: told how many of how many steps are done; more are to be done where something is found.

    Raises:
        TypeError: the rig is none.
        ValueError: the cameras of the recording and of the rig, or the people of the result, differ.
    """
    check_type("diagnose", "rig", rig, CameraRig)
    config = config or Config()
    if not isinstance(recording, Association):
        # As the estimators take them.
        together = single_images_together(recording, rig)  # pyrefly: ignore[bad-specialization]
        recording, rig = together or (recording, rig)
    if isinstance(recording, PeopleObservations):
        told_apart = associate(recording, rig, config.tracking)
        recording = told_apart if told_apart.people else recording.of_person(main_person(recording, rig).seen)
    people = {0: result} if isinstance(result, Trajectory) else result
    events = recording.events if isinstance(recording, Association) else ()
    finished = replace(_standing(people, rig, world_up), events=events) if people else None
    examined = Examined.of(recording, rig, config, finished, world_up)
    return _diagnosed(replace(examined, with_unfollowed=with_unfollowed, steps=Steps(progress)))


def _after(finding: Finding, estimated: Collection[str]) -> Finding:
    """With another remedy if the recording was estimated with all that it names."""
    named = [what for what, option in _ESTIMATES.items() if option in finding.remedy]
    if not named or not set(named) <= set(estimated):
        return finding
    whose = finding.camera or "the cameras"
    remedy = (
        f"The {' and '.join(named)} of {whose} were estimated on this recording already: calibrate {whose} again, or "
        "leave out with --cameras what disagrees."
    )
    return replace(finding, remedy=remedy)


def _standing(people: Mapping[int, Trajectory], rig: CameraRig, world_up: UpChoice | WorldUp) -> FinishedRecording:
    """The result in a world with z up."""
    up_R_world = z_up_R_world(find_up(people.values(), rig).world_up if world_up == "auto" else world_up)
    turned = {person: each.turned(up_R_world) for person, each in people.items()}
    return FinishedRecording("", turned, rig.turned(up_R_world))


def diagnose_finished(recording: FinishedRecording, progress: Progress | None = None) -> Diagnosis:
    """The same of a finished recording: of what the cameras saw too, where that is known, else of the result alone."""
    steps = Steps(progress)
    if recording.rig is None or not recording.observations:
        steps.expect(len(RESULT_CHECKS))
        diagnosis = Diagnosis(
            most_important([*recording.known_findings, *_of_result(recording, steps)]), ("result",), {}
        )
    else:
        diagnosis = _diagnosed(Examined(recording.rig, recording.observations, result=recording, steps=steps))
    return diagnosis.after(recording.estimated)


def _diagnosed(examined: Examined) -> Diagnosis:
    placeholders = Placeholders.among(examined)
    found, examined = placeholders.findings(examined), placeholders.as_missing(examined)
    clipped = Clipped.among(examined)
    found, examined = [*found, *clipped.findings(examined)], clipped.as_missing(examined)
    things = Things.among(examined)
    found, examined = [*found, *things.findings(examined)], things.as_missing(examined)
    not_judged: dict[str, str] = {}
    examined.steps.expect(sum(map(len, INPUT_CHECKS.values())) + len(RESULT_CHECKS) * (examined.result is not None))
    for what, checks in INPUT_CHECKS.items():
        for check in checks:
            try:
                found += check(examined)
            except NotJudgedError as reason:
                not_judged.setdefault(what, str(reason))
            hand_back()
            examined.steps.one()
    judged = tuple(what for what in INPUT_CHECKS if what not in not_judged)
    if examined.result is not None:
        # Which images there are, and so how much of them a camera shows, the result does not tell.
        of_result = [each for each in _of_result(examined.result, examined.steps) if each.code is not Code.BLIND_CAMERA]
        found += [*of_result, *examined.result.known_findings]
        judged = (*judged, "result")
    return Diagnosis(most_important(found), judged, not_judged)


def _of_result(result: FinishedRecording, steps: Steps) -> list[Finding]:
    found = []
    for check in RESULT_CHECKS:
        found += check(result)
        hand_back()
        steps.one()
    return found
