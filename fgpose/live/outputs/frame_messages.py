"""A LiveFrame as a message: the format that docs/live_messages.md describes."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from fgpose.io.live.packing import packed, unpacked
from fgpose.live.frame import CameraStatus, LiveFrame, LiveJudgement, LivePerson, Restarts
from fgpose.live.reception.message_schema import as_dataclass
from fgpose.skeleton import Skeleton

FORMAT, VERSION = "fgpose/people", 1
_SCALARS = ("sequence", "time_s", "published_s", "observed_share", "tracking_since_s")
_ARRAYS = ("positions_m", "covariance_m2", "probability")


@dataclass(frozen=True, eq=False)
class _Frame:
    """What is compared with a message: what else it has is of a newer version."""

    sequence: int
    time_s: float
    published_s: float
    observed_share: float
    people: tuple[LivePerson, ...]
    cameras: tuple[CameraStatus, ...]
    # Recordings of before have none of these.
    tracking_since_s: float = math.nan
    restarts: tuple[Restarts, ...] = ()
    diagnosis: LiveJudgement | None = None


def encode_frame(frame: LiveFrame) -> bytes:
    """The message. Positions are rounded to single precision, about 1e-7 of their size."""
    return packed(frame_document(frame))


def decode_frame(body: bytes, skeleton: Skeleton) -> LiveFrame:
    """The frame in a message.

    Args:
        body: the message.
        skeleton: of the joints; the message has only their names.

    Raises:
        ValueError: it is no such message, or of another skeleton.
    """
    return frame_of_document(unpacked(body), skeleton)


def frame_document(frame: LiveFrame) -> dict[str, Any]:
    """What a message says, as maps, lists, numbers, texts and arrays."""
    return {
        "format": FORMAT,
        "version": VERSION,
        **{name: getattr(frame, name) for name in _SCALARS},
        "skeleton": frame.skeleton.name,
        "joints": frame.skeleton.joints,
        "people": [_person_document(person) for person in frame.people],
        "cameras": [{**asdict(camera), "state": camera.state.value} for camera in frame.cameras],
        "restarts": [asdict(restarts) for restarts in frame.restarts],
        "diagnosis": None if frame.diagnosis is None else asdict(frame.diagnosis),
    }


def _person_document(person: LivePerson) -> dict[str, Any]:
    arrays = {name: np.asarray(getattr(person, name), dtype=np.float32) for name in _ARRAYS}
    status = np.asarray(person.status, dtype=np.uint8)
    identity = {"person": person.person, "is_provisional": person.is_provisional, "former": person.former}
    return {**identity, "state": person.state.value, **arrays, "status": status}


def frame_of_document(document: Any, skeleton: Skeleton) -> LiveFrame:
    """As decode_frame, of what the message says."""
    if not isinstance(document, dict) or (document.get("format"), document.get("version")) != (FORMAT, VERSION):
        raise ValueError(f"not a message of {FORMAT}, version {VERSION}")
    if document.get("joints") != list(skeleton.joints):
        raise ValueError(f"the joints of the message are not those of skeleton {skeleton.name}")
    try:
        said = as_dataclass(document, _Frame)
        for person in said.people:
            _check_shapes(person, skeleton.n_joints)
    except ValueError as error:
        raise ValueError(f"a damaged message of {FORMAT}: {error}") from None
    return LiveFrame(skeleton=skeleton, **{field.name: getattr(said, field.name) for field in fields(said)})


def _check_shapes(person: LivePerson, n_joints: int) -> None:
    shapes = {"positions_m": (3,), "covariance_m2": (3, 3), "status": (), "probability": ()}
    for name, shape in shapes.items():
        actual = getattr(person, name).shape
        if actual != (n_joints, *shape):
            raise ValueError(f"{name} must be {(n_joints, *shape)}, got {actual}")
