"""Frames over ZeroMQ: a PUB socket, to which any number of consumers connect and leave."""

from __future__ import annotations

from collections.abc import Callable

from fgpose.live.frame import LiveFrame
from fgpose.live.outputs.frame_messages import encode_frame
from fgpose.live.outputs.output import BackgroundOutput
from fgpose.live.processes.parts import Parts
from fgpose.live.reception.zmq_sockets import bound_socket, load_zmq

# Consumers send nothing but their subscription.
_MAX_SUBSCRIPTION_BYTES = 1024


class ZmqSink:
    """Sends each frame to all who are connected. Of a consumer who is slow only the newest frame waits.

    Raises:
        OSError: the port is taken; the message names it.
        ImportError: pyzmq is not installed.
    """

    def __init__(self, host: str, port: int) -> None:
        zmq = load_zmq()
        options = {zmq.CONFLATE: 1, zmq.MAXMSGSIZE: _MAX_SUBSCRIPTION_BYTES, zmq.LINGER: 0}
        self._no_wait = zmq.NOBLOCK
        self._socket, self.address = bound_socket(zmq.PUB, host, port, options)

    def send(self, frame: LiveFrame) -> None:
        self._socket.send(encode_frame(frame), self._no_wait)

    def close(self) -> None:
        self._socket.close()


def open_zmq_output(
    port: int = 5556,
    *,
    host: str = "127.0.0.1",
    tell: Callable[[str], None] | None = None,
    parts: Parts | None = None,
) -> BackgroundOutput:
    """Frames for SUB sockets, as docs/live_messages.md describes them.

    Args:
        port: where consumers connect.
        host: address to bind to; only this computer reaches the default, "*" or "0.0.0.0" any computer.
        tell, parts: see BackgroundOutput.

    Raises:
        OSError: the port is taken; the message names it.
        ImportError: pyzmq is not installed.
    """
    return BackgroundOutput(f"ZeroMQ at {host}:{port}", lambda: ZmqSink(host, port), tell=tell, parts=parts)
