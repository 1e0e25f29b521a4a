"""Diagnoses for processes of their own, of which one knows what they do."""

from __future__ import annotations

import os
import time

import numpy as np

from fgpose.diagnosis.diagnose import Diagnosis
from fgpose.finding import Code, Finding, Severity
from fgpose.geometry.camera import CameraRig
from fgpose.people_observations import PeopleObservations

CHANGES_S = 20.0
"""What is longer gives something else."""


def duration_s(people: PeopleObservations) -> float:
    return float(np.ptp([image.time_s for image in people.images]))


def says_mirrored(people: PeopleObservations, rig: CameraRig) -> Diagnosis:
    """Of the second camera; beside it something doubtful, something of files alone, and a note."""
    findings = (
        Finding(Code.FRAME_ORDER, Severity.WRONG, "The images were sorted as text", "Sort them."),
        Finding(Code.MIRRORED_IMAGE, Severity.WRONG, "It is mirrored", "Mirror back.", camera=rig.names[1], from_s=2.0),
        Finding(Code.LATE_CAMERA, Severity.DOUBTFUL, "It is late", "Use --estimate-time-offsets.", camera=rig.names[0]),
        Finding(Code.CLIPPED_KEYPOINTS, Severity.NOTE, "They are clipped", "Do not."),
    )
    return Diagnosis(findings, ("calibration",), {"lenses": "it is short"})


def says_mirrored_at_first(people: PeopleObservations, rig: CameraRig) -> Diagnosis:
    return says_mirrored(people, rig) if duration_s(people) < CHANGES_S else Diagnosis((), ("calibration",), {})


def raises_at_first(people: PeopleObservations, rig: CameraRig) -> Diagnosis:
    if duration_s(people) < CHANGES_S:
        raise ValueError("nothing can be told")
    return Diagnosis((), ("calibration",), {})


def dies_at_first(people: PeopleObservations, rig: CameraRig) -> Diagnosis:
    if duration_s(people) < CHANGES_S:
        os._exit(3)
    return Diagnosis((), ("calibration",), {})


def hangs_at_first(people: PeopleObservations, rig: CameraRig) -> Diagnosis:
    while duration_s(people) < CHANGES_S:
        time.sleep(1.0)
    return Diagnosis((), ("calibration",), {})
