"""What happened when in which recording, by the table of a study."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from fgpose.io.studies.events import Event, read_events
from fgpose.io.tables import Column, numbers, read_table
from fgpose.sampling import usual_step_s
from fgpose.study.pattern import PLACEHOLDERS
from fgpose.study.study import StudyDescription
from fgpose.study.trial import Trial

_Whose = tuple[tuple[str, str], ...]
COLUMNS = (
    Column("recording subject session trial", "", "which recording it is in"),
    Column("event", "", "its name"),
    Column("time_s", "s", "when it was, by the clock of the recording"),
    Column("<column>", "", "what else the table has, as text"),
)


def own_events(study: StudyDescription, recording: Trial) -> tuple[tuple[float, str], ...]:
    """Times and names of the events of a recording, in order. Raises ValueError if the table is damaged, OSError if it
    cannot be read."""
    if not study.data.events:
        return ()
    path = study.file(study.data.events)
    stat = path.stat()
    by_name = _table(path, stat.st_mtime_ns, stat.st_size)
    return tuple(sorted((event.time_s, event.name) for event in by_name.get(_whose(recording, by_name), ())))


@lru_cache(maxsize=1)
def _table(path: Path, mtime_ns: int, n_bytes: int) -> Mapping[_Whose, list[Event]]:
    """Read once in a process, and again when it has changed: all recordings of a study are looked up in it."""
    return _by_name(read_events(path))


def events_of(recordings: Iterable[Trial], events: Iterable[Event]) -> tuple[list[dict[str, Any]], list[str]]:
    """The events of recordings as rows of a table, and the names of those that no recording has."""
    by_name = _by_name(events)
    rows, found = [], set()
    for recording in recordings:
        names = _whose(recording, by_name)
        found.add(names)
        whose = {name: getattr(recording, name) for name in PLACEHOLDERS}
        rows += [
            {"recording": recording.key, **whose, "event": event.name, "time_s": event.time_s, **event.others}
            for event in by_name.get(names, ())
        ]
    return rows, ["/".join(value for _, value in names) for names in by_name if names not in found]


def events_outside(rows: Iterable[Mapping[str, Any]], motions: Mapping[str, Path]) -> list[str]:
    """Which of the rows are before the first or after the last frame of their recordings, in words.

    Args:
        rows: those of events_of.
        motions: files of the results, by recording. What is not there, or damaged, tells nothing.
    """
    by_recording: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        by_recording.setdefault(row["recording"], []).append(row)
    outside = []
    for recording, own in by_recording.items():
        time_s = _times_s(motions.get(recording))
        if not len(time_s):
            continue
        step_s = usual_step_s(time_s) if len(time_s) > 1 else 0.0
        outside += [
            f"{row['event']} at {row['time_s']:.6g} s is outside of {recording}, which lasts from {time_s[0]:.6g} to "
            f"{time_s[-1]:.6g} s"
            for row in own
            if not time_s[0] - step_s <= row["time_s"] <= time_s[-1] + step_s
        ]
    return outside


def _times_s(motion: Path | None) -> Float[np.ndarray, " frame"]:
    """Of the frames of a result, increasing."""
    if motion is None or not motion.is_file():
        return np.zeros(0)
    try:
        return np.unique(numbers(read_table(motion, ["time_s"]), "time_s"))
    except (ValueError, OSError):
        return np.zeros(0)


def _by_name(events: Iterable[Event]) -> dict[_Whose, list[Event]]:
    by_name: dict[_Whose, list[Event]] = {}
    for event in events:
        by_name.setdefault(tuple(event.whose.items()), []).append(event)
    return by_name


def _whose(recording: Trial, by_name: Mapping[_Whose, list[Event]]) -> _Whose:
    """The names of a recording in the columns that the table has."""
    return tuple((name, getattr(recording, name)) for name, _ in next(iter(by_name), ()))
