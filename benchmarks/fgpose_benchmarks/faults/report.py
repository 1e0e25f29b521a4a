"""The table of the benchmark of faults."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from fgpose.io.atomic import write_text
from fgpose.io.content import parse_json, read_content
from fgpose.plain_files import naming
from fgpose_benchmarks.faults.benchmark import DAMAGES
from fgpose_benchmarks.faults.outcome import UNDAMAGED, DamageOutcome

_HEAD = (
    "Recordings of one person who walks about and works, with the errors of real networks, and two real ones "
    "(balance, 1.7 s, only damages that do not change in time; webcams) are damaged as laboratories damage them, "
    "estimated with the defaults and diagnosed. The truth of the real ones is what all four cameras say together, as "
    "good as it claims; what is doubtful of them undamaged does not count. *Harmful*: the 95 % error is more than "
    "twice that without damage, or fewer than 90 % of the errors lie within the claimed 99 % ellipsoids (of real ones"
    " at least 5 % fewer than without damage). *Silent*: harmful, and nothing is called wrong or doubtful. *Cause*: "
    "of the recordings of which something is said, or whose damage is harmful, those in which the first thing said is"
    " the cause, of the right camera. *Error*: median of the 95 % error over that without damage; *after*: the same "
    "after the advice was followed, where it can be followed on what was recorded, median and largest, over that of "
    "the undamaged recording with the cameras that the advice leaves; *worse*: how often it is larger than before."
)


OUTCOMES = "outcomes.json"


def write_outcomes(outcomes: Iterable[DamageOutcome], path: Path) -> None:
    """To be read again. Raises OSError as write_text does."""
    write_text(path, json.dumps([dataclasses.asdict(outcome) for outcome in outcomes], indent=1) + "\n")


def read_outcomes(path: Path) -> list[DamageOutcome]:
    """Those of write_outcomes; raises OSError or ValueError."""
    with naming(path, "not outcomes of faults", damage=(TypeError, KeyError)):
        return [DamageOutcome(**(each | {"found": tuple(each["found"])})) for each in parse_json(read_content(path))]


def _order(damage: str) -> int:
    names = [each.name for each in DAMAGES]
    return names.index(damage) if damage in names else -1


def write_report(outcomes: Sequence[DamageOutcome], folder: Path, command: str) -> Path:
    """Write report.md and outcomes.json into a folder, whole or not at all.

    Raises:
        OSError: the folder cannot be written into.
    """
    outcomes = sorted(outcomes, key=lambda each: (_order(each.damage), each.clip, each.rig))
    write_outcomes(outcomes, folder / OUTCOMES)
    damaged = [outcome for outcome in outcomes if outcome.damage != UNDAMAGED]
    undamaged = [outcome for outcome in outcomes if outcome.damage == UNDAMAGED]
    alarms = [outcome for outcome in undamaged if outcome.said]
    named = [outcome for outcome in damaged if outcome.said or outcome.harmful]
    parts = [
        "# The benchmark of faults",
        f"To reproduce:\n\n    {command}",
        _HEAD,
        f"Silent {sum(outcome.silent for outcome in damaged)} of {len(damaged)} damaged recordings; cause right "
        f"{_share([outcome.right for outcome in named])}; false alarms {len(alarms)} of {len(undamaged)} undamaged "
        "recordings.",
        _table(damaged),
    ]
    parts += [f"## {rig}\n\n" + _table([each for each in damaged if each.rig == rig]) for rig in _names(damaged)]
    for title, some in (("False alarms", alarms), ("Another cause", [each for each in named if not each.right])):
        rows = [f"- {each.clip}, {each.rig}, {each.damage}: {', '.join(each.found[:2]) or '-'}" for each in some]
        parts += [f"## {title}\n\n" + "\n".join(rows)] if rows else []
    path = folder / "report.md"
    write_text(path, "\n\n".join(parts) + "\n")
    return path


def _names(outcomes: Sequence[DamageOutcome]) -> list[str]:
    return list(dict.fromkeys(outcome.rig for outcome in outcomes))


def _table(outcomes: Sequence[DamageOutcome]) -> str:
    rows = [
        "| damage | recordings | harmful | silent | cause [%] | error | after (largest) | worse |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for damage in dict.fromkeys(outcome.damage for outcome in outcomes):
        own = [outcome for outcome in outcomes if outcome.damage == damage]
        named = [outcome.right for outcome in own if outcome.said or outcome.harmful]
        ratio = np.array([outcome.error_mm / outcome.undamaged_mm for outcome in own])
        after = np.array([outcome.followed_mm / outcome.attainable_mm for outcome in own])
        # A fiftieth is not larger: the estimator converges to millimetres.
        worse = sum(outcome.followed_mm > 1.02 * outcome.error_mm for outcome in own)
        counts = f"{len(own)} | {sum(each.harmful for each in own)} | {sum(each.silent for each in own)}"
        rows.append(
            f"| {damage} | {counts} | {_share(named)} | {_median(ratio)} | {_median(after, largest=True)} | {worse} |"
        )
    return "\n".join(rows)


def _share(values: Sequence[bool]) -> str:
    return f"{100 * np.mean(values):.0f}" if len(values) else "-"


def _median(values: np.ndarray, *, largest: bool = False) -> str:
    known = values[np.isfinite(values)]
    if not known.size:
        return "-"
    text = f"{np.median(known):.2f}" if np.median(known) < 100 else f"{np.median(known):.0f}"
    return f"{text} ({known.max():.2f})" if largest else text
