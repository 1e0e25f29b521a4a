"""What a live system records: cameras, skeleton and parameters, then detections as they came, and what it published.

A file of records (record_files), each a MessagePack document (packing) with a key ``kind``:

- ``start``: the first. ``version``, ``started_s`` (Unix time), ``rig``, ``skeleton``, ``config`` (TOML).
- ``images``: detections that the tracker was given together, as ``images``. Of each the camera, ``time_s`` (when it
  was taken, Unix time), ``time_sigma_s`` (all times of the camera may be off by about so much; 0 if absent),
  ``stamp_s`` (by the camera's own clock; null: it gave none), ``arrived_s``, ``is_used`` (it was not too late for the
  estimate, and no fault was seen in its picture), and the arrays of fgpose.people.Detections.
- ``frame``: a message as it was published, see docs/live_messages.md.
- ``lost``: ``n`` records are missing at about this place, as the disk was too slow or full.
- ``end``: the recording was closed.
"""

from __future__ import annotations

import reprlib
import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fgpose.config import Config, config_from_dict, config_to_toml, parse_toml
from fgpose.geometry.camera import CameraRig
from fgpose.io.calibration import live_format
from fgpose.io.live.packing import unpacked
from fgpose.io.live.record_files import RecordFile
from fgpose.io.skeletons.tables import skeleton_of, skeleton_table
from fgpose.people_observations import Detections
from fgpose.plain_files import naming
from fgpose.skeleton import Skeleton

_VERSION = 1
_ARRAYS = ("points2d_px", "confidence", "points3d_m", "covariance3d_m2", "appearance")
# Between what follows each other in a recording, and between an image and its arrival. A disk may be full for days.
_LONGEST_S = 30 * 86400.0
# Unix time of the year 5138.
_LAST_S = 1e11


@dataclass(frozen=True, eq=False)
class RecordedImage:
    """The detections of an image, and what is known of its time."""

    detections: Detections
    """At the time when the image was taken, Unix time."""
    arrived_s: float
    """Unix time."""
    stamp_s: float | None = None
    """When it was taken by the camera's own clock; None: the camera gave no stamp."""
    is_used: bool = True
    """It entered the estimate; False: it came too late, or a fault was seen in its picture."""
    time_sigma_s: float = 0.0
    """By about so much the times of all images of the camera are off; 0: they are those of this computer's clock."""


@dataclass(frozen=True)
class RecordingStart:
    """The first record."""

    started_s: float
    """Unix time."""
    skeleton: Skeleton
    camera_names: tuple[str, ...]
    config: Config


def start_document(rig: CameraRig, skeleton: Skeleton, config: Config, started_s: float) -> dict[str, Any]:
    """The first record."""
    return {
        "kind": "start",
        "version": _VERSION,
        "started_s": started_s,
        "rig": live_format.as_document(rig),
        "skeleton": skeleton_table(skeleton),
        "config": config_to_toml(config),
    }


def images_document(images: list[RecordedImage]) -> dict[str, Any]:
    """A record of images that the tracker was given together."""
    return {"kind": "images", "images": [_image_document(image) for image in images]}


def _image_document(image: RecordedImage) -> dict[str, Any]:
    seen = image.detections
    times = {"time_s": seen.time_s, "time_sigma_s": image.time_sigma_s}
    times |= {"stamp_s": image.stamp_s, "arrived_s": image.arrived_s}
    arrays = {name: getattr(seen, name) for name in _ARRAYS}
    given = {name: np.asarray(array) for name, array in arrays.items() if array is not None}
    return {"camera": seen.camera, **times, "is_used": image.is_used, **given}


class LiveRecordingFile:
    """The records of a file, in order.

    Raises:
        ValueError: it is not the recording of a live system, or its first record is damaged; the message names it.
        OSError: it cannot be read.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._records = RecordFile(self.path)
        with naming(path):
            first = next(iter(self._records), None)
            if first is None:
                raise ValueError("it ends before anything was recorded")
            self.start = _start(unpacked(first))
            self._last_s = self.start.started_s
            """When the newest frame was published of those that were read."""

    def __iter__(self) -> Iterator[dict[str, Any]]:
        """The documents of all records but the first and the last.

        Raises:
            ValueError: the file is damaged other than by being cut off; the message names it.
            OSError: it cannot be read.

        Warns:
            UserWarning: the recording was not closed, was cut off in the middle of a record, or lacks records.
        """
        n_lost, is_closed, self._last_s = 0, False, self.start.started_s
        with naming(self.path):
            records = iter(self._records)
            next(records, None)
            for body in records:
                document = unpacked(body)
                kind = document.get("kind") if isinstance(document, dict) else None
                if kind == "lost":
                    n_lost += int(_number(document, "n"))
                elif kind == "end":
                    is_closed = True
                elif kind in ("images", "frame"):
                    self._last_s = self._published_s(document) if kind == "frame" else self._last_s
                    yield document
        self._warn(n_lost, is_closed)

    def _warn(self, n_lost: int, is_closed: bool) -> None:
        if self._records.lost_bytes:
            warnings.warn(
                f"{self.path}: the recording was cut off; its last {self._records.lost_bytes} bytes are no whole "
                "record and are left out",
                stacklevel=3,
            )
        elif not is_closed:
            warnings.warn(
                f"{self.path}: the recording was not closed, so what came last may be missing: a second "
                "at most, unless the disk was full",
                stacklevel=3,
            )
        if n_lost:
            warnings.warn(f"{self.path}: the disk was too slow or full, {n_lost} records are missing", stacklevel=3)

    def updates(self) -> Iterator[list[RecordedImage]]:
        """The images that the tracker was given together, in its order; errors and warnings as of iteration."""
        for document in self:
            if document.get("kind") == "images":
                yield self.images(document)

    def images(self, document: dict[str, Any]) -> list[RecordedImage]:
        """Those of a document of images. Raises ValueError where they are damaged; the message names the file."""
        try:
            return [self._image(image) for image in document["images"]]
        except (ValueError, TypeError, KeyError, AttributeError, IndexError, OverflowError) as error:
            raise ValueError(f"{self.path}: damaged images: {error}") from None

    def _image(self, table: dict[str, Any]) -> RecordedImage:
        image = _recorded_image(table)
        seen, n_joints = image.detections, self.start.skeleton.n_joints
        if seen.camera not in self.start.camera_names:
            raise ValueError(f"{seen}: the recording has no such camera")
        if seen.points2d_px.shape[1] != n_joints:
            raise ValueError(f"{seen}: {seen.points2d_px.shape[1]} joints, its skeleton has {n_joints}")
        _check_follows(image.arrived_s, self._last_s, f"{seen}: it arrived")
        _check_follows(seen.time_s, image.arrived_s, f"{seen}: it was taken")
        _check_follows(image.arrived_s, seen.time_s, f"{seen}: it arrived")
        return image

    def _published_s(self, document: dict[str, Any]) -> float:
        published_s = _number(document, "published_s")
        _check_follows(published_s, self._last_s, "a frame was published")
        return published_s


def _start(document: Any) -> RecordingStart:
    if not isinstance(document, dict) or document.get("kind") != "start":
        raise ValueError("the recording does not begin with its cameras")
    if document.get("version") != _VERSION:
        raise ValueError(f"a live recording of version {document.get('version')!r:.40}, not {_VERSION}")
    try:
        skeleton = skeleton_of(document.get("skeleton"))
    except ValueError as error:
        raise ValueError(f"a damaged first record: its skeleton: {error}") from None
    try:
        cameras = document["rig"]["camera_names"]
        config = config_from_dict(parse_toml(document["config"]))
        started_s = _number(document, "started_s")
        if not 0 <= started_s < _LAST_S:
            raise ValueError(f"it began at {started_s:.13g} s, which is no Unix time")
        return RecordingStart(started_s, skeleton, tuple(map(str, cameras)), config)
    except (TypeError, KeyError, AttributeError, IndexError, OverflowError) as error:
        raise ValueError(f"a damaged first record: {type(error).__name__}: {error}") from None


def _recorded_image(image: dict[str, Any]) -> RecordedImage:
    arrays = {name: np.asarray(image[name], dtype=float) for name in _ARRAYS if name in image}
    detections = Detections(str(image["camera"]), _number(image, "time_s"), **arrays)
    stamp_s = None if image["stamp_s"] is None else _number(image, "stamp_s")
    time_sigma_s = _number(image, "time_sigma_s") if "time_sigma_s" in image else 0.0
    if time_sigma_s < 0:
        raise ValueError(f"camera {detections.camera}: the standard deviation of its times is {time_sigma_s:g} s")
    return RecordedImage(detections, _number(image, "arrived_s"), stamp_s, image["is_used"] is True, time_sigma_s)


def _number(table: dict[str, Any], name: str) -> float:
    """A finite one."""
    value = table.get(name)
    # Some integers are too large for a float.
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= sys.float_info.max:
        raise ValueError(f"{name} is {reprlib.repr(value)}, not a finite number")
    return float(value)


def _check_follows(time_s: float, before_s: float, what: str) -> None:
    if time_s - before_s > _LONGEST_S:
        raise ValueError(f"{what} {(time_s - before_s) / 86400:.3g} days after what is before it")
