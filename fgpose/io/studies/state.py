"""What has been done with a recording of a study, and from what: a JSON file in the folder of its results."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fgpose.io.atomic import write_text
from fgpose.io.content import parse_json, read_content

FILE = "state.json"
_MAX_BYTES = 16 << 20

Value = str | int | float | bool | None


@dataclass(frozen=True)
class DoneStep:
    """A step that has been done."""

    fingerprint: str
    """Of everything that it was made from."""
    files: tuple[str, ...]
    """That it wrote, in the folder of the recording."""


@dataclass(frozen=True)
class RecordingState:
    """Of a recording that is finished."""

    stamp: str
    """Names, sizes and times of its input files: while they stay, the files are not read again."""
    contents: Mapping[str, str]
    """Digests of what they hold, by kind of input."""
    steps: Mapping[str, DoneStep]
    row: Mapping[str, Value] = field(default_factory=dict)
    """Its row in the table of quality."""
    warnings: tuple[str, ...] = ()


def save_state(state: RecordingState, folder: Path) -> None:
    """Write it into the folder of a recording. Raises OSError, which names the file, if it cannot be written."""
    table = dataclasses.asdict(state)
    table["row"] = {name: _or_null(value) for name, value in state.row.items()}
    write_text(folder / FILE, json.dumps(table, indent=1))


def load_state(folder: Path) -> RecordingState | None:
    """Of a recording; None where there is none that can be read: then nothing is known of its results."""
    try:
        table = parse_json(read_content(folder / FILE, _MAX_BYTES))
        steps = {name: DoneStep(each["fingerprint"], tuple(each["files"])) for name, each in table["steps"].items()}
        if any(Path(file).name != file for step in steps.values() for file in step.files):
            return None  # results are in the folder
        return RecordingState(table["stamp"], table["contents"], steps, table["row"], tuple(table["warnings"]))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def _or_null(value: Any) -> Any:
    # JSON has no NaN.
    return None if isinstance(value, float) and not math.isfinite(value) else value
