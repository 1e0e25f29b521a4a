"""Whose messages are those of a camera, or of a link of a robot: one sender's, who is known by the connection."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from fgpose.live.reception.rejections import MessageError
from fgpose.live.reception.zmq_sockets import load_zmq

# A detector that connects again is taken for the same when the old connection has been silent for so long.
_SILENT_S = 1.0
# Who is no camera's sender and is refused so often within a second is not heard for the rest of it: the messages are
# not even read. A sender of several cameras, one of which another one sends too, is.
_PATIENCE, _MUTED_S = 20, 1.0

Connection = int | None
"""What ZeroMQ says of where a message came from; None: nothing."""


def connection_of(frame: Any) -> Connection:
    """From which a message came, of its first part."""
    zmq = load_zmq()
    try:
        return int(frame.get(zmq.SRCFD))
    # Not of every transport.
    except (zmq.ZMQError, AttributeError):
        return None


class Senders:
    """The first connection that sends something right under a name is its sender, until it falls silent.

    Another one under the same name is refused. Which of both is right nobody can tell, so both are a fault; a detector
    that has a key (of the rig file) cannot be contested by one that does not know it.

    Args:
        kind: of what has the names.
        on_contested: told the name under which a second one sends.
    """

    def __init__(self, kind: str = "camera", on_contested: Callable[[str], None] = lambda name: None) -> None:
        self._kind = kind
        self.on_contested = on_contested
        self._sender: dict[str, tuple[Connection, float]] = {}
        self._refused: dict[Connection, tuple[int, float]] = {}
        """How often, and since when."""

    def body(self, parts: Sequence[Any], now_s: float) -> tuple[Connection, memoryview]:
        """Of a message that has come, and from where.

        Raises:
            MessageError: it has several parts, or nothing is heard from there at the moment.
        """
        connection = connection_of(parts[0])
        self.check_heard(connection, now_s)
        if len(parts) != 1:
            raise MessageError("content", f"a message of {len(parts)} parts; it should have one")
        return connection, parts[0].buffer

    def check_heard(self, connection: Connection, now_s: float) -> None:
        """Before a message is read.

        Raises:
            MessageError: nothing is heard from there at the moment.
        """
        n_refused, since_s = self._refused.get(connection, (0, now_s))
        if now_s - since_s > _MUTED_S:
            self._refused.pop(connection, None)
        elif n_refused >= _PATIENCE and connection is not None and not self.is_sender(connection, now_s):
            raise MessageError("sender", "too many messages of a sender that was refused")

    def take(self, name: str, connection: Connection, now_s: float) -> None:
        """A message that is right.

        Raises:
            MessageError: another one sends under this name.
        """
        sender, last_s = self._sender.get(name, (connection, now_s))
        if sender != connection and now_s - last_s <= _SILENT_S:
            n_refused, since_s = self._refused.get(connection, (0, now_s))
            self._refused[connection] = n_refused + 1, since_s
            self.on_contested(name)
            raise MessageError("sender", f"{self._kind} {name}: a second sender; both are doubtful")
        self._sender[name] = connection, now_s

    def is_sender(self, connection: Connection, now_s: float) -> bool:
        """Whether anything counts that comes from there."""
        return any(own == connection and now_s - last_s <= _SILENT_S for own, last_s in self._sender.values())
