"""Reading what `fgpose study` has written, for its report, and the picture of each recording in it."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np
from jaxtyping import Float

from fgpose.diagnosis.finished import FinishedRecording, Mark
from fgpose.diagnosis.series import root_m
from fgpose.geometry.up_axis import UpChoice
from fgpose.io.content import first_bytes
from fgpose.io.studies.results import STUDY_NAME, WORLD_UP, check_unlinked
from fgpose.io.tables import column_names, file_metadata, read_table
from fgpose.plain_files import naming
from fgpose.report.plots import gathered, ramp
from fgpose.report.report import digest_of_told, write_report
from fgpose.report.results import load_finished, said_up
from fgpose.report.sections.cameras import SEEN_PALETTE
from fgpose.report.study_report import StudyRecording

TABLE, RECORDINGS, MOTION, REPORT = "quality.parquet", "recordings", "motion.parquet", "report.html"
EVENTS = "events.parquet"
Progress = Callable[[int, int], None]
_WIDTH, _EXTENT, _STRIP, _HEIGHT = 72, 40, 110, 40  # pixels: of the way, of its length in words, of the strip
_EDGE = 3  # pixels around the way
_WAY_POINTS, _BINS = 60, 60
_HEAD_BYTES = 2000  # of a page: what it was told is before its title
_LEVELS = ramp(SEEN_PALETTE, 9)


def is_study(folder: Path) -> bool:
    """Whether there is the table of a study. Raises ValueError, which names it, if it is damaged."""
    table = folder / TABLE
    with naming(table):
        return table.is_file() and "recording" in column_names(table)


def study_name(folder: Path) -> str:
    """How a study calls itself; older ones as their folder. Raises ValueError if its table is damaged."""
    return file_metadata(folder / TABLE).get(STUDY_NAME) or folder.resolve().name


def study_up(folder: Path) -> UpChoice:
    """What a study says to be up in the worlds of its calibrations; of older ones auto. Raises ValueError if its table
    is damaged."""
    said = file_metadata(folder / TABLE).get(WORLD_UP, "auto")
    if said not in get_args(UpChoice):
        raise ValueError(
            f"{folder / TABLE}: the axis that points up is none of {', '.join(get_args(UpChoice))}: {said!r}"
        )
    return cast(UpChoice, said)


def load_study(
    folder: Path, *, reports: bool = True, page: Path | None = None, progress: Progress | None = None
) -> list[StudyRecording]:
    """All recordings of a study.

    Args:
        folder: of its results.
        reports: whether the report of each recording is written too, where there is none that is newer than its motion
            and has its events.
        page: where the report on the study will be; by default in the folder.
        progress: told after each recording.

    Raises:
        ValueError: the table is damaged; it is named.
        OSError: a file cannot be read or written, or is a link (check_unlinked).
    """
    check_unlinked(folder)
    with naming(folder / TABLE):
        rows: list[dict[str, Any]] = read_table(folder / TABLE).to_pylist()
    base = (page or folder / REPORT).parent
    marks, world_up = _marks(folder / EVENTS), study_up(folder)
    found = []
    for n, row in enumerate(rows):
        found.append(_recording(folder, row, base, world_up, marks if reports else None))
        if progress:
            progress(n + 1, len(rows))
    return found


def _marks(path: Path) -> dict[str, list[Mark]]:
    """The events of each recording. Raises ValueError if the table is damaged; it is named."""
    found: dict[str, list[Mark]] = {}
    if path.is_file():
        with naming(path, "no table of events", damage=(KeyError, TypeError)):
            for row in read_table(path, ["recording", "time_s", "event"]).to_pylist():
                found.setdefault(str(row["recording"]), []).append(Mark(float(row["time_s"]), str(row["event"])))
    return found


def _recording(
    folder: Path, row: dict[str, Any], base: Path, world_up: UpChoice, marks: Mapping[str, list[Mark]] | None
) -> StudyRecording:
    """None in place of marks: no report is written."""
    name = str(row.get("recording") or row.get("source") or "")
    status = str(row.get("status") or "done")
    own = folder / RECORDINGS / name
    if not own.resolve().is_relative_to((folder / RECORDINGS).resolve()):
        raise ValueError(f"{folder / TABLE}: the recording {name!r} is outside of {folder / RECORDINGS}")
    motion, report = own / MOTION, own / REPORT
    numbers = {key: float(value) for key, value in row.items() if isinstance(value, bool | int | float)}
    words = [str(row.get(key) or "") for key in ("reason", "suspicions", "warnings")]
    picture, failure = "", ""
    if row.get("recording") and motion.is_file() and status == "done":
        try:
            picture = _shown(motion, report, name, world_up, marks)
        except ValueError as error:  # One damaged file does not cost the report of the others.
            status, failure, numbers = "failed", str(error), {}
    return StudyRecording(
        name=name,
        numbers=numbers if status == "done" else {},
        status=status,
        reason="; ".join(word for word in [failure, *words] if word),
        report=Path(os.path.relpath(report, base)).as_posix() if report.is_file() else "",
        picture=picture,
    )


def _shown(motion: Path, report: Path, name: str, world_up: UpChoice, marks: Mapping[str, list[Mark]] | None) -> str:
    """The picture of a recording, whose report is written if it is due."""
    own = tuple(sorted((marks or {}).get(name, ()), key=lambda mark: (mark.time_s, mark.name)))
    due = marks is not None and not _is_of(report, motion, digest_of_told(own, said_up(world_up)))
    recording = load_finished(motion, title=name, world_up=world_up, observed=due)
    if due:
        write_report(replace(recording, marks=own), report)
    return thumbnail(recording)


def _is_of(report: Path, motion: Path, told: str) -> bool:
    """Whether there is a page that is newer than the result, and of what is told of it now."""
    if not report.is_file() or report.stat().st_mtime < motion.stat().st_mtime:
        return False
    return told.encode() in first_bytes(report, _HEAD_BYTES)


def thumbnail(recording: FinishedRecording) -> str:
    """As SVG: the way of the hips of the main person from above, turned so that it fills the picture, and how far it
    reaches; then the share of joints that two cameras see, over time."""
    trajectory = recording.main
    way_m = gathered(root_m(trajectory), _WAY_POINTS)[:, :2]
    way, reach_m = _way(way_m[np.isfinite(way_m).all(axis=1)])
    strip = _strip(gathered(trajectory.observed.mean(axis=1), _BINS))
    seen = float(trajectory.observed.mean())
    size = f'width="{_WIDTH + _EXTENT + _STRIP}" height="{_HEIGHT}"'
    reach = f"{reach_m:.1f} m" if reach_m >= 1 else f"{100 * reach_m:.0f} cm"
    label = f"way over the floor, {reach}; {100 * seen:.0f} % of the joints seen by two cameras"
    words = f'<text x="{_WIDTH + 2}" y="24" font-size="11" fill="currentColor">{reach}</text>'
    return f'<svg {size} role="img" aria-label="{label}"><title>{label}</title>{way}{words}{strip}</svg>'


def _way(way_m: Float[np.ndarray, "point 2"]) -> tuple[str, float]:
    """A line that ends in a dot, and how far it reaches along its longer side, metres."""
    if len(way_m) < 2:
        return "", 0.0
    centred_m = way_m - way_m.mean(axis=0)
    _, _, directions = np.linalg.svd(centred_m, full_matrices=False)
    turned_m = centred_m @ directions.T
    low_m, high_m = turned_m.min(axis=0), turned_m.max(axis=0)
    room = np.array([_WIDTH, _HEIGHT], dtype=float) - 2 * _EDGE
    scale = float((room / np.maximum(high_m - low_m, 1e-3)).min())
    places = (turned_m - (low_m + high_m) / 2) * scale * (1, -1) + (_WIDTH / 2, _HEIGHT / 2)
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in places.tolist())
    x, y = places[-1].tolist()
    line = f'<polyline points="{points}" fill="none" style="stroke:var(--accent,#0b6e86)" stroke-width="1.5"/>'
    return f'{line}<circle cx="{x:.1f}" cy="{y:.1f}" r="2.5" fill="#d55e00"/>', float((high_m - low_m).max())


def _strip(share: Float[np.ndarray, " bin"]) -> str:
    """Runs of equal colour as rectangles."""
    level = np.round(np.nan_to_num(share) * (len(_LEVELS) - 1)).astype(int)
    first = np.flatnonzero(np.diff(level, prepend=-1))
    width = _STRIP / len(level)
    ends = [*first[1:].tolist(), len(level)]
    return "".join(
        f'<rect x="{_WIDTH + _EXTENT + start * width:.1f}" y="14" width="{(end - start) * width:.1f}" height="12" '
        f'fill="{_LEVELS[level[start]]}"/>'
        for start, end in zip(first.tolist(), ends, strict=True)
    )
