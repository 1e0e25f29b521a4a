"""The methods of the benchmark of calibration from people, each on the same recordings."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from fgpose.calibration.from_people.calibrate import Parts, calibrate_from_people
from fgpose.calibration.from_people.calibrated import CalibratedFromPeople
from fgpose.calibration.from_people.walk import Walk
from fgpose.geometry.camera import CameraRig
from fgpose_benchmarks.calibration.baselines import five_point, procrustes
from fgpose_benchmarks.calibration.recording import CalibrationMethod, CalibrationResult, KnownRigRecording
from fgpose_benchmarks.comparison.recording import Method

OURS = "fgpose"


@dataclass(frozen=True)
class CalibrationChain:
    """fgpose.calibration.calibrate_from_people; a calibration that it refuses is one that failed."""

    parts: Parts = field(default_factory=Parts)
    """Which are turned on."""
    calibrate: Callable[..., CalibratedFromPeople] = calibrate_from_people

    def __call__(self, recording: KnownRigRecording) -> CalibrationResult:
        given, start_s = recording.given, time.perf_counter()
        try:
            found = self.calibrate(
                recording.people,
                recording.intrinsics,
                focal=given.focal,
                stature_m=given.stature_m,
                distances=given.distances,
                synchronised=given.synchronised,
                parts=self.parts,
            )
        except ValueError as error:
            return CalibrationResult(None, "failed", (str(error),), None, True, time.perf_counter() - start_s)
        reasons = tuple(f"{finding.camera or 'rig'}: {finding.reason}" for finding in found.findings)
        took_s = time.perf_counter() - start_s
        return CalibrationResult(found.rig, found.grade.value, reasons, found.sigmas, True, took_s)


@dataclass(frozen=True)
class Told:
    """A baseline, which is told who is who and when each image was taken."""

    solve: Callable[[Walk, CameraRig], CameraRig]
    is_metric: bool

    def __call__(self, recording: KnownRigRecording) -> CalibrationResult:
        start_s = time.perf_counter()
        try:
            rig = self.solve(recording.told, recording.intrinsics)
        except ValueError as error:
            return CalibrationResult(None, "unjudged", (str(error),), None, self.is_metric, 0.0)
        took_s = time.perf_counter() - start_s
        return CalibrationResult(
            rig.with_time_offsets(recording.rig.time_offsets_s), "unjudged", (), None, self.is_metric, took_s
        )


METHODS: tuple[CalibrationMethod, ...] = (
    Method("Procrustes of 3D", "baseline", Told(procrustes, is_metric=False)),
    Method("five-point, PnP", "baseline", Told(five_point, is_metric=False)),
    Method(OURS, "ours", CalibrationChain()),
)

ABLATIONS: tuple[CalibrationMethod, ...] = (
    Method("as it is", "ours", CalibrationChain()),
    Method("no referee", "ours", CalibrationChain(Parts(referee=False))),
    Method("first pair as scaffold", "ours", CalibrationChain(Parts(choose_scaffold=False))),
    Method("focal length held", "ours", CalibrationChain(Parts(joint_focal=False))),
    Method("no bias model", "ours", CalibrationChain(Parts(bias=False))),
)
"""The chain without a change, then with one part turned on or off at a time."""
