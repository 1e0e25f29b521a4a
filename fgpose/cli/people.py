"""Several people on the command line."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from fgpose.association.recording import Association, associate
from fgpose.cli.delivery import deliver_people
from fgpose.cli.live import live_viewer
from fgpose.cli.options import progress_bar
from fgpose.config import Config
from fgpose.pipeline import Outputs, PeopleResult, PeopleSource, Progress, show_people
from fgpose.viewer import PeopleRecording

Display = Callable[[PeopleResult, PeopleRecording], None]


def estimate_people(
    source: PeopleSource,
    config: Config,
    outputs: Outputs,
    run: Callable[[PeopleSource, Config, Progress], PeopleResult],
    task: str,
    display: Display = show_people,
) -> None:
    """Run the smoother or the tracker over a recording with a progress bar, and deliver the result.

    Raises:
        ValueError: nobody is found.
        OutputError: a file could not be written; the others were.
    """
    people = source.people
    opened = partial(outputs.open_people_viewer, source.rig, people.skeleton, len(people.frames.image))
    with live_viewer(outputs, opened) as viewer:
        with progress_bar(task) as progress:
            result = run(source, config, progress)
        if not result.main:
            raise ValueError("no two cameras agree on anybody; look at the input with fgpose info")
        deliver_people(result, outputs, viewer, display)


def associated(source: PeopleSource) -> Association:
    """Who is who in a recording, with a progress bar."""
    with progress_bar("telling people apart") as progress:
        return associate(source.people, source.rig, progress=progress)
