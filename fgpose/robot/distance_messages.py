"""Poses of the links of a robot, and distances of people from them, as messages: see docs/live_distances.md."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import msgspec
import numpy as np

from fgpose.io.live.packing import packed, unpacked
from fgpose.live.link_distance import DistanceFault, LinkDistance
from fgpose.live.reception.message_schema import PackedArray, Schema, quoted
from fgpose.live.reception.rejections import MessageError
from fgpose.robot.distances import NO_SAFETY_FUNCTION

ROBOT_FORMAT, DISTANCES_FORMAT, VERSION = "fgpose/robot", "fgpose/distances", 1
MAX_ROBOT_BYTES = 64 << 10
"""Of a message of a robot: hundreds of links take less."""
_LARGEST_S = 1e11  # some thousand years
_Rows = tuple[tuple[float, float, float, float], ...]


class _Robot(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A message of a robot; poses are arrays, or four rows of four numbers."""

    format: Literal["fgpose/robot"]
    version: Literal[1]
    world_T_link: dict[str, PackedArray | _Rows] = msgspec.field(default_factory=dict)
    time_s: float | None = None
    reset: bool = False


_SCHEMA = Schema(_Robot, f"{ROBOT_FORMAT}, version {VERSION}", MAX_ROBOT_BYTES)


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
    document = _SCHEMA.document(body)
    wrong = sorted(document.world_T_link.keys() - set(link_names))
    if wrong:
        raise MessageError("link", f"links that the cell does not have: {quoted(wrong)}; it has {quoted(link_names)}")
    poses = {name: _pose(name, pose) for name, pose in document.world_T_link.items()}
    if document.time_s is not None and not abs(document.time_s) < _LARGEST_S:
        raise MessageError("time", f"time_s is a Unix time, got {document.time_s:g}")
    return RobotMessage(poses, document.time_s, document.reset)


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
    if not isinstance(document, dict) or (document.get("format"), document.get("version")) != (
        DISTANCES_FORMAT,
        VERSION,
    ):
        raise ValueError(f"not a message of {DISTANCES_FORMAT}, version {VERSION}")
    try:
        return tuple(
            LinkDistance(**(link | {"fault": None if link["fault"] is None else DistanceFault(**link["fault"])}))
            for link in document["links"]
        )
    except (TypeError, KeyError) as error:
        raise ValueError(f"a damaged message of {DISTANCES_FORMAT}: {type(error).__name__}: {error}") from None


def _pose(name: str, value: PackedArray | _Rows) -> np.ndarray:
    pose = value.array() if isinstance(value, PackedArray) else np.array(value)
    if pose.shape != (4, 4):
        raise MessageError("shape", f"link {name}: a pose is (4, 4) numbers, got {pose.shape}")
    return pose
