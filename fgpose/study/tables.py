"""The end of a study: the table of quality, the table of events, and data sets of what is finished and no more."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fgpose.io.content import first_bytes
from fgpose.io.studies.data_set import part_path, parts_of
from fgpose.io.studies.rows import STUDY_NAME, write_rows
from fgpose.io.studies.state import RecordingState, load_state
from fgpose.study.chain import fingerprints
from fgpose.study.process import DATA_SETS
from fgpose.study.recording import Recording
from fgpose.study.study import Study

QUALITY, EVENTS = "quality", "events.parquet"
_MAX_REASON_BYTES = 10_000


@dataclass
class Tables:
    """What is put together from the folders of the recordings."""

    study: Study
    failures: Mapping[str, str]
    """Reasons of this run, by recording: also those that could not be written to the disk."""
    rows: list[dict[str, Any]] = field(default_factory=list)
    _parts: set[Path] = field(default_factory=set)
    _first: dict[str, str] = field(default_factory=dict)

    def add(self, recording: Recording) -> None:
        """The row of a recording, and its parts of the data sets if it is finished."""
        state = load_state(recording.folder(self.study.output)) if recording.trial else None
        status, reason = self._status(recording, state)
        row: dict[str, Any] = {
            "recording": recording.key if recording.trial else "",
            "subject": recording.subject,
            "session": recording.session,
            "trial": recording.trial,
            "status": status,
            "reason": reason,
        }
        if state is not None and status == "done":
            row |= {**state.row, "n_warnings": len(state.warnings), "warnings": "; ".join(state.warnings)}
            row["same_as"] = self._same(state, recording.key)
            self._parts |= {self._part(recording, name) for name, (step, _) in DATA_SETS.items() if step in state.steps}
        self.rows.append(row | {"source": str(recording.source)})

    def write(self) -> Iterator[Path]:
        """The tables of quality. Raises OSError if one cannot be written."""
        for suffix in (".csv", ".parquet"):
            path = self.study.output / f"{QUALITY}{suffix}"
            write_rows(self.rows, path, {STUDY_NAME: self.study.name})
            yield path

    def remove_other_parts(self) -> None:
        """Parts of data sets whose recording is not finished, or not in the study any more."""
        for name in DATA_SETS:
            for part in parts_of(self.study.output / name):
                if part not in self._parts:
                    part.unlink(missing_ok=True)

    def _part(self, recording: Recording, data_set: str) -> Path:
        return part_path(self.study.output / data_set, recording.subject, recording.session, recording.trial)

    def _status(self, recording: Recording, state: RecordingState | None) -> tuple[str, str]:
        if recording.problem:
            return "failed", recording.problem
        if recording.key in self.failures:
            return "failed", self.failures[recording.key]
        file = recording.failure(self.study.output)
        if file.exists():
            return "failed", first_bytes(file, _MAX_REASON_BYTES).decode("utf-8", "replace").partition("\n")[0]
        if state is None:
            return "not done", ""
        wanted = fingerprints(self.study, recording, state.contents)
        done = {name: step.fingerprint for name, step in state.steps.items()}
        return ("done", "") if wanted == done else ("outdated", "made with other settings")

    def _same(self, state: RecordingState, key: str) -> str:
        """The recording before it that has the same content; a copy that was forgotten counts twice in a study."""
        first = self._first.setdefault(state.contents.get("source", key), key)
        return first if first != key else ""
