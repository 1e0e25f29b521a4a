"""Cameras that are late or were moved, in recordings that are too short to tell what changes in time."""

from __future__ import annotations

from fgpose.calibration.camera_faults import CameraFault, camera_faults
from fgpose.calibration.changes.find_changes import LEAST_S
from fgpose.calibration.large_moves import BUMP_DEG, BUMP_M
from fgpose.diagnosis.examined import Examined, NotJudgedError
from fgpose.finding import Code, Finding, Severity

_TWICE = 2.0  # a second or two tell turns and moves apart no better
# More than clocks differ that were ever set alike, and half of what --estimate-time-offsets finds.
_FAR_APART_S = 0.12


def faults_of_short(examined: Examined) -> list[Finding]:
    """By a quick self-calibration, which takes clocks and poses for constant."""
    if examined.rig.n_cameras < 3:
        raise NotJudgedError("fewer than three cameras, and too short for two")
    recording = examined.association if examined.association is not None else examined.main
    faults = camera_faults(recording, examined.rig)
    if not faults:
        raise NotJudgedError("no two cameras agree on any joint")
    late, moved = [fault for fault in faults if fault.late], [fault for fault in faults if fault.moved]
    if not late and not moved:
        raise NotJudgedError(f"it lasts less than {LEAST_S:.0f} s")
    several = len(moved) > 1
    return [*(_late(fault, bool(moved)) for fault in late), *(_moved(fault, bool(late), several) for fault in moved)]


def if_by_hand(offset_s: float) -> str:
    """What else to do where a camera began so much later or earlier."""
    if abs(offset_s) <= _FAR_APART_S:
        return ""
    return " Were the cameras started by hand? Then fgpose synchronise finds when each began."


def _late(fault: CameraFault, also_moved: bool) -> Finding:
    # While the person walks in one direction, both faults cause the same errors. Either option alone would absorb the
    # error of the other.
    both = " and --refine-calibration together" if also_moved else ""
    ms, sigma_ms = 1000 * abs(fault.offset_s), 1000 * fault.offset_sigma_s
    return Finding(
        Code.LATE_CAMERA,
        Severity.DOUBTFUL,
        f"{fault.name} takes its images {abs(fault.offset_frames):.1f} frames ({ms:.0f} +/- {sigma_ms:.0f} ms) "
        f"{'later' if fault.offset_s > 0 else 'earlier'} than their times say, measured by the clocks of the others",
        f"Use --estimate-time-offsets{both}.{if_by_hand(fault.offset_s)}",
        0.5,
        camera=fault.name,
        numbers={"offset_s": fault.offset_s, "sigma_s": fault.offset_sigma_s},
    )


def _moved(fault: CameraFault, also_late: bool, several: bool) -> Finding:
    if fault.rotation_deg > _TWICE * BUMP_DEG or fault.translation_m > _TWICE * BUMP_M:
        return _elsewhere(fault)
    together = " and --estimate-time-offsets together" if also_late else ""
    lenses = "; or the focal lengths are not those of the calibration, which a short recording does not tell"
    return Finding(
        Code.MOVED_CAMERA,
        Severity.DOUBTFUL,
        f"{fault.name} seems to have been moved since it was calibrated, by about {fault.rotation_deg:.1f} degrees and "
        f"{100 * fault.translation_m:.0f} cm{lenses if several else ''}",
        f"Use --refine-calibration{together}.",
        0.6,
        camera=fault.name,
        numbers={"rotation_deg": fault.rotation_deg, "translation_m": fault.translation_m},
    )


def _elsewhere(fault: CameraFault) -> Finding:
    return Finding(
        Code.WRONG_CAMERA,
        Severity.DOUBTFUL,
        f"{fault.name} contradicts the others: it would have to be turned by {fault.rotation_deg:.1f} degrees and "
        f"moved by {100 * fault.translation_m:.0f} cm to agree with them, further than a bump moves a camera",
        "Was it put elsewhere since it was calibrated, or did it lose frames? Leave it out (--cameras), or calibrate "
        "again.",
        0.6,
        camera=fault.name,
        numbers={"rotation_deg": fault.rotation_deg, "translation_m": fault.translation_m},
    )
