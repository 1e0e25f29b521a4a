"""A LiveFrame as a message: the format that docs/live_messages.md describes."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import numpy as np

from fgpose.association.track import TrackState
from fgpose.io.packing import packed, unpacked
from fgpose.live.frame import CameraState, CameraStatus, LiveFrame, LivePerson, Restarts
from fgpose.skeleton import Skeleton

FORMAT, VERSION = "fgpose/people", 1
_SCALARS = ("sequence", "time_s", "published_s", "observed_share")
_ARRAYS = ("positions_m", "covariance_m2", "probability")


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
        **{name: getattr(frame, name) for name in (*_SCALARS, "tracking_since_s")},
        "skeleton": frame.skeleton.name,
        "joints": frame.skeleton.joints,
        "people": [_person_document(person) for person in frame.people],
        "cameras": [{**asdict(camera), "state": camera.state.value} for camera in frame.cameras],
        "restarts": [asdict(restarts) for restarts in frame.restarts],
    }


def _person_document(person: LivePerson) -> dict[str, Any]:
    arrays = {name: np.asarray(getattr(person, name), dtype=np.float32) for name in _ARRAYS}
    status = np.asarray(person.status, dtype=np.uint8)
    return {"person": person.person, "state": person.state.value, **arrays, "status": status}


def frame_of_document(document: Any, skeleton: Skeleton) -> LiveFrame:
    """As decode_frame, of what the message says."""
    if not isinstance(document, dict) or (document.get("format"), document.get("version")) != (FORMAT, VERSION):
        raise ValueError(f"not a message of {FORMAT}, version {VERSION}")
    if tuple(document.get("joints", ())) != skeleton.joints:
        raise ValueError(f"the joints of the message are not those of skeleton {skeleton.name}")
    try:
        scalars = {name: document[name] for name in _SCALARS}
        people = tuple(_person(person, skeleton.n_joints) for person in document["people"])
        cameras = tuple(
            CameraStatus(**{**camera, "state": CameraState(camera["state"])}) for camera in document["cameras"]
        )
        # Recordings of before have neither.
        since_s = document.get("tracking_since_s", math.nan)
        restarts = tuple(Restarts(**each) for each in document.get("restarts", ()))
        later = {"tracking_since_s": since_s, "restarts": restarts}
        return LiveFrame(**scalars, skeleton=skeleton, people=people, cameras=cameras, **later)
    except (TypeError, KeyError, AttributeError) as error:
        raise ValueError(f"a damaged message of {FORMAT}: {type(error).__name__}: {error}") from None


def _person(document: dict[str, Any], n_joints: int) -> LivePerson:
    shapes = {"positions_m": (3,), "covariance_m2": (3, 3), "status": (), "probability": ()}
    arrays = {name: np.asarray(document[name]) for name in shapes}
    for name, shape in shapes.items():
        if arrays[name].shape != (n_joints, *shape):
            raise ValueError(f"{name} must be {(n_joints, *shape)}, got {arrays[name].shape}")
    return LivePerson(document["person"], TrackState(document["state"]), **arrays)
