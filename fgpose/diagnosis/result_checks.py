"""All checks of a result, in one list."""

from __future__ import annotations

from collections.abc import Callable

from fgpose.diagnosis.camera_checks import (
    blind_cameras,
    calibration_findings,
    disagreeing_cameras,
    few_cameras,
    hallucinating_cameras,
    swapping_cameras,
)
from fgpose.diagnosis.clock_checks import drifting_cameras, late_cameras, missing_frames, undetermined_clocks
from fgpose.diagnosis.finished import FinishedRecording
from fgpose.diagnosis.gravity_checks import wrong_falls
from fgpose.diagnosis.misplaced_joints import misplaced_joints
from fgpose.diagnosis.motion_checks import contradicted, gaps, impossible_speeds, short_lives, turns, unobservable
from fgpose.diagnosis.solution_checks import equal_confidences, large_errors, not_converged, outside
from fgpose.finding import Finding

RESULT_CHECKS: tuple[Callable[[FinishedRecording], list[Finding]], ...] = (
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
