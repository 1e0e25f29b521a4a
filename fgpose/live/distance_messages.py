"""Poses of the links of a robot, and distances of people from them, as messages: see docs/live_distances.md."""

from __future__ import annotations

import dataclasses
import math
import reprlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fgpose.io.packing import packed, unpacked
from fgpose.live.distances import NO_SAFETY_FUNCTION, Fault, LinkDistance
from fgpose.live.rejections import MessageError

ROBOT_FORMAT, DISTANCES_FORMAT, VERSION = "fgpose/robot", "fgpose/distances", 1
MAX_ROBOT_BYTES = 64 << 10
"""Of a message of a robot: hundreds of links take less."""
_LARGEST_S = 1e11  # some thousand years
_ROBOT_KEYS = {"format", "version", "world_T_link", "time_s", "reset"}


@dataclass(frozen=True, eq=False)
class RobotMessage:
    """What a robot says."""

    world_T_link: Mapping[str, np.ndarray] = field(default_factory=dict)
    """(4, 4) poses of some of its links in the world, metres."""
    time_s: float | None = None
    """When the links were there, Unix time; None: when the message came."""
    reset: bool = False
    """Clear the latched faults."""


def encode_robot(world_T_link: Mapping[str, np.ndarray], *, time_s: float | None = None, reset: bool = False) -> bytes:
    """A message of poses, (4, 4) in metres, of links in the world, at a Unix time."""
    poses = {name: np.asarray(pose, dtype=float) for name, pose in world_T_link.items()}
    when = {} if time_s is None else {"time_s": time_s}
    return packed({"format": ROBOT_FORMAT, "version": VERSION, "world_T_link": poses, "reset": reset} | when)


def decode_robot(body: bytes | memoryview, link_names: Collection[str]) -> RobotMessage:
    """What a message says. Whether a pose is a rigid transform is for DistanceMonitor to find.

    Args:
        body: the message.
        link_names: those of the cell that have poses.

    Raises:
        MessageError: the message is refused. Nothing else is raised, whatever the bytes are.
    """
    if len(body) > MAX_ROBOT_BYTES:
        raise MessageError("size", f"a message of {len(body)} bytes, at most {MAX_ROBOT_BYTES} are possible")
    try:
        document = unpacked(body)
    except ValueError as error:
        raise MessageError("content", str(error)) from None
    if not _is_of(document, ROBOT_FORMAT):
        raise MessageError("content", f"not a message of {ROBOT_FORMAT}, version {VERSION}")
    unknown = sorted(map(str, document.keys() - _ROBOT_KEYS))
    if unknown:
        raise MessageError("content", f"unknown keys: {_short(unknown)}")
    poses, reset, time_s = document.get("world_T_link", {}), document.get("reset", False), document.get("time_s")
    if not isinstance(poses, dict) or not isinstance(reset, bool):
        raise MessageError("content", "world_T_link is a map of poses by link, reset is true or false")
    if time_s is not None and not (isinstance(time_s, int | float) and abs(time_s) < _LARGEST_S):
        raise MessageError("time", f"time_s is a Unix time, got {_short(time_s)}")
    wrong = sorted(map(str, poses.keys() - set(link_names)))
    if wrong:
        raise MessageError("link", f"links that the cell does not have: {_short(wrong)}; it has {_short(link_names)}")
    return RobotMessage({name: _pose(name, pose) for name, pose in poses.items()}, time_s, reset)


def encode_distances(
    distances: Sequence[LinkDistance], sequence: int, published_s: float, frame_s: float = math.nan
) -> bytes:
    """A message of the distances of all links.

    Args:
        distances: of the links.
        sequence: number of the message.
        published_s: Unix time.
        frame_s: when the frame was published that they come from; NaN: there was none.
    """
    return packed(
        {
            "format": DISTANCES_FORMAT,
            "version": VERSION,
            "notice": NO_SAFETY_FUNCTION,
            "sequence": sequence,
            "published_s": published_s,
            "frame_s": frame_s,
            "links": [dataclasses.asdict(distance) for distance in distances],
        }
    )


def decode_distances(body: bytes) -> tuple[LinkDistance, ...]:
    """The distances in a message.

    Raises:
        ValueError: it is no such message.
    """
    document = unpacked(body)
    if not _is_of(document, DISTANCES_FORMAT):
        raise ValueError(f"not a message of {DISTANCES_FORMAT}, version {VERSION}")
    try:
        return tuple(
            LinkDistance(**{**link, "fault": None if link["fault"] is None else Fault(**link["fault"])})
            for link in document["links"]
        )
    except (TypeError, KeyError) as error:
        raise ValueError(f"a damaged message of {DISTANCES_FORMAT}: {type(error).__name__}: {error}") from None


def _is_of(document: Any, name: str) -> bool:
    """An array is compared by element, so it is asked for text and number first."""
    if not isinstance(document, dict):
        return False
    name_of, version = document.get("format"), document.get("version")
    return isinstance(name_of, str) and isinstance(version, int) and (name_of, version) == (name, VERSION)


def _pose(name: str, value: Any) -> np.ndarray:
    """From an array, or four lists of four numbers."""
    try:
        pose = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        pose = np.zeros(0)
    if pose.shape != (4, 4):
        raise MessageError("shape", f"link {name}: a pose is (4, 4) numbers, got {_short(value)}")
    return pose


def _short(value: Any) -> str:
    return reprlib.repr(value)
