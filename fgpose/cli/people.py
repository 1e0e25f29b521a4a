"""Several people on the command line."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial

from fgpose.association.recording import Association, associate
from fgpose.cli.delivery import deliver_people
from fgpose.cli.live import live_viewer
from fgpose.cli.options import progress_bar
from fgpose.config import Config
from fgpose.pipeline import Outputs, PeopleResult, PeopleSource, Progress, run_track_people, show_people
from fgpose.pipeline.diagnosed import nothing_determined
from fgpose.viewer import PeopleRecording

Display = Callable[[PeopleResult, PeopleRecording], None]


def estimate_people(
    source: PeopleSource,
    config: Config,
    outputs: Outputs,
    run: Callable[[PeopleSource, Config, Progress], PeopleResult],
    task: str,
    display: Display = show_people,
    *,
    strict: bool = False,
) -> int:
    """Run an estimator over a recording with a progress bar, and deliver the result.

    Returns:
        The exit code; see deliver.

    Raises:
        ValueError: nobody is found.
        OutputError: a file could not be written; the others were.
    """
    with _viewer(source, outputs) as viewer:
        with progress_bar(task) as progress:
            result = run(source, config, progress)
        return _deliver(result, outputs, viewer, display, strict=strict)


def track_people(source: PeopleSource, config: Config, outputs: Outputs, *, strict: bool = False) -> int:
    """The same with the tracker, of which live viewers see every update as soon as it is made. Raises as
    estimate_people."""
    with _viewer(source, outputs, grows=True) as viewer:
        on_update = None if viewer is None else viewer.log_tracked
        with progress_bar("tracking") as progress:
            result = run_track_people(source, config, progress, on_update)
        # A live viewer has seen every frame already.
        display = show_people if viewer is None else lambda result, viewer: None
        return _deliver(result, outputs, viewer, display, strict=strict)


def _viewer(
    source: PeopleSource, outputs: Outputs, *, grows: bool = False
) -> AbstractContextManager[PeopleRecording | None]:
    people = source.people
    opened = partial(outputs.open_people_viewer, source.rig, people.skeleton, len(people.frames.image))
    return live_viewer(outputs, opened, grows=grows)


def _deliver(
    result: PeopleResult, outputs: Outputs, viewer: PeopleRecording | None, display: Display, *, strict: bool
) -> int:
    if not result.main:
        raise ValueError(f"{result.association.why_nobody}: {nothing_determined(result.source)}")
    return deliver_people(result, outputs, viewer, display, strict=strict)


def associated(source: PeopleSource) -> Association:
    """Who is who in a recording, with a progress bar."""
    with progress_bar("telling people apart") as progress:
        return associate(source.people, source.rig, progress=progress)
