"""What a calibration from people found, as figures and in words: for the command line and for the viewer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fgpose.calibration.bumped import BumpedRig
from fgpose.calibration.from_people.calibrated import CalibratedFromPeople, CalibrationFinding, Grade, by_remedy
from fgpose_factors.robust_statistics import known_median

_GRADES = {
    Grade.GOOD: "good",
    Grade.COARSE: "coarse: good enough to begin from, not to measure with",
    Grade.FAILED: "failed: no rig is written",
}


def camera_rows(result: CalibratedFromPeople) -> dict[str, list[str]]:
    """By quantity, one value for each camera: place, direction, focal length and start, each with its standard
    deviation, the joints that were used, and what they are off by."""
    rig, sigmas = result.rig, result.sigmas
    position_m = rig.positions_m
    forward = np.stack([camera.world_T_camera[:3, 2] for camera in rig.cameras])
    used = np.isfinite(result.residual_px)
    rows = {f"place {axis} [m]": texts(position_m[:, a], 2) for a, axis in enumerate("xyz")}
    rows["  ± [mm]"] = texts(1000 * sigmas.position_m, 0)
    rows["looks towards [deg from x]"] = texts(np.rad2deg(np.arctan2(forward[:, 1], forward[:, 0])), 1)
    rows["looks up [deg]"] = texts(np.rad2deg(np.arcsin(np.clip(forward[:, 2], -1, 1))), 1)
    rows["  ± [deg]"] = texts(sigmas.direction_deg, 2)
    rows["focal length [px]"] = texts(rig.focal_px, 0)
    rows["  ± [%]"] = texts_unless_given(100 * sigmas.focal, 1)
    rows["start [s]"] = texts(rig.time_offsets_s, 3)
    rows["  ± [ms]"] = texts_unless_given(1000 * sigmas.offset_s, 1)
    rows["joints used"] = [str(n) for n in used.sum(axis=(0, 2)).tolist()]
    rows["residual, median [px]"] = texts(
        np.array([known_median(each) for each in result.residual_px.swapaxes(0, 1)]), 1
    )
    return rows


def summary(result: CalibratedFromPeople) -> list[str]:
    """The walk, the scale, the vertical and the floor, each with its standard deviation, in sentences."""
    time_s, sigmas = result.walk.time_s, result.sigmas
    known = result.joints_m[np.isfinite(result.joints_m).all(axis=-1)]
    lines = []
    if len(known):
        # A few joints that are far off would make a large room of a small one.
        low, high = np.quantile(known, [0.01, 0.99], axis=0)
        x, y, z = (high - low).tolist()
        lines.append(
            f"The walk: {len(time_s)} frames in {time_s[-1] - time_s[0]:.1f} s; it covered {x:.1f} x {y:.1f} m of the "
            f"floor, up to {z:.1f} m above its lowest point. Outside, the calibration is extrapolated."
        )
    lines.append(
        f"Scale from {result.scale_from}, ± {100 * sigmas.scale:.1f} %; vertical ± {sigmas.vertical_deg:.1f} deg; "
        f"floor ± {1000 * sigmas.floor_m:.0f} mm."
    )
    return lines


def verdict(findings: Sequence[CalibrationFinding], grade: Grade) -> list[str]:
    """The verdict, and the reasons with what helps, those that the same helps against together; the gravest first."""
    return [f"Verdict: {_GRADES[grade]}.", *map(_sentence, by_remedy(findings))]


def _sentence(findings: Sequence[CalibrationFinding]) -> str:
    grade, remedy = findings[0].grade.value, findings[0].remedy
    reasons = "; ".join(finding.text for finding in findings)
    return f"- {grade}, {reasons}." + (f" Remedy: {remedy}." if remedy else "")


def markdown(result: CalibratedFromPeople) -> str:
    """The same as one page."""
    said = verdict(result.findings, result.grade)
    return page(said, summary(result), result.rig.names, camera_rows(result))


def bumped_rows(bumped: BumpedRig[Any]) -> dict[str, list[str]]:
    """By quantity, one value for each camera: by how much it was moved, and how well it agrees with the others."""
    return {
        "turned by [deg]": texts(bumped.rotation_deg, 2),
        "moved by [mm]": texts(1000 * bumped.translation_m, 0),
        "error before [px]": texts(bumped.residual_before_px, 1),
        "error after [px]": texts(bumped.residual_after_px, 1),
    }


def bumped_summary(bumped: BumpedRig[Any]) -> str:
    names = [name for name, moved in zip(bumped.rig.names, bumped.moved.tolist(), strict=True) if moved]
    return f"Moved: {', '.join(names)}. The others keep their poses." if names else "No camera was moved."


def bumped_markdown(bumped: BumpedRig[Any]) -> str:
    """The same as one page."""
    said = verdict(bumped.findings, bumped.grade)
    return page(said, [bumped_summary(bumped)], bumped.rig.names, bumped_rows(bumped))


def page(said: list[str], lines: list[str], names: Sequence[str], rows: dict[str, list[str]]) -> str:
    table = [f"| | {' | '.join(names)} |", "|---" * (len(names) + 1) + "|"]
    table += [f"| {quantity.strip()} | {' | '.join(values)} |" for quantity, values in rows.items()]
    return "\n".join([f"**{said[0]}**", "", *said[1:], "", *(each for line in lines for each in (line, "")), *table])


def texts(values: np.ndarray, digits: int) -> list[str]:
    return ["-" if np.isnan(value) else f"{value:.{digits}f}" for value in values.tolist()]


def texts_unless_given(values: np.ndarray, digits: int) -> list[str]:
    return ["given" if value == 0 else text for value, text in zip(values.tolist(), texts(values, digits), strict=True)]
