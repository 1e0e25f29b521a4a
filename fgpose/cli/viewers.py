"""Letting people see a result or a live system: viewers that connect, windows, browsers, and who else could."""

from __future__ import annotations

import ipaddress
import os
import shutil
import socket
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from fgpose.cli.console import new_console
from fgpose.pipeline import AnySource, OutputError, Outputs
from fgpose.viewer import Recording, has_rerun
from fgpose.viewer.opening import leave_out_analytics, quieten_rerun

if TYPE_CHECKING:
    from fgpose.geometry.camera import CameraRig
    from fgpose.live.outputs import ViewerOutput
    from fgpose.live.processes.parts import Parts
    from fgpose.skeleton import Skeleton


# Of Rerun, unless somebody else has them.
_PAGE_PORT, _DATA_PORT = 9090, 9876
_LOOKS_EVERY_S = 0.1
_EVERY_ADDRESS = ("*", "0.0.0.0", "::")
# Beyond it the viewer forgets what is oldest.
_VIEWER_MEMORY = "1GB"


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


def warn_if_others_reach(host: str, option: str, what: str) -> None:
    """Say on stderr that other computers reach what is served at this address, and at which of the computer's.

    Args:
        host: the address that is bound.
        option: that gave it.
        what: is reached there, as "the recording, with its pictures".
    """
    if host == "localhost" or _is_loopback(host):
        return
    addresses = ", ".join(_addresses()) if host in _EVERY_ADDRESS else host
    new_console(stderr=True).print(
        f"warning: {option} {host}: every computer in the network reaches {what}, at {addresses}; there is no password",
        soft_wrap=True,
    )


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _addresses() -> list[str]:
    """Of this computer, that others may know it by."""
    name = socket.gethostname()
    try:
        known = {str(each[4][0]) for each in socket.getaddrinfo(name, None)}
    except OSError:
        known = set()
    return [name, *sorted(address for address in known if not _is_loopback(address.partition("%")[0]))]


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


def can_write_rrd() -> bool:
    """Whether Rerun is installed. Warns, with UserWarning, if it is not: there will be no file for the viewer."""
    if not has_rerun():
        lacking = "no .rrd file for the viewer is written: it needs Rerun, pip install 'fgpose[viewer]'"
        warnings.warn(lacking, stacklevel=2)
    return has_rerun()


def rerun_program() -> str:
    """The viewer's program: that beside this Python, else the one on the path."""
    beside = shutil.which("rerun", path=str(Path(sys.executable).parent))
    program = beside or shutil.which("rerun")
    if program is None:
        raise ImportError("the viewer needs Rerun: pip install 'fgpose[viewer]'")
    leave_out_analytics()
    quieten_rerun()
    return program


def has_display() -> bool:
    return sys.platform != "linux" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


@dataclass(frozen=True)
class WebAddress:
    """A page, and the recording that it asks for, at an address of this computer."""

    host: str
    """The address that is bound; 0.0.0.0 stands for all."""
    page_port: int
    data_port: int

    @staticmethod
    def free(host: str) -> WebAddress:
        """Rerun's usual ports, or others if these are taken. Raises OSError if the address is none of this computer."""
        return WebAddress(host, _free_port(host, _PAGE_PORT), _free_port(host, _DATA_PORT))

    def url(self, host: str) -> str:
        """What a browser opens that knows this computer by a name or an address."""
        host = f"[{host}]" if ":" in host else host
        data = quote(f"rerun+http://{host}:{self.data_port}/proxy", safe="")
        return f"http://{host}:{self.page_port}/?url={data}"

    @contextmanager
    def said_when_reached(self) -> Iterator[None]:
        """Prints the address once something answers there: who clicks on it sooner sees an error."""
        ended = threading.Event()
        waiting = threading.Thread(target=self._say_when_reached, args=(ended,), daemon=True)
        waiting.start()
        try:
            yield
        finally:
            ended.set()
            waiting.join()

    def _say_when_reached(self, ended: threading.Event) -> None:
        while not self._is_reached():
            if ended.wait(_LOOKS_EVERY_S):
                return
        console = new_console()
        console.print(f"open {self.url(self._local)} in a browser; Ctrl-C ends", soft_wrap=True)
        if _is_loopback(self.host):
            ports = " ".join(f"-L {port}:localhost:{port}" for port in (self.page_port, self.data_port))
            console.print(f"From another computer, first: ssh {ports} THIS_COMPUTER", soft_wrap=True)
        else:
            others = _addresses() if self.host != self._local else [self.host]
            console.print(f"From another computer: {self.url(others[0])}", soft_wrap=True)

    @property
    def _local(self) -> str:
        return {"0.0.0.0": "127.0.0.1", "*": "127.0.0.1", "::": "::1"}.get(self.host, self.host)

    def _is_reached(self) -> bool:
        try:
            for port in (self.page_port, self.data_port):
                socket.create_connection((self._local, port), timeout=1.0).close()
        except OSError:
            return False
        return True


def _free_port(host: str, wanted: int) -> int:
    """The wanted port, or any other. Somebody else may take it before it is used, which Rerun then says."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for port in (wanted, 0):
        with closing(socket.socket(family)) as probe:
            try:
                probe.bind((host, port))
            except OSError:
                if port == 0:
                    raise OSError(f"--host {host}: that is no address of this computer") from None
                continue
            return int(probe.getsockname()[1])
    raise AssertionError
