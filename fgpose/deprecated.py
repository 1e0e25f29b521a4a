"""Names that have moved: each is found at its old place for a version, with a warning that names the new one."""

from __future__ import annotations

import importlib
import warnings

GONE_IN = "0.3"
"""The version that has the old names no more."""

MOVED = {
    "BumpedRig": "fgpose.calibration.BumpedRig",
    "CalibratedFromPeople": "fgpose.calibration.CalibratedFromPeople",
    "Code": "fgpose.diagnosis.Code",
    "Detections": "fgpose.people.Detections",
    "Diagnosis": "fgpose.diagnosis.Diagnosis",
    "Evaluation": "fgpose.assessment.Evaluation",
    "JointAngles": "fgpose.kinematics.JointAngles",
    "PeopleEvaluation": "fgpose.people.PeopleEvaluation",
    "PeopleObservations": "fgpose.people.PeopleObservations",
    "RigRefinement": "fgpose.calibration.RigRefinement",
    "SelfCalibration": "fgpose.calibration.SelfCalibration",
    "Severity": "fgpose.diagnosis.Severity",
    "SmoothedPeople": "fgpose.people.SmoothedPeople",
    "Synchronised": "fgpose.calibration.Synchronised",
    "TimeOffsets": "fgpose.calibration.TimeOffsets",
    "Tracked": "fgpose.people.Tracked",
    "builtin_skeletons": "fgpose.files.builtin_skeletons",
    "calibrate": "fgpose.calibration.calibrate_from_people",
    "estimate_time_offsets": "fgpose.calibration.estimate_time_offsets",
    "evaluate_people": "fgpose.people.evaluate_people",
    "guessed_intrinsics": "fgpose.calibration.guessed_intrinsics",
    "load_angles": "fgpose.files.load_angles",
    "load_intrinsics": "fgpose.files.load_intrinsics",
    "load_people_trajectories": "fgpose.files.load_people_trajectories",
    "load_recording": "fgpose.files.load_recording",
    "load_uncalibrated": "fgpose.files.load_uncalibrated",
    "on_common_clock": "fgpose.calibration.on_common_clock",
    "recordings": "fgpose.files.recordings",
    "refine_bumped": "fgpose.calibration.refine_bumped",
    "refine_rig": "fgpose.calibration.refine_rig",
    "save_kinematics": "fgpose.files.save_kinematics",
    "save_observations": "fgpose.files.save_observations",
    "save_people": "fgpose.files.save_people",
    "save_people_observations": "fgpose.files.save_people_observations",
    "self_calibrate": "fgpose.calibration.self_calibrate",
    "synchronise": "fgpose.calibration.synchronise",
    "turn_images": "fgpose.calibration.turn_images",
}
"""Old names of fgpose, and where what they stood for is now."""


def moved(name: str) -> object:
    """What an old name of fgpose stands for, as its ``__getattr__``. Raises AttributeError if there never was one."""
    if name not in MOVED:
        raise AttributeError(f"module 'fgpose' has no attribute {name!r}")
    warnings.warn(
        f"fgpose.{name} is now {MOVED[name]}; the old name is gone in {GONE_IN}", DeprecationWarning, stacklevel=3
    )
    module, _, new = MOVED[name].rpartition(".")
    return getattr(importlib.import_module(module), new)
