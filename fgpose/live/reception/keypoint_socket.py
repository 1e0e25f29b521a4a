"""Keypoints of detectors elsewhere, received over ZeroMQ; what is wrong is counted, never raised."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Collection, Mapping

from fgpose.geometry.camera import CameraRig
from fgpose.live.processes.closing import Closing
from fgpose.live.reception.input_keys import InputKeys
from fgpose.live.reception.keypoint_checks import ArrivedDetections, KeypointChecks
from fgpose.live.reception.rejections import MessageError, Rejected, Rejections
from fgpose.live.reception.senders import Senders
from fgpose.live.reception.zmq_sockets import bound_socket, connected_socket, load_zmq
from fgpose.skeleton import Skeleton

# What ZeroMQ takes from the network at all. A larger body is not read: ZeroMQ ends the connection at its head.
_MAX_NETWORK_BYTES = 16 << 20
# Each camera's message comes within a frame of the loop that reads them; more are a detector that has gone wild.
_MAX_WAITING = 256


class KeypointSocket(Closing):
    """Receives keypoints. It reads from one thread.

    Args:
        rig: the cameras that may send, and their image sizes.
        skeleton: of the joints.
        port: where detectors connect with a PUSH socket; 0 takes any free one.
        host: address to bind to; only this computer reaches the default.
        keys: of cameras whose messages must have one.
        synchronised: cameras whose clock is that of this computer; what is ahead of it is refused.
        who: may connect; None: anybody who reaches the port.
        publisher: in place of port and host: the address of a PUB socket, to which this side connects.
        now_s: Unix time.
        tell: called with one line for the first message of each kind that is refused.

    Raises:
        OSError: the port is taken; the message names it.
        ValueError: the address of the publisher is wrong.
        ImportError: pyzmq is not installed.
    """

    def __init__(
        self,
        rig: CameraRig,
        skeleton: Skeleton,
        *,
        port: int = 5557,
        host: str = "127.0.0.1",
        keys: Mapping[str, str] | None = None,
        synchronised: Collection[str] = (),
        who: InputKeys | None = None,
        publisher: str | None = None,
        now_s: Callable[[], float] = time.time,
        tell: Callable[[str], None] | None = None,
    ) -> None:
        zmq = load_zmq()
        self._now_s = now_s
        options = {zmq.MAXMSGSIZE: _MAX_NETWORK_BYTES, zmq.RCVHWM: _MAX_WAITING}
        if publisher is None:
            secured = options | ({} if who is None else who.options)
            self._socket, self.address = bound_socket(zmq.PULL, host, port, secured)
        else:
            self._socket, self.address = connected_socket(zmq.SUB, publisher, options), publisher
        self._events = self._socket.get_monitor_socket(zmq.EVENT_DISCONNECTED | _refused_events())
        self._checks = KeypointChecks(rig, skeleton, keys, synchronised)
        self._rejections = Rejections(f"keypoints at {self.address}", tell)
        self.n_received = 0
        """Messages that were taken."""
        self.on_refused: Callable[[MessageError], None] = lambda error: None
        """Told of every message that is refused, in the thread that reads."""

    @property
    def senders(self) -> Senders:
        """Whose messages are those of each camera."""
        return self._checks.senders

    @property
    def rejected(self) -> tuple[Rejected, ...]:
        """What was refused, by kind and camera."""
        return self._rejections.so_far()

    @property
    def rejected_in_words(self) -> str:
        """What was refused, in one line; empty: nothing."""
        return self._rejections.in_words()

    def receive(self, timeout_s: float) -> ArrivedDetections | None:
        """The next message that is right; None if none comes in time. Never raises because of what is sent."""
        end_s = time.monotonic() + timeout_s
        self._count_disconnects()
        while (left_s := end_s - time.monotonic()) >= 0 and self._socket.poll(round(1000 * left_s)):
            parts = self._socket.recv_multipart(copy=False)
            arrived_s = self._now_s()
            try:
                arrived = self._checks.taken(parts, arrived_s)
                self.n_received += 1
                return arrived
            except MessageError as error:
                self._refuse(error)
            # Whatever nobody has thought of: one message must not end the reception of the others.
            except Exception as error:
                self._refuse(MessageError("unexpected", f"{type(error).__name__}: {error}"))
        return None

    def _refuse(self, error: MessageError) -> None:
        self._rejections.add(error)
        self.on_refused(error)

    def _count_disconnects(self) -> None:
        """A body of more than is taken from the network shows only by the end of its connection."""
        zmq = load_zmq()
        with contextlib.suppress(zmq.ZMQError):
            while True:
                event, _ = self._events.recv_multipart(zmq.NOBLOCK)
                if int.from_bytes(event[:2], sys.byteorder) == zmq.EVENT_DISCONNECTED:
                    megabytes = _MAX_NETWORK_BYTES >> 20
                    reason = f"a connection ended: a detector stopped, or sent a message of more than {megabytes} MB"
                    self._rejections.add(MessageError("connection", reason))
                else:
                    self._rejections.add(MessageError("key", "somebody without a known key wanted to connect"))

    def close(self) -> None:
        """Closing again does nothing."""
        if not self._socket.closed:
            # First: an event that nobody can receive any more would block all of ZeroMQ in this process.
            self._socket.disable_monitor()
            self._events.close(linger=0)
        self._socket.close(linger=0)


def _refused_events() -> int:
    """Of those who have no key that is known."""
    zmq = load_zmq()
    return int(zmq.EVENT_HANDSHAKE_FAILED_AUTH | zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL)
