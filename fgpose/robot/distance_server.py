"""Distances of people from the links of a robot, published at a steady rate; the robot says where its links are.

THIS IS NO SAFETY FUNCTION: see fgpose.robot.distances.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from fgpose.geometry.camera import CameraRig
from fgpose.live.frame import LiveFrame
from fgpose.live.link_distance import LinkDistance
from fgpose.live.outputs.output import OutputState
from fgpose.live.processes.parts import Parts
from fgpose.live.processes.worker import HANGS_S, Worker
from fgpose.live.reception.input_keys import InputKeys
from fgpose.live.reception.rejections import MessageError, Rejected, Rejections
from fgpose.live.reception.zmq_sockets import bound_socket, load_zmq
from fgpose.robot.cell import Cell
from fgpose.robot.distance_messages import MAX_ROBOT_BYTES, encode_distances
from fgpose.robot.distances import DistanceMonitor
from fgpose.robot.robot_poses import MAX_LOOKED_AT, RobotPoses, measured
from fgpose.skeleton import Skeleton

_LOG = logging.getLogger("fgpose.live")
# That wait in ZeroMQ.
_MAX_WAITING = 1000
# Clients cannot take more of the processor than this leaves.
_REST_S = 0.002
_POLL_MS = 100
# Of a consumer who subscribes.
_MAX_SUBSCRIPTION_BYTES = 1024
_HUNG_S = 1.0


class DistanceServer:
    """An output of the live system. A thread of its own measures and publishes, whatever comes or does not come;
    another one reads the poses.

    Args:
        cell: links, zones and limits.
        rig, skeleton: of the frames.
        port: where consumers of distances subscribe; 0 takes any free one.
        poses_port: where the robot sends poses of its links with a PUSH socket; 0 takes any free one.
        host: address for consumers to connect to; only this computer reaches the default.
        poses_host: the same for the robot.
        who: may send poses; None: anybody who reaches the port.
        rate_hz: of the messages.
        show: takes what was measured, in the thread.
        tell: called with one line for the first message of each kind that is refused, and when measuring fails.
        now_s: Unix time.
        parts: told when one of the threads has ended.

    Raises:
        ValueError: the skeleton lacks a joint that a body needs, or too little around a zone is observed.
        OSError: a port is taken; the message names it.
        ImportError: pyzmq is not installed.
    """

    def __init__(
        self,
        cell: Cell,
        rig: CameraRig,
        skeleton: Skeleton,
        *,
        port: int = 5558,
        poses_port: int = 5559,
        host: str = "127.0.0.1",
        poses_host: str = "127.0.0.1",
        who: InputKeys | None = None,
        rate_hz: float = 30.0,
        show: Callable[[Sequence[LinkDistance]], None] | None = None,
        tell: Callable[[str], None] | None = None,
        now_s: Callable[[], float] = time.time,
        parts: Parts | None = None,
    ) -> None:
        zmq = load_zmq()
        self._monitor = DistanceMonitor(cell, rig, skeleton)
        self._period_s = 1.0 / rate_hz
        self._show, self._tell, self._now_s = show, tell, now_s
        options = {zmq.CONFLATE: 1, zmq.MAXMSGSIZE: _MAX_SUBSCRIPTION_BYTES, zmq.LINGER: 0}
        self._publisher, self.address = bound_socket(zmq.PUB, host, port, options)
        try:
            options = {zmq.MAXMSGSIZE: MAX_ROBOT_BYTES, zmq.RCVHWM: _MAX_WAITING} | ({} if who is None else who.options)
            self._poses, self.poses_address = bound_socket(zmq.PULL, poses_host, poses_port, options)
        except OSError:
            self._publisher.close()
            raise
        self._rejections = Rejections(f"poses at {self.poses_address}", tell)
        self._robot = RobotPoses([link.name for link in cell.links if not link.is_fixed])
        self._n_published, self._published_s, self._error = 0, time.monotonic(), ""
        self._measuring = Worker("measuring distances", self._run, parts, hangs_after_s=HANGS_S, is_replaced=True)
        self._reading = Worker("reading the poses of the robot", self._read_poses, parts, hangs_after_s=HANGS_S)
        self._measuring.start()
        self._reading.start()

    @property
    def state(self) -> OutputState:
        """See Output."""
        is_working = not self._error and time.monotonic() - self._published_s < _HUNG_S
        said = "; ".join(filter(None, (self._error, self._rejections.in_words())))
        return OutputState(f"distances at {self.address}", is_working, self._n_published, 0, said)

    @property
    def rejected(self) -> tuple[Rejected, ...]:
        """Messages of robots that were refused, by kind."""
        return self._rejections.so_far()

    def publish(self, frame: LiveFrame) -> None:
        """The newest frame. Never blocks."""
        self._monitor.publish(frame)

    def close(self) -> None:
        """Stop measuring. Closing again does nothing."""
        self._measuring.close()
        self._reading.close()
        self._publisher.close()
        self._poses.close(linger=0)

    def _run(self) -> None:
        due_s = time.monotonic()
        while not self._measuring.stopped.wait(max(due_s - time.monotonic(), 0.0)):
            # What was missed is not made up for.
            due_s = max(due_s + self._period_s, time.monotonic())
            try:
                self._measure()
                self._error = ""
            # Consumers take silence for a fault; measuring begins again with the next frame or pose.
            except Exception as error:
                self._failed(error)

    def _measure(self) -> None:
        now_s = self._now_s()
        distances = measured(self._monitor, self._robot, now_s)
        if self._measuring.stopped.is_set():  # it was left behind meanwhile
            return
        self._publisher.send(encode_distances(distances, self._n_published, now_s, self._monitor.frame_s))
        self._n_published += 1
        self._published_s = time.monotonic()
        if self._show is not None:
            self._show(distances)

    def _read_poses(self) -> None:
        while not self._reading.stopped.is_set():
            self._take_poses()

    def _take_poses(self) -> None:
        """Of all messages that wait only the newest count: what is older says where a link was."""
        if not self._poses.poll(_POLL_MS):
            return
        came_s = self._now_s()  # before they are fetched: none is taken for newer than it is
        waiting: deque[list[Any]] = deque(maxlen=MAX_LOOKED_AT)
        for n_waiting in range(_MAX_WAITING):
            if not self._poses.poll(0):
                break
            if n_waiting >= MAX_LOOKED_AT:
                self._rejections.add(
                    MessageError("old", f"more than {MAX_LOOKED_AT} messages waited; the newest count")
                )
            waiting.append(self._poses.recv_multipart(copy=False))
        for parts in waiting:
            try:
                self._robot.take(parts, came_s)
            except MessageError as error:
                self._rejections.add(error)
        self._reading.stopped.wait(_REST_S)

    def _failed(self, error: Exception) -> None:
        said = f"distances cannot be measured: {type(error).__name__}: {error}"
        if said != self._error:
            _LOG.exception("distances cannot be measured")
            if self._tell is not None:
                self._tell(said)
        self._error = said
