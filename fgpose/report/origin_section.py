"""What a result was made from, and with."""

from __future__ import annotations

from pathlib import Path

from fgpose.config import Config, config_to_toml
from fgpose.diagnosis.finished import FinishedRecording
from fgpose.report.blocks import Block, Cell, Note, Section, Table, Text
from fgpose.report.origin_facts import without_home


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
    rows = tuple((Cell(name), Cell(value)) for name, value in facts.items())
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
