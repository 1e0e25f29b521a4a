"""The Rerun viewer beside the live system."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from fgpose.cli.live import say_how_to_connect
from fgpose.cli.view import has_display, rerun_program

if TYPE_CHECKING:
    from fgpose.geometry.camera import CameraRig
    from fgpose.live.outputs import ViewerOutput
    from fgpose.live.processes.parts import Parts
    from fgpose.skeleton import Skeleton

# Beyond it the viewer forgets what is oldest.
_VIEWER_MEMORY = "1GB"


def open_viewer(
    path: Path | None,
    rig: CameraRig,
    skeleton: Skeleton,
    with_window: bool,
    tell: Callable[[str], None],
    parts: Parts | None = None,
) -> ViewerOutput:
    """Show a live system in a file, in a window, or in both. Where there is no display it says how to connect.

    The window is a program of its own, which stays when the live system ends.

    Raises:
        ImportError: Rerun is not installed.
        OSError: the file cannot be written, or the viewer cannot be started.
    """
    from fgpose.live.outputs import ViewerOutput

    program = rerun_program() if with_window else ""
    output = ViewerOutput(path, rig, skeleton, live=with_window, tell=tell, parts=parts)
    if output.viewer_url is not None:
        if has_display():
            local = ["--memory-limit", _VIEWER_MEMORY, "--bind", "127.0.0.1"]
            _start([program, "--connect", output.viewer_url, *local])
        say_how_to_connect(output.viewer_url)
    return output


def _start(command: list[str]) -> None:
    # In a session of its own: Ctrl-C is for the live system.
    subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
