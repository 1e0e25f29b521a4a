"""The chain of steps, and which of them are due: a step whose inputs have not changed is not done again."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import astuple, dataclass
from importlib.metadata import version
from pathlib import Path

from fgpose.io.names import files_below
from fgpose.plain_files import open_plain
from fgpose.study.events import own_events
from fgpose.study.job import Job
from fgpose.study.steps import (
    detect,
    estimate,
    export,
    find_starts,
    judge,
    measure_angles,
    recalibrate,
    report,
    synchronises,
)
from fgpose.study.study import StudyDescription, skeleton_of
from fgpose.study.trial import Trial

_PART_BYTES = 1 << 20


def inputs_of(study: StudyDescription, recording: Trial) -> dict[str, Path]:
    """The files and folders from which a recording is made, by what they are."""
    inputs = {"source": recording.source}
    if recording.calibration is not None:
        inputs["calibration"] = recording.calibration
    skeleton = skeleton_of(study)
    if isinstance(skeleton, Path):
        inputs["skeleton"] = skeleton
    if study.from_people.intrinsics:
        inputs["intrinsics"] = study.file(study.from_people.intrinsics)
    for name, text in (("model", study.detect.model), ("detector", study.detect.detector)):
        if text and recording.kind == "videos" and study.file(text).is_file():
            inputs[name] = study.file(text)
    return inputs


def stamp_of(inputs: Mapping[str, Path]) -> str:
    """Digest of names, sizes and times of all files. Raises OSError if one cannot be seen."""
    digest = hashlib.blake2b(digest_size=16)
    for name, path in inputs.items():
        digest.update(f"{name}\0{path}\0".encode())
        for file, entry in _files(path):
            stat = entry.stat()
            digest.update(f"{file}\0{stat.st_size}\0{stat.st_mtime_ns}\0".encode())
    return digest.hexdigest()


def contents_of(inputs: Mapping[str, Path]) -> dict[str, str]:
    """Digest of what each input holds, whatever it is called. Raises OSError if a file cannot be read."""
    return {name: _content(path) for name, path in inputs.items()}


def _content(path: Path) -> str:
    digest = hashlib.blake2b(digest_size=16)
    for file, entry in _files(path):
        digest.update(f"{file}\0{entry.stat().st_size}\0".encode())
        with open_plain(entry) as stream:
            while part := stream.read(_PART_BYTES):
                digest.update(part)
    return digest.hexdigest()


def _files(path: Path) -> Iterator[tuple[str, Path]]:
    """All files of a folder that are not hidden, or the file."""
    if not path.is_dir():
        yield "", path
        return
    for file in files_below(path):
        yield file.relative_to(path).as_posix(), file


@dataclass(frozen=True)
class ChainStep:
    """A link of the chain: a function that reads files of a job and writes others."""

    name: str
    run: Callable[[Job], None]
    settings: Callable[[StudyDescription], object]
    """What of the study file changes its result, beside the steps before."""
    applies: Callable[[StudyDescription, Trial], bool] = lambda study, recording: True
    after: tuple[str, ...] = ()
    """Steps whose files it reads, where they apply."""
    own: Callable[[StudyDescription, Trial], object] = lambda study, recording: None
    """What else changes its result, that is of the recording and in none of its files."""


def _calibrates(study: StudyDescription, recording: Trial) -> bool:
    if study.steps.calibrate == "people":
        # From videos, people calibrate the cameras while they are detected.
        return recording.kind == "keypoints" and not recording.calibrated_on
    return study.steps.calibrate != "given"


def _filming(study: StudyDescription) -> tuple[object, ...]:
    """What of the data settings changes what is seen in videos."""
    return study.data.fps, study.data.unit, study.data.cameras


def _reading(study: StudyDescription) -> tuple[object, ...]:
    """What of them changes how keypoints are read, see Job.reading."""
    data = study.data
    return *_filming(study), data.skeleton, data.points3d_frame, data.points3d_unit, data.min_confidence


STEPS = (
    ChainStep(
        "detect",
        detect,
        lambda s: (
            s.detect,
            s.parameters.monocular,
            s.steps.calibrate,
            s.steps.synchronise,
            s.from_people,
            _filming(s),
        ),
        lambda _, recording: recording.kind == "videos",
    ),
    ChainStep(
        "synchronise", find_starts, lambda s: (s.steps.synchronise, _reading(s)), synchronises, after=("detect",)
    ),
    ChainStep(
        "calibrate",
        recalibrate,
        lambda s: (s.steps.calibrate, s.steps.people, s.from_people, _reading(s), astuple(s.parameters)),
        _calibrates,
        after=("detect", "synchronise"),
    ),
    ChainStep(
        "estimate",
        estimate,
        lambda s: (s.steps.people, _reading(s), astuple(s.parameters)),
        after=("detect", "synchronise", "calibrate"),
    ),
    ChainStep(
        "angles",
        measure_angles,
        lambda s: s.steps.world_up,
        lambda study, recording: study.steps.angles,
        after=("estimate",),
    ),
    ChainStep(
        "export",
        export,
        lambda s: (s.steps.formats, s.steps.world_up),
        lambda study, recording: bool(study.steps.formats),
        after=("estimate",),
    ),
    ChainStep("judge", judge, lambda s: s.steps.world_up, after=("estimate", "calibrate")),
    ChainStep(
        "report",
        report,
        lambda s: s.steps.world_up,
        lambda study, recording: study.steps.report,
        after=("estimate", "calibrate"),
        own=own_events,
    ),
)


def steps_of(study: StudyDescription, recording: Trial) -> tuple[ChainStep, ...]:
    """Those that apply to a recording, in their order."""
    return tuple(step for step in STEPS if step.applies(study, recording))


def fingerprints(study: StudyDescription, recording: Trial, contents: Mapping[str, str]) -> dict[str, str]:
    """Of each step that applies: a digest of all that its result is made from, the same on every machine.

    Args:
        study: the settings.
        recording: what the recording is.
        contents: digests of its input files (contents_of).
    """
    found: dict[str, str] = {}
    for step in steps_of(study, recording):
        before = [found[name] for name in step.after if name in found]
        own = step.own(study, recording)
        made_from = (version("fgpose"), step.name, step.settings(study), before, sorted(contents.items()))
        made_from += (own,) if own else ()
        found[step.name] = hashlib.blake2b(repr(made_from).encode(), digest_size=16).hexdigest()
    return found
