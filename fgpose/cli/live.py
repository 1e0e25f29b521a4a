"""Letting viewers connect while a command runs."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from fgpose.cli.options import new_console
from fgpose.pipeline import AnySource, OutputError, Outputs
from fgpose.viewer import Recording


@contextmanager
def live_viewer(
    outputs: Outputs, source: AnySource, trajectories: tuple[str, ...], *, grows: bool = False
) -> Iterator[Recording | None]:
    """A recording that viewers can connect to at once, also written to the .rrd file if wanted; None without --live.

    Args:
        outputs: where the results go.
        source: the recording.
        trajectories: names of the results that will be shown, if it is of one person.
        grows: it is shown frame by frame, so that after Ctrl-C the file has the frames so far.

    Raises:
        ImportError: Rerun is not installed.
        OSError: the port is taken, or the file cannot be written.
    """
    if outputs.live_port is None:
        yield None
        return
    with outputs.open_viewer(source, trajectories) as recording:
        say_how_to_connect(recording.viewer_url or "")
        try:
            yield recording
        except KeyboardInterrupt:
            if not grows:
                recording.discard()
            raise
        except OutputError:
            # Another file could not be written.
            recording.close()
            raise


def say_how_to_connect(viewer_url: str) -> None:
    """To a viewer's URL, also from another computer."""
    port = viewer_url.rpartition(":")[2].partition("/")[0]
    new_console(stderr=True).print(
        f"Viewers of this computer connect with: rerun {viewer_url}\n"
        f"From another one, first: ssh -L {port}:localhost:{port} THIS_COMPUTER",
        soft_wrap=True,
    )


def wait_for_viewers(outputs: Outputs) -> None:
    """Serve until Ctrl-C. That is how a live session ends, so it is not an error."""
    written = f" (then {outputs.rrd} is complete)" if "rrd" in outputs.formats else ""
    new_console(stderr=True).print(f"Done; still serving viewers. Ctrl-C ends{written}.", soft_wrap=True)
    try:
        _sleep_forever()
    except KeyboardInterrupt:
        return


def _sleep_forever() -> None:
    while True:
        time.sleep(3600)
