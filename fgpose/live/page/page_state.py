"""What the status page shows, as the JSON that it reads."""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.up_axis import UpAxis, nearest_axis
from fgpose.live.diagnosis.told_live import changes
from fgpose.live.frame import CameraState, CameraStatus, LiveFrame, LivePerson
from fgpose.live.link_distance import LinkDistance
from fgpose.skeleton import Skeleton
from fgpose.viewer.rerun.palette import person_colour

LATENCY_EDGES_MS = (0, 5, 10, 15, 20, 25, 30, 40, 50, 75, 100, 150, 200, 250, 300, 400, 500, 1000)
"""Lower edges of the bins of the histogram; the last one has no upper edge."""

_OF_FRAME = ("sequence", "time_s", "published_s", "observed_share")
_OF_CAMERA = (
    *("reason", "image_s", "rate_hz", "clock_offset_s", "clock_sigma_s", "motion_offset_s", "motion_sigma_s"),
    *("n_images", "n_used", "n_lost"),
)
_OF_DISTANCE = ("link", "distance_m", "person", "part", "closing_m_s")
_LATENCY_OVER_S = 60.0
_RATE_OVER_S = 3.0
_MAX_EVENTS = 50
_MAX_FRAMES = 6000  # of the histogram: a minute at 100 Hz
_ELLIPSE = math.sqrt(-2 * math.log(0.1))  # standard deviations that hold 90 % of a normal distribution in the plane


class PageState:
    """What has happened lately, and the newest frame.

    Args:
        rig: its cameras are drawn where they stand.
        skeleton: of the people.
        up: the axis of the world that points up.
        replay: the name of the recording that is run again, empty if this is live.
    """

    def __init__(self, rig: CameraRig, skeleton: Skeleton, up: UpAxis, replay: str = "") -> None:
        self._skeleton, self._replay = skeleton, replay
        self._seen_from_above = _from_above(up)
        self._cameras = {camera.name: self._drawn(camera) for camera in rig.cameras}
        self._frame: LiveFrame | None = None
        self._published_s: deque[float] = deque(maxlen=_MAX_FRAMES)
        self._latency: deque[tuple[float, float]] = deque(maxlen=_MAX_FRAMES)
        self._events: deque[dict[str, Any]] = deque(maxlen=_MAX_EVENTS)
        self._distances: tuple[LinkDistance, ...] = ()

    def add(self, frame: LiveFrame) -> None:
        """The next frame."""
        before, self._frame = self._frame, frame
        self._published_s.append(frame.published_s)
        if not math.isnan(frame.time_s) and (before is None or frame.time_s != before.time_s):
            self._latency.append((frame.published_s, frame.age_s))
        self._note_cameras(before, frame)
        self._note_people(before, frame)
        self._note_diagnosis(before, frame)

    def note(self, time_s: float, text: str, *, is_fault: bool = False) -> None:
        """Something has happened."""
        self._events.append({"time_s": time_s, "text": text, "is_fault": is_fault})

    def set_distances(self, distances: Sequence[LinkDistance]) -> None:
        before = {distance.link: distance.fault for distance in self._distances}
        self._distances = tuple(distances)
        for distance in distances:
            if distance.fault is not None and distance.fault != before.get(distance.link):
                self.note(distance.fault.since_s, f"{distance.link}: {distance.fault.reason}", is_fault=True)

    def to_json(self, now_s: float, pictures: Collection[str], faults: Mapping[str, str]) -> bytes:
        """Everything at a time.

        Args:
            now_s: Unix time.
            pictures: cameras of which there is one.
            faults: of inputs and outputs by name, empty where there is none.
        """
        frame = self._frame
        return _to_json(
            {
                "now_s": now_s,
                "replay": self._replay,
                "skeleton": self._skeleton.name,
                "lines": [*self._skeleton.bones, *self._skeleton.lines],
                "frame": None if frame is None else _fields(frame, _OF_FRAME),
                "rate_hz": self._rate_hz(now_s),
                "latency": self._latency_table(now_s),
                "cameras": [
                    drawn | {"name": name, "picture": name in pictures} | _status(frame, name)
                    for name, drawn in self._cameras.items()
                ],
                "people": [] if frame is None else [self._person(person) for person in frame.people],
                "outputs": [{"name": name, "fault": fault} for name, fault in faults.items()],
                "restarts": [] if frame is None else [asdict(restarts) for restarts in frame.restarts],
                "diagnosis": None if frame is None or frame.diagnosis is None else asdict(frame.diagnosis),
                "distances": [_distance(distance) for distance in self._distances],
                "events": list(self._events),
            }
        )

    def _note_cameras(self, before: LiveFrame | None, frame: LiveFrame) -> None:
        old = {} if before is None else {camera.name: camera.state for camera in before.cameras}
        for camera in frame.cameras:
            if camera.state is not old.get(camera.name, CameraState.OK):
                reason = f": {camera.reason}" if camera.reason else ""
                is_fault = camera.state is not CameraState.OK
                self.note(frame.published_s, f"camera {camera.name} {camera.state.value}{reason}", is_fault=is_fault)

    def _note_people(self, before: LiveFrame | None, frame: LiveFrame) -> None:
        old = set() if before is None else {person.person for person in before.people}
        new = {person.person for person in frame.people}
        for person in frame.people:
            if person.former in old:
                self.note(frame.published_s, f"person {person.former} is recognised as person {person.person}")
                old, new = old - {person.former}, new - {person.person}
        for number in sorted(new - old):
            self.note(frame.published_s, f"person {number} is there")
        for number in sorted(old - new):
            self.note(frame.published_s, f"person {number} is gone")

    def _note_diagnosis(self, before: LiveFrame | None, frame: LiveFrame) -> None:
        new, gone = changes(None if before is None else before.diagnosis, frame.diagnosis)
        for finding in new:
            self.note(frame.published_s, finding.text, is_fault=True)
        for finding in gone:
            self.note(frame.published_s, finding.text_when_gone)

    def _rate_hz(self, now_s: float) -> float:
        """Of the frames that are published."""
        return sum(published_s > now_s - _RATE_OVER_S for published_s in list(self._published_s)) / _RATE_OVER_S

    def _latency_table(self, now_s: float) -> dict[str, Any]:
        ages_s = [age_s for published_s, age_s in list(self._latency) if published_s > now_s - _LATENCY_OVER_S]
        ages_ms = 1e3 * np.array(ages_s)
        edges_ms = np.array([*LATENCY_EDGES_MS, np.inf])
        counts = np.histogram(np.maximum(ages_ms, 0.0), edges_ms)[0]
        quantiles = {"median_ms": 50, "p95_ms": 95, "p99_ms": 99}
        values = {name: float(np.percentile(ages_ms, share)) if ages_s else None for name, share in quantiles.items()}
        return {"edges_ms": LATENCY_EDGES_MS, "counts": counts.tolist(), **values}

    def _drawn(self, camera: Camera) -> dict[str, Any]:
        """A camera from above: where it stands and the directions of the sides of its image; and how large that is."""
        (width_px, _), height_px = camera.size_px, camera.K[1, 2]
        sides = camera.ray(np.array([[0.0, height_px], [width_px, height_px]])) @ self._seen_from_above.T
        return {
            "at_m": (self._seen_from_above @ camera.position_m).tolist(),
            "sides": sides.tolist(),
            "size_px": camera.size_px,
        }

    def _person(self, person: LivePerson) -> dict[str, Any]:
        axes = self._seen_from_above
        root = list(self._skeleton.root)
        at_m = axes @ person.positions_m[root].mean(axis=0)
        covariance_m2 = axes @ person.covariance_m2[root].mean(axis=0) @ axes.T
        ellipse = None
        if np.isfinite(covariance_m2).all():
            variance_m2, direction = np.linalg.eigh(covariance_m2)
            radii_m = _ELLIPSE * np.sqrt(np.maximum(variance_m2[::-1], 0.0))
            turn_deg = math.degrees(math.atan2(direction[1, 1], direction[0, 1]))
            ellipse = {"radii_m": radii_m.tolist(), "turn_deg": turn_deg}
        return {
            "person": person.person,
            "colour": "rgb({} {} {})".format(*person_colour(person.person)),
            "is_provisional": person.is_provisional,
            "state": person.state.value,
            "at_m": at_m.tolist(),
            "joints_m": (person.positions_m @ axes.T).tolist(),
            "ellipse": ellipse,
        }


def _from_above(up: UpAxis) -> Float[np.ndarray, "2 3"]:
    """The two axes of the world that lie on the floor, right and up as one looks down."""
    sign, axis = nearest_axis(up)
    number = "xyz".index(axis)
    first, second = np.eye(3)[(number + 1) % 3], np.eye(3)[(number + 2) % 3]
    return np.stack([first, second] if sign == "+" else [second, first])


def _status(frame: LiveFrame | None, name: str) -> dict[str, Any]:
    camera = next((camera for camera in (frame.cameras if frame else ()) if camera.name == name), None)
    if camera is None:
        return {"state": "unknown", "reason": "nothing has been published yet"}
    return _fields(camera, _OF_CAMERA) | {"state": camera.state.value}


def _distance(distance: LinkDistance) -> dict[str, Any]:
    fault = None if distance.fault is None else asdict(distance.fault)
    return _fields(distance, _OF_DISTANCE) | {"is_free": distance.distance_m == math.inf, "fault": fault}


def _fields(said: LiveFrame | CameraStatus | LinkDistance, names: Sequence[str]) -> dict[str, Any]:
    return {name: getattr(said, name) for name in names}


def _to_json(table: Mapping[str, Any]) -> bytes:
    """With null for what is not a finite number: JSON has no such numbers. A ten thousandth is enough to draw."""

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: plain(inner) for key, inner in value.items()}
        if isinstance(value, list | tuple):
            return [plain(inner) for inner in value]
        if isinstance(value, float):
            return round(value, 4) if math.isfinite(value) else None
        return value

    return json.dumps(plain(table), separators=(",", ":")).encode()
