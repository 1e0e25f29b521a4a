"""What a result was made from, and with."""

from __future__ import annotations

import re
from pathlib import Path

from fgpose.calibration.from_people.calibrated import CalibrationFinding, Grade
from fgpose.config import Config, config_to_toml
from fgpose.diagnosis.finished import FinishedRecording
from fgpose.io.origin import InputFile, MovedCamera, Origin
from fgpose.report.blocks import Block, Note, Section, Table, TableCell, Text

FROM_PEOPLE = "from people"
"""How cameras were calibrated whose file has a verdict and does not say."""


def origin_section(recording: FinishedRecording) -> Section:
    """Files, skeleton, rates, versions and settings."""
    trajectory, blocks = recording.main, list[Block]()
    facts = dict(recording.made_from)
    facts["Skeleton"] = f"{trajectory.skeleton.name}, {trajectory.skeleton.n_joints} joints"
    facts["Cameras"] = ", ".join(recording.camera_names) or "not stored with the result"
    if recording.videos is not None and "Videos" not in facts:
        facts["Videos"] = without_home(str(recording.videos), Path.cwd())
    if trajectory.convergence is not None:
        convergence = trajectory.convergence
        ended = "converged" if convergence.converged else "not converged"
        facts["Optimiser"] = (
            f"{ended}, {convergence.iterations} iterations, objective {convergence.initial_error:.4g} → "
            f"{convergence.final_error:.4g}"
        )
    rows = tuple((TableCell(name), TableCell(value)) for name, value in facts.items())
    blocks.append(Table(("what", "value"), rows, "Recording", numeric=(False, False)))
    if trajectory.config is None:
        blocks.append(Note("The settings were not stored with the result.", is_missing=True))
    else:
        changed = changed_settings(trajectory.config)
        differ = f"Settings that differ from the defaults: {', '.join(changed)}."
        blocks.append(Note(differ if changed else "All settings are the defaults."))
        blocks.append(Text("All settings", config_to_toml(trajectory.config)))
    return Section("What was recorded, and with what", "origin", blocks, short="Origin")


def changed_settings(config: Config) -> list[str]:
    """As "motion.model = random_walk", those that are not the defaults."""
    found, usual = [], Config()
    for group in usual.__dataclass_fields__:
        own, default = getattr(config, group), getattr(usual, group)
        names = getattr(default, "__dataclass_fields__", {})
        found += [
            f"{group}.{name} = {getattr(own, name)}" for name in names if getattr(own, name) != getattr(default, name)
        ]
    return found


def facts_of(origin: Origin) -> dict[str, str]:
    """As they are to be read, by name."""
    facts = {f"{each.what} {each.camera}".rstrip(): _described(each) for each in origin.inputs}
    if origin.calibration.grade:
        facts[f"Calibration {origin.calibration.method or FROM_PEOPLE}"] = origin.calibration.grade
    for each in origin.calibration.moved:
        facts[f"Camera {each.camera} moved by"] = _move(each)
    if origin.calibration.shift_sigma_m:
        facts["Everything may be shifted by"] = f"{1000 * origin.calibration.shift_sigma_m:.0f} mm (SD along each axis)"
    if origin.remarks:
        facts["Read with changes"] = "; ".join(origin.remarks)
    if origin.command:
        facts["Command"] = origin.command
    if origin.fgpose:
        facts["Version of fgpose"] = origin.fgpose
    return facts


def _move(camera: MovedCamera) -> str:
    by = f"{camera.rotation_deg:.2f}°, {1000 * camera.translation_m:.0f} mm"
    if not camera.rotation_sigma_deg:
        return by
    known = f"{camera.rotation_sigma_deg:.2f}°, {1000 * camera.translation_sigma_m:.0f} mm"
    return f"{by}; now known to {known} (SD about and along each axis)"


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


def findings_of(origin: Origin) -> tuple[CalibrationFinding, ...]:
    """Of the calibration; those with a grade that this version does not know are left out."""
    known = {grade.value: grade for grade in Grade}
    return tuple(
        CalibrationFinding(each.camera, known[each.grade], each.reason, each.remedy)
        for each in origin.calibration.findings
        if each.grade in known
    )
