"""All checks of a finished recording, in one list."""

from __future__ import annotations

from collections.abc import Callable

from fgpose.report.camera_checks import (
    blind_cameras,
    calibration_findings,
    disagreeing_cameras,
    few_cameras,
    hallucinating_cameras,
    misplaced_joints,
    swapping_cameras,
)
from fgpose.report.clock_checks import drifting_cameras, late_cameras, missing_frames, undetermined_clocks
from fgpose.report.finished import FinishedRecording
from fgpose.report.gravity_checks import wrong_falls
from fgpose.report.motion_checks import contradicted, gaps, impossible_speeds, short_lives, turns, unobservable
from fgpose.report.solution_checks import equal_confidences, large_errors, not_converged, outside
from fgpose.report.suspicion import Suspicion

CHECKS: tuple[Callable[[FinishedRecording], list[Suspicion]], ...] = (
    not_converged,
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
    missing_frames,
)


def suspicions(recording: FinishedRecording) -> tuple[Suspicion, ...]:
    """What is suspicious, the most important first; of equal ones what may cause the others."""
    found = [each for check in CHECKS for each in check(recording)]
    return tuple(sorted(found, key=lambda each: -each.weight))
