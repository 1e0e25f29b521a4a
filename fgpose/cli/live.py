"""Letting viewers connect while a command runs."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from fgpose.cli.options import new_console
from fgpose.pipeline import Outputs, Source, up_axis
from fgpose.viewer import Recording, open_recording


@contextmanager
def live_recording(
    source: Source, trajectories: tuple[str, ...], outputs: Outputs, port: int, image_width_px: int | None = None
) -> Iterator[Recording]:
    """A recording that viewers can connect to, and the .rrd file if it is among the formats. Says how to connect.

    Raises:
        ImportError: Rerun is not installed.
        OSError: the port is taken, or the file cannot be written.
    """
    path = outputs.path("rrd") if "rrd" in outputs.formats else None
    up = up_axis(outputs.world_up)
    skeleton, n_frames = source.observations.skeleton, source.observations.n_frames
    with open_recording(
        path,
        source.rig,
        skeleton,
        trajectories,
        live=True,
        port=port,
        up=up,
        image_width_px=image_width_px,
        n_frames=n_frames,
    ) as recording:
        new_console(stderr=True).print(
            f"Viewers of this computer connect with: rerun {recording.viewer_url}\n"
            f"From another one, first: ssh -L {_port(recording)}:localhost:{_port(recording)} THIS_COMPUTER",
            soft_wrap=True,
        )
        yield recording


def _port(recording: Recording) -> str:
    return (recording.viewer_url or "").rpartition(":")[2].partition("/")[0]


def wait_for_viewers(outputs: Outputs) -> None:
    """Serve until Ctrl-C, which is how a live session ends: it is no error then."""
    written = f" (then {outputs.path('rrd')} is complete)" if "rrd" in outputs.formats else ""
    new_console(stderr=True).print(f"Done; still serving viewers. Ctrl-C ends{written}.", soft_wrap=True)
    try:
        _sleep_forever()
    except KeyboardInterrupt:
        return


def _sleep_forever() -> None:
    while True:
        time.sleep(3600)
