"""A whole study: its recordings through the workers, and what is put together from them."""

from __future__ import annotations

import fcntl
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from fgpose.io.atomic import check_writable
from fgpose.io.content import first_bytes
from fgpose.io.studies.events import Event, read_events
from fgpose.io.studies.results import LOCK, STUDY_NAME, WORLD_UP, check_unlinked, part_path, parts_of, write_rows
from fgpose.io.studies.state import RecordingState, load_state
from fgpose.io.tables import Column
from fgpose.study.chain import fingerprints
from fgpose.study.cluster import run, workers
from fgpose.study.events import events_of, events_outside
from fgpose.study.job import MOTION
from fgpose.study.plan import Plan
from fgpose.study.process import DATA_SETS, RecordingOutcome
from fgpose.study.study import StudyDescription
from fgpose.study.trial import Trial

QUALITY, EVENTS = "quality", "events.parquet"
_MAX_REASON_BYTES = 10_000
OnBegin = Callable[[int], None]
"""Called with the number of recordings once the workers are there."""
OnOutcome = Callable[[RecordingOutcome], None]
"""Called with each outcome as it comes."""
COLUMNS = (
    Column("recording subject session trial", "", "which it is"),
    Column("status", "", "`done`, `failed`, `not done`, `outdated`"),
    Column("reason", "", "why it is not done"),
    Column("n_people n_cameras n_joints n_frames", "", "how many there are"),
    Column("rate_hz", "Hz", "frames per second"),
    Column("duration_s", "s", "from the first frame of anybody to the last"),
    Column(
        "seen_share predicted_share unobservable_share",
        "0 to 1",
        "of joints and frames: two cameras or more see it, it is predicted, nothing determines it",
    ),
    Column("views", "", "cameras that see a joint, on average"),
    Column(
        "longest_gap_s",
        "s",
        "longest time for which fewer than two cameras saw one of the joints, from the first frame in which its "
        "person is there to the last; all of it for a joint that is never seen, and whoever goes and comes back "
        "is not seen meanwhile",
    ),
    Column(
        "reprojection_px reprojection_q90_px",
        "px",
        "reprojection error of all detections, undistorted: median, 90 %",
    ),
    Column("worst_camera_px", "px", "median of the camera with the largest"),
    Column("hallucinated_share", "0 to 1", "of the detections: more probably hallucinated than not"),
    Column("sigma_mm sigma_q95_mm", "mm", "root of the largest eigenvalue of the covariances: median, 95 %"),
    Column(
        "bone_spread_share",
        "",
        "standard deviation of bone lengths over time, relative to the length; median over the bones",
    ),
    Column("bone_asymmetry_share", "", "largest difference of a left limb to its right one, relative to their mean"),
    Column(
        "max_speed_mps",
        "m/s",
        "largest speed of the root of a body from one frame to the next, where frames are missing too; `centre` "
        "in the tables of angles is over two steps, so its largest is mostly less",
    ),
    Column("converged", "", "whether the optimiser ended by itself"),
    Column("n_suspicions suspicions", "", "what is suspicious: how much, and what, separated by semicolons"),
    Column("n_warnings warnings", "", "what was warned of"),
    Column("same_as", "", "a recording before it with the same content"),
    Column("source", "", "the files it is made from"),
)


@dataclass
class Tables:
    """What is put together from the folders of the recordings."""

    study: StudyDescription
    failures: Mapping[str, str]
    """Reasons of this run, by recording: also those that could not be written to the disk."""
    rows: list[dict[str, Any]] = field(default_factory=list)
    _parts: set[Path] = field(default_factory=set)
    _first: dict[str, str] = field(default_factory=dict)

    def add(self, recording: Trial) -> None:
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
            self._parts |= {
                part_path(self.study.output / name, recording.subject, recording.session, recording.trial)
                for name, (step, _) in DATA_SETS.items()
                if step in state.steps
            }
        self.rows.append(row | {"source": str(recording.source)})

    def write(self) -> Iterator[Path]:
        """The tables of quality. Raises OSError if one cannot be written."""
        known = {STUDY_NAME: self.study.name, WORLD_UP: self.study.steps.world_up}
        for suffix in (".csv", ".parquet"):
            path = self.study.output / f"{QUALITY}{suffix}"
            write_rows(self.rows, path, known)
            yield path

    def remove_other_parts(self) -> None:
        """Parts of data sets whose recording is not finished, or not in the study any more."""
        for name in DATA_SETS:
            for part in parts_of(self.study.output / name):
                if part not in self._parts:
                    part.unlink(missing_ok=True)

    def _status(self, recording: Trial, state: RecordingState | None) -> tuple[str, str]:
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


@dataclass
class StudyResult:
    """What came of a study."""

    output: Path
    counts: Counter[str] = field(default_factory=Counter)
    """Of recordings, by the status of their outcome: done, unchanged, failed."""
    failures: list[tuple[str, str]] = field(default_factory=list)
    """Recording and reason."""
    notes: list[str] = field(default_factory=list)
    """What else should be known: events of no recording or outside of theirs, a table that could not be written."""
    written: list[Path] = field(default_factory=list)
    """Tables."""


def run_study(
    study: StudyDescription,
    *,
    scheduler: str = "",
    n_workers: int | None = None,
    only: str = "",
    on_begin: OnBegin | None = None,
    on_outcome: OnOutcome | None = None,
) -> StudyResult:
    """Do what is due of every recording, and put the results together.

    Everything that is finished stays, however this ends, and is not done again.

    Args:
        study: what is wanted.
        scheduler: address of a Dask scheduler. What it sends is run here: only one that is trusted.
        n_workers: processes on this machine, instead of those of the study.
        only: pattern of subject/session/trial.
        on_begin: told of how many recordings there are.
        on_outcome: told of each recording.

    Raises:
        ValueError: there is no recording, the table of events is damaged, or workers have another version of fgpose.
        OSError: results cannot be written into the output folder, another process is at work there, or the scheduler
            does not answer or has gone.
        ImportError: Dask is not installed.
    """
    plan = Plan(study, only)
    events = read_events(study.file(study.data.events)) if study.data.events else ()
    n_recordings = plan.counted()
    _check_output(study)
    resources = replace(study.resources, workers=n_workers or study.resources.workers)
    result = StudyResult(study.output)
    with _alone(study.output), workers(resources, scheduler) as client:
        if on_begin:
            on_begin(n_recordings)
        try:
            for outcome in (each for stage in plan.stages() for each in run(client, study, stage)):
                _note(result, outcome)
                if on_outcome:
                    on_outcome(outcome)
        finally:
            # Also of what was finished before an interruption.
            _put_together(result, Plan(study), events)
    return result


def _check_output(study: StudyDescription) -> None:
    """Raise OSError if results cannot be written into the folder, or would be written elsewhere through a link."""
    named, base = Path(os.path.normpath(study.output)), study.base
    if named.is_relative_to(base) and not named.resolve().is_relative_to(base.resolve()):
        raise OSError(
            f"{named} leads to {named.resolve()}, outside of the folder of the study: if results belong there, name "
            "it as output in the study file"
        )
    check_writable(study.output)
    check_unlinked(study.output)


def _note(result: StudyResult, outcome: RecordingOutcome) -> None:
    result.counts[outcome.status] += 1
    if outcome.status == "failed":
        name = outcome.recording.key if outcome.recording.trial else str(outcome.recording.source.name)
        result.failures.append((name, outcome.reason))


def _put_together(result: StudyResult, plan: Plan, events: tuple[Event, ...]) -> None:
    """Tables and data sets of all recordings of the study. One that cannot be written is noted: the recordings are not
    lost with it."""
    study = plan.study
    tables = Tables(study, dict(result.failures))
    for recording in plan:
        tables.add(recording)
    try:
        result.written += tables.write()
        tables.remove_other_parts()
        if not events:
            (study.output / EVENTS).unlink(missing_ok=True)  # those of an earlier run
        else:
            recordings = [each for each in plan if not each.problem]
            rows, unknown = events_of(recordings, events)
            motions = {each.key: each.folder(study.output) / MOTION for each in recordings}
            write_rows(rows, study.output / EVENTS)
            result.written.append(study.output / EVENTS)
            result.notes += [f"{study.data.events}: there is no recording {whose}" for whose in unknown]
            result.notes += [f"{study.data.events}: {what}" for what in events_outside(rows, motions)]
    except OSError as error:
        result.notes.append(str(error))


@contextmanager
def _alone(output: Path) -> Iterator[None]:
    """Raises OSError if another process works on a study in this folder. The lock ends with the process."""
    # A link in a study from elsewhere could name any file: it is not followed, and nothing is emptied.
    try:
        lock = os.open(output / LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK, 0o666)
    except OSError as error:
        raise OSError(f"cannot lock {output / LOCK}: {error.strerror}") from None
    with open(lock, "r+b", buffering=0) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise OSError(f"another fgpose study is at work in {output}") from None
        yield
