"""What the file of a result says of its origin, for the report."""

from __future__ import annotations

import re
from pathlib import Path

from fgpose.calibration.from_people.calibrated import Finding, Grade
from fgpose.io.origin import InputFile, Origin


def facts_of(origin: Origin) -> dict[str, str]:
    """As they are to be read, by name."""
    facts = {f"{each.what} {each.camera}".rstrip(): _described(each) for each in origin.inputs}
    if origin.calibration.grade:
        facts["Calibration from people"] = origin.calibration.grade
    for each in origin.calibration.moved:
        facts[f"Camera {each.camera} moved by"] = f"{each.rotation_deg:.2f}°, {1000 * each.translation_m:.0f} mm"
    if origin.remarks:
        facts["Read with changes"] = "; ".join(origin.remarks)
    if origin.command:
        facts["Command"] = origin.command
    if origin.fgpose:
        facts["Version of fgpose"] = origin.fgpose
    return facts


def without_home(text: str, folder: Path) -> str:
    """The text with paths relative to this folder, which is absolute, and without the name of whose home they are in: a
    report is given to others."""
    home = Path.home()
    for n_up, above in enumerate((folder, *folder.parents)):
        if len(above.parts) <= 2 or home.is_relative_to(above):
            break
        text = _relative(text, above, n_up * "../")
    return _relative(text, home, "~/")


def _relative(text: str, folder: Path, instead: str) -> str:
    return re.sub(rf"(?<![\w/.~-]){re.escape(str(folder))}/", instead, text)


def _described(file: InputFile) -> str:
    parts = [file.path]
    if file.image_px:
        parts.append(" × ".join(map(str, file.image_px)) + " px")
    if file.rate_hz:
        parts.append(f"{file.rate_hz:.4g} Hz")
    return ", ".join([*parts, _size(file.size_bytes)])


def _size(n_bytes: int) -> str:
    return f"{n_bytes / 1e6:.1f} MB" if n_bytes >= 1e5 else f"{n_bytes / 1e3:.1f} kB"


def findings_of(origin: Origin) -> tuple[Finding, ...]:
    """Of the calibration from people; those with a grade that this version does not know are left out."""
    known = {grade.value: grade for grade in Grade}
    return tuple(
        Finding(each.camera, known[each.grade], each.reason, each.remedy)
        for each in origin.calibration.findings
        if each.grade in known
    )
