"""Keypoints of detectors elsewhere, received over ZeroMQ; what is wrong is counted, never raised."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

from fgpose.geometry.camera import CameraRig
from fgpose.live.assurance import FUTURE_S
from fgpose.live.keypoint_messages import decode_keypoints
from fgpose.live.rejections import MessageError, Rejected, Rejections
from fgpose.live.senders import Senders
from fgpose.live.zmq_sockets import bound_socket, connected_socket, load_zmq
from fgpose.people import Detections
from fgpose.skeleton import Skeleton

# What ZeroMQ takes from the network at all. A larger body is not read: ZeroMQ ends the connection at its head.
_MAX_NETWORK_BYTES = 16 << 20
# Each camera's message comes within a frame of the loop that reads them; more are a detector that has gone wild.
_MAX_WAITING = 256
# The stamps of a camera must advance as the clock does, but for the jitter of network and detector.
_MAX_JUMP_S = 1.0


@dataclass(frozen=True, eq=False)
class ArrivedDetections:
    """The detections of an image, at the time that its sender says, and when they arrived (Unix time)."""

    detections: Detections
    arrived_s: float


class KeypointSocket:
    """Receives keypoints. It reads from one thread.

    Args:
        rig: the cameras that may send, and their image sizes.
        skeleton: of the joints.
        port: where detectors connect with a PUSH socket; 0 takes any free one.
        host: address to bind to; only this computer reaches the default.
        keys: of cameras whose messages must have one.
        synchronised: cameras whose clock is that of this computer; what is ahead of it is refused.
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
        publisher: str | None = None,
        now_s: Callable[[], float] = time.time,
        tell: Callable[[str], None] | None = None,
    ) -> None:
        zmq = load_zmq()
        self._rig, self._skeleton, self._now_s = rig, skeleton, now_s
        options = {zmq.MAXMSGSIZE: _MAX_NETWORK_BYTES, zmq.RCVHWM: _MAX_WAITING}
        if publisher is None:
            self._socket, self.address = bound_socket(zmq.PULL, host, port, options)
        else:
            self._socket, self.address = connected_socket(zmq.SUB, publisher, options), publisher
        self._disconnects = self._socket.get_monitor_socket(zmq.EVENT_DISCONNECTED)
        self._keys, self._synchronised = dict(keys or {}), frozenset(synchronised)
        self.senders = Senders()
        self._stamps: dict[str, _Stamps] = {}
        self._rejections = Rejections(f"keypoints at {self.address}", tell)
        self.n_received = 0
        """Messages that were taken."""

    @property
    def rejected(self) -> tuple[Rejected, ...]:
        """What was refused, by kind."""
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
                return self._taken(parts, arrived_s)
            except MessageError as error:
                self._rejections.add(error)
            # Whatever nobody has thought of: one message must not end the reception of the others.
            except Exception as error:
                self._rejections.add(MessageError("unexpected", f"{type(error).__name__}: {error}"))
        return None

    def _taken(self, parts: list[Any], arrived_s: float) -> ArrivedDetections:
        connection, body = self.senders.body(parts, arrived_s)
        detections = decode_keypoints(body, self._rig, self._skeleton, self._keys)
        self.senders.take(detections.camera, connection, arrived_s)
        if detections.camera in self._synchronised and detections.time_s > arrived_s + FUTURE_S:
            ahead_s = detections.time_s - arrived_s
            raise MessageError("time", f"camera {detections.camera}: an image {ahead_s:.2f} s ahead of the clock")
        self._stamps.setdefault(detections.camera, _Stamps()).check(detections, arrived_s)
        self.n_received += 1
        return ArrivedDetections(detections, arrived_s)

    def _count_disconnects(self) -> None:
        """A body of more than is taken from the network shows only by the end of its connection."""
        zmq = load_zmq()
        with contextlib.suppress(zmq.ZMQError):
            while True:
                self._disconnects.recv_multipart(zmq.NOBLOCK)
                megabytes = _MAX_NETWORK_BYTES >> 20
                reason = f"a connection ended: a detector stopped, or sent a message of more than {megabytes} MB"
                self._rejections.add(MessageError("connection", reason))

    def close(self) -> None:
        """Closing again does nothing."""
        if not self._socket.closed:
            # First: an event that nobody can receive any more would block all of ZeroMQ in this process.
            self._socket.disable_monitor()
            self._disconnects.close(linger=0)
        self._socket.close(linger=0)

    def __enter__(self) -> KeypointSocket:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class _Stamps:
    """Whether the stamps of a camera advance as the clock does.

    A stamp that jumps is refused, unless the next agrees with it: then it was the clock of the camera that was set.
    """

    def __init__(self) -> None:
        self._taken: tuple[float, float] | None = None
        self._refused: tuple[float, float] | None = None

    def check(self, detections: Detections, arrived_s: float) -> None:
        new = detections.time_s, arrived_s
        if self._taken is None or _follows(self._taken, new) or (self._refused and _follows(self._refused, new)):
            self._taken, self._refused = new, None
            return
        self._refused = new
        advance_s, elapsed_s = new[0] - self._taken[0], new[1] - self._taken[1]
        raise MessageError(
            "time",
            f"camera {detections.camera}: the stamp of an image is {advance_s:.3f} s after the one before, which came "
            f"{elapsed_s:.3f} s ago",
        )


def _follows(before: tuple[float, float], after: tuple[float, float]) -> bool:
    advance_s, elapsed_s = after[0] - before[0], after[1] - before[1]
    return advance_s > 0 and abs(advance_s - elapsed_s) <= _MAX_JUMP_S
