"""ZeroMQ sockets that are bound or connected, with errors that name the port."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import zmq


def bound_socket(kind: int, host: str, port: int, options: Mapping[Any, int | bytes]) -> tuple[zmq.Socket[bytes], str]:
    """A socket that others connect to, and its address.

    Args:
        kind: of socket.
        host: address of this computer.
        port: 0 takes any free one.
        options: of the socket.

    Raises:
        OSError: the port is taken, or the address is not of this computer; the message names both.
        ImportError: pyzmq is not installed.
    """
    zmq = load_zmq()
    socket = _socket(kind, options)
    try:
        socket.bind(f"tcp://{host}:{port or '*'}")
    except zmq.ZMQError as error:
        socket.close(linger=0)
        if error.errno == zmq.EADDRINUSE:
            raise OSError(error.errno, f"port {port} of {host} is taken by another program") from None
        raise OSError(error.errno, f"port {port} of {host} cannot be used: {error.strerror}") from None
    return socket, socket.getsockopt_string(zmq.LAST_ENDPOINT)


def connected_socket(kind: int, address: str, options: Mapping[Any, int | bytes]) -> zmq.Socket[bytes]:
    """A socket that connects to others, whenever they are there; a SUB socket takes everything.

    Raises:
        ValueError: the address is wrong.
        ImportError: pyzmq is not installed.
    """
    zmq = load_zmq()
    socket = _socket(kind, options)
    try:
        if kind == zmq.SUB:
            socket.subscribe(b"")
        socket.connect(address)
    except zmq.ZMQError as error:
        socket.close(linger=0)
        raise ValueError(f"{address!r} is no address like tcp://192.168.1.2:5557: {error.strerror}") from None
    return socket


def _socket(kind: int, options: Mapping[Any, int | bytes]) -> zmq.Socket[bytes]:
    zmq = load_zmq()
    socket = zmq.Context.instance().socket(kind)
    for option, value in options.items():
        socket.setsockopt(option, value)
    return socket


def load_zmq() -> Any:
    """The module zmq. Raises ImportError, which says what to install, if it is absent."""
    try:
        import zmq
    except ImportError:
        raise ImportError("messages over ZeroMQ need pyzmq: pip install 'fgpose[live]'") from None
    return zmq
