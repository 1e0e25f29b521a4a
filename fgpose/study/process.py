"""One recording through the chain. Its folder appears whole or not at all, and what fails stops nothing else."""

from __future__ import annotations

import os
import re
import secrets
import shutil
import time
import traceback
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from threadpoolctl import threadpool_limits

from fgpose.io.atomic import write_text
from fgpose.io.studies.results import part_fingerprint, part_path, write_part
from fgpose.io.studies.state import DoneStep, RecordingState, load_state, save_state
from fgpose.study.chain import contents_of, fingerprints, inputs_of, stamp_of, steps_of
from fgpose.study.job import ANGLES, MOTION, Job
from fgpose.study.study import StudyDescription
from fgpose.study.trial import Trial

DATA_SETS = {"motion": ("estimate", MOTION), "angles": ("angles", ANGLES)}
"""Folder of each data set, and the step and file of a recording that it is put together from."""
# What options of other commands, which messages name, are called in a study file.
_IN_STUDY_FILE = {
    "--cameras": "data.cameras",
    "--fps": "data.fps",
    "--skeleton": "data.skeleton",
    "--unit": "data.unit",
    "--world-up": "steps.world_up",
    "--device": "detect.device",
}
_OPTION = re.compile(rf"(?:{'|'.join(_IN_STUDY_FILE)})\b")


@dataclass(frozen=True)
class RecordingOutcome:
    """What came of a recording."""

    recording: Trial
    status: Literal["done", "unchanged", "failed"]
    ran: tuple[str, ...] = ()
    """The steps that were done."""
    reason: str = ""
    """Why it failed."""
    took_s: float = 0.0


def process(study: StudyDescription, recording: Trial) -> RecordingOutcome:
    """Do what is due of a recording. Never raises an error of the recording: it is in the outcome, and in a file."""
    start_s = time.perf_counter()
    try:
        if recording.problem:
            raise ValueError(recording.problem)
        # One thread: other recordings are at work on the other cores, and sums come out the same on every machine.
        with threadpool_limits(limits=1), warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            ran = _work(study, recording, caught)
        recording.failure(study.output).unlink(missing_ok=True)
    except Exception as error:  # Whatever it is, the others go on.
        reason = _reason(error, recording.folder(study.output))
        details = "" if _is_expected(error) else traceback.format_exc()
        return failed(study, recording, reason, details, time.perf_counter() - start_s)
    return RecordingOutcome(recording, "done" if ran else "unchanged", ran, took_s=time.perf_counter() - start_s)


def failed(
    study: StudyDescription, recording: Trial, reason: str, details: str = "", took_s: float = 0.0
) -> RecordingOutcome:
    """The outcome of a recording that failed; the reason is also written beside its folder, if the disk takes it."""
    if recording.trial:
        try:
            write_text(recording.failure(study.output), f"{reason}\n\n{details}".rstrip() + "\n")
        except OSError as error:
            reason += f" (not written beside its results: {error})"
    return RecordingOutcome(recording, "failed", reason=reason, took_s=took_s)


def due(study: StudyDescription, recording: Trial) -> tuple[str, ...]:
    """The steps that process would do. Raises OSError if an input cannot be read."""
    if _waits(recording):
        return tuple(step.name for step in steps_of(study, recording))
    state = load_state(recording.folder(study.output))
    _, _, wanted = _wanted(study, recording, state)
    return _due(recording.folder(study.output), state, wanted)


def _work(study: StudyDescription, recording: Trial, caught: Iterable[warnings.WarningMessage]) -> tuple[str, ...]:
    folder = recording.folder(study.output)
    _remove_leftovers(folder)
    if _waits(recording):
        raise ValueError(
            f"the cameras of its session are calibrated on {recording.calibrated_on}, which has failed or is not done"
        )
    state = load_state(folder)
    stamp, contents, wanted = _wanted(study, recording, state)
    ran = _due(folder, state, wanted)
    if ran or state is None or set(state.steps) != set(wanted):
        _redo(Job(study, recording, _temporary(folder)), RecordingState(stamp, contents, {}), wanted, state, caught)
    elif state.stamp != stamp:
        save_state(replace(state, stamp=stamp), folder)
    _put_into_data_sets(study, recording, wanted)
    return ran


def _waits(recording: Trial) -> bool:
    """Whether the trial on which its cameras are calibrated is not done."""
    calibration = recording.calibration
    return bool(recording.calibrated_on) and calibration is not None and not calibration.exists()


def _wanted(
    study: StudyDescription, recording: Trial, state: RecordingState | None
) -> tuple[str, Mapping[str, str], dict[str, str]]:
    """Stamp and contents of the inputs, and the fingerprints that the steps should have."""
    inputs = inputs_of(study, recording)
    stamp = stamp_of(inputs)
    contents = state.contents if state is not None and state.stamp == stamp else contents_of(inputs)
    return stamp, contents, fingerprints(study, recording, contents)


def _due(folder: Path, state: RecordingState | None, wanted: Mapping[str, str]) -> tuple[str, ...]:
    done = state.steps if state is not None else {}

    def is_done(name: str, fingerprint: str) -> bool:
        known = name in done and done[name].fingerprint == fingerprint
        return known and all((folder / file).is_file() for file in done[name].files)

    return tuple(name for name, fingerprint in wanted.items() if not is_done(name, fingerprint))


def _redo(
    job: Job,
    new: RecordingState,
    wanted: Mapping[str, str],
    old: RecordingState | None,
    caught: Iterable[warnings.WarningMessage],
) -> None:
    """Make the folder of a recording beside the old one, from which unchanged files are taken, and put it in its
    place."""
    folder = job.recording.folder(job.study.output)
    due = _due(folder, old, wanted)
    kept = {name: old.steps[name] for name in wanted if old is not None and name not in due}
    job.folder.mkdir(parents=True)
    try:
        for file in (file for step in kept.values() for file in step.files):
            _link(folder / file, job.path(file))
        done = dict(kept)
        for step in steps_of(job.study, job.recording):
            if step.name in due:
                done[step.name] = DoneStep(wanted[step.name], _new_files(job, step.run))
        texts = dict.fromkeys(_in_study_file(" ".join(str(each.message).split())) for each in caught)
        row = job.row or (old.row if old is not None else {})
        in_order = {name: done[name] for name in wanted}
        save_state(replace(new, steps=in_order, row=row, warnings=tuple(texts)), job.folder)
        _replace(folder, job.folder)
    finally:
        shutil.rmtree(job.folder, ignore_errors=True)


def _new_files(job: Job, run: Callable[[Job], None]) -> tuple[str, ...]:
    before = set(os.listdir(job.folder))
    run(job)
    return tuple(sorted(set(os.listdir(job.folder)) - before))


def _link(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except OSError:  # Not every file system has links.
        shutil.copy2(source, target)


def _replace(folder: Path, new: Path) -> None:
    """A folder cannot be replaced by another in one step. If this is interrupted between the two, the recording is made
    anew."""
    aside = _temporary(folder)
    if folder.exists():
        os.rename(folder, aside)
    os.rename(new, folder)
    shutil.rmtree(aside, ignore_errors=True)


def _temporary(folder: Path) -> Path:
    return folder.with_name(f".{folder.name}.{secrets.token_hex(4)}")


def _remove_leftovers(folder: Path) -> None:
    """Of a process that was killed at this recording."""
    if folder.parent.is_dir():
        beginning = f".{folder.name}."
        for name in os.listdir(folder.parent):
            if name.startswith(beginning) and len(name) == len(beginning) + 8:
                shutil.rmtree(folder.parent / name, ignore_errors=True)


def _put_into_data_sets(study: StudyDescription, recording: Trial, wanted: Mapping[str, str]) -> None:
    for name, (step, file) in DATA_SETS.items():
        if step not in wanted:
            continue
        part = part_path(study.output / name, recording.subject, recording.session, recording.trial)
        if part_fingerprint(part) != wanted[step]:
            table = recording.folder(study.output) / file
            write_part(table, part, recording.key, recording.trial, wanted[step])


def _is_expected(error: Exception) -> bool:
    """Whether it is what fgpose says of bad input; LinAlgError is a ValueError, and a defect of ours."""
    expected = isinstance(error, ValueError | OSError | ImportError) and not isinstance(error, np.linalg.LinAlgError)
    return expected and bool(str(error).strip())


def _reason(error: Exception, folder: Path) -> str:
    """One line. What fgpose says of bad input is a sentence; of anything else its kind tells more."""
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        text = f"{error.filename}: {error.strerror}"
    else:
        text = " ".join(str(error).split())
    # The folder in which the results are made is gone when somebody reads this.
    text = re.sub(rf"{re.escape(f'.{folder.name}.')}[0-9a-f]{{8}}\b", lambda _: folder.name, text)
    text = _in_study_file(text)
    return text if _is_expected(error) else f"{type(error).__name__}: {text}".rstrip(": ")


def _in_study_file(message: str) -> str:
    """With what the options that it names are called there."""
    return _OPTION.sub(lambda option: _IN_STUDY_FILE[option[0]], message)
