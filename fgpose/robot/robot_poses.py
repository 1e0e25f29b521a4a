"""Where a robot says its links are: of its own messages only, and only the newest counts."""

from __future__ import annotations

import threading
from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from fgpose.live.clock import FUTURE_S
from fgpose.live.link_distance import LinkDistance
from fgpose.live.reception.rejections import MessageError
from fgpose.live.reception.senders import Senders
from fgpose.robot.distance_messages import decode_robot
from fgpose.robot.distances import DistanceMonitor

MAX_LOOKED_AT = 20
"""Of the messages that came together: the newest. More is a client gone wild."""
# Where two senders say where a link is, it has no pose for so long.
_CONTESTED_S = 1.0


class RobotPoses:
    """Remembers the newest pose of each link. One thread gives the messages, another one takes the poses.

    Faults are reset only by the sender whose poses count; in a cell without links by anybody.

    Args:
        link_names: those of the cell that have poses.
    """

    def __init__(self, link_names: Collection[str]) -> None:
        self._link_names = tuple(link_names)
        self._lock = threading.Lock()
        self._pose_of: dict[str, tuple[np.ndarray, float]] = {}
        """And of when it is."""
        self._is_reset = False
        self._now_s = 0.0
        self._senders, self._contested_s = Senders("link", self._contest), dict[str, float]()
        """Links of which two senders say where they are, and when they did last."""

    def take(self, parts: Sequence[Any], came_s: float) -> None:
        """A message, as it has come.

        Args:
            parts: frames of ZeroMQ.
            came_s: Unix time, not after it has come.

        Raises:
            MessageError: it is refused.
        """
        self._now_s = came_s
        connection, body = self._senders.body(parts, came_s)
        message = decode_robot(body, self._link_names)
        if message.time_s is not None and message.time_s > came_s + FUTURE_S:
            raise MessageError("time", f"poses {message.time_s - came_s:.2f} s ahead of this computer's clock")
        at_s = came_s if message.time_s is None else min(message.time_s, came_s)
        for name in message.world_T_link:
            self._senders.take(name, connection, came_s)
        if message.reset and self._link_names and not self._senders.is_sender(connection, came_s):
            raise MessageError("sender", "a reset of a sender whose poses do not count")
        with self._lock:
            self._pose_of |= {name: (pose, at_s) for name, pose in message.world_T_link.items()}
            self._is_reset |= message.reset

    def now(self, now_s: float) -> tuple[dict[str, np.ndarray], dict[str, float], bool]:
        """World poses (4, 4) of the links, of when they are (Unix time), and whether a reset was asked for since the
        last time."""
        with self._lock:
            pose_of, is_reset, self._is_reset = dict(self._pose_of), self._is_reset, False
        contested = {name for name, at_s in self._contested_s.items() if now_s - at_s <= _CONTESTED_S}
        poses = {name: pose for name, (pose, _) in pose_of.items() if name not in contested}
        return poses, {name: at_s for name, (_, at_s) in pose_of.items()}, is_reset

    def _contest(self, name: str) -> None:
        self._contested_s = self._contested_s | {name: self._now_s}


def measured(monitor: DistanceMonitor, robot: RobotPoses, now_s: float) -> tuple[LinkDistance, ...]:
    """Distances at a time, with the reset that the robot has asked for."""
    poses, poses_s, is_reset = robot.now(now_s)
    # With the poses of the same message: what was measured before them must not be latched after it.
    if is_reset:
        monitor.reset()
    return monitor.measure(poses, now_s, poses_s)
