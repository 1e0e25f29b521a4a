"""The chain of steps, and which of them are due: a step whose inputs have not changed is not done again."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import version

from fgpose.study.calibrating import recalibrate
from fgpose.study.detecting import detect
from fgpose.study.estimating import estimate, export, judge, measure_angles, report
from fgpose.study.events import own_events
from fgpose.study.job import Job
from fgpose.study.recording import Recording
from fgpose.study.study import Study
from fgpose.study.synchronising import find_starts, synchronises


@dataclass(frozen=True)
class Step:
    """A link of the chain: a function that reads files of a job and writes others."""

    name: str
    run: Callable[[Job], None]
    settings: Callable[[Study], object]
    """What of the study file changes its result, beside the steps before."""
    applies: Callable[[Study, Recording], bool] = lambda study, recording: True
    after: tuple[str, ...] = ()
    """Steps whose files it reads, where they apply."""
    own: Callable[[Study, Recording], object] = lambda study, recording: None
    """What else changes its result, that is of the recording and in none of its files."""


def _detects(study: Study, recording: Recording) -> bool:
    return recording.kind == "videos"


def _calibrates(study: Study, recording: Recording) -> bool:
    if study.steps.calibrate == "people":
        # From videos, people calibrate the cameras while they are detected.
        return recording.kind == "keypoints" and not recording.calibrated_on
    return study.steps.calibrate != "given"


def _reading(study: Study) -> tuple[object, ...]:
    data = study.data
    return data.skeleton, data.fps, data.unit, data.points3d_frame, data.points3d_unit, data.cameras


STEPS = (
    Step(
        "detect",
        detect,
        lambda s: (s.detect, s.steps.calibrate, s.steps.synchronise, s.from_people, _reading(s)),
        _detects,
    ),
    Step("synchronise", find_starts, lambda s: (s.steps.synchronise, _reading(s)), synchronises, after=("detect",)),
    Step(
        "calibrate",
        recalibrate,
        lambda s: (s.steps.calibrate, s.steps.people, s.from_people, _reading(s), s.parameters),
        _calibrates,
        after=("detect", "synchronise"),
    ),
    Step(
        "estimate",
        estimate,
        lambda s: (s.steps.people, _reading(s), s.parameters),
        after=("detect", "synchronise", "calibrate"),
    ),
    Step(
        "angles",
        measure_angles,
        lambda s: s.steps.world_up,
        lambda study, recording: study.steps.angles,
        after=("estimate",),
    ),
    Step(
        "export",
        export,
        lambda s: (s.steps.formats, s.steps.world_up),
        lambda study, recording: bool(study.steps.formats),
        after=("estimate",),
    ),
    Step("judge", judge, lambda s: s.steps.world_up, after=("estimate", "calibrate")),
    Step(
        "report",
        report,
        lambda s: s.steps.world_up,
        lambda study, recording: study.steps.report,
        after=("estimate", "calibrate"),
        own=own_events,
    ),
)


def steps_of(study: Study, recording: Recording) -> tuple[Step, ...]:
    """Those that apply to a recording, in their order."""
    return tuple(step for step in STEPS if step.applies(study, recording))


def fingerprints(study: Study, recording: Recording, contents: Mapping[str, str]) -> dict[str, str]:
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
