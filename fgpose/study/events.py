"""What happened when in which recording, by the table of a study."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from fgpose.io.studies.events import Event, read_events
from fgpose.study.pattern import PLACEHOLDERS
from fgpose.study.study import StudyDescription
from fgpose.study.trial import Trial

_Whose = tuple[tuple[str, str], ...]


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


def _by_name(events: Iterable[Event]) -> dict[_Whose, list[Event]]:
    by_name: dict[_Whose, list[Event]] = {}
    for event in events:
        by_name.setdefault(tuple(event.whose.items()), []).append(event)
    return by_name


def _whose(recording: Trial, by_name: Mapping[_Whose, list[Event]]) -> _Whose:
    """The names of a recording in the columns that the table has."""
    return tuple((name, getattr(recording, name)) for name, _ in next(iter(by_name), ()))
