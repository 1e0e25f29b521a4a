"""Cameras in simulated time: images with pictures, stamps and detections, and every fault that a camera may have."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import UInt8

from fgpose.geometry.camera import CameraRig
from fgpose.io.live.recordings import RecordedImage
from fgpose.live.cameras.camera import CameraEvent, LiveCamera
from fgpose.live.cameras.clock_model import Stamp
from fgpose.live.cameras.image import ArrayPicture, SourceImage
from fgpose.live.clock import SimulatedClock
from fgpose.live.frame import CameraStatus
from fgpose.live.processes.pending_detections import PendingDetections
from fgpose.live.sources import CameraSource
from fgpose.people_observations import Detections
from timeline import Timeline

CameraFaultKind = Literal[
    "unplugged", "frozen", "black", "garbled", "damaged", "slow", "late", "moved", "clock", "source", "worker"
]
"""source: it fails and is opened again. worker: a process of some cameras ends, and what they knew is gone."""

_PICTURE_PX = (96, 72)
# That one camera gives in turn: each has noise of its own, so that neighbours differ.
_N_PICTURES = 16
_LOOKS_S = 0.2
# From taking an image to its arrival: at least, and on average as much again.
_LATENCY_S = 0.01
_SLOWER = 3
_LATER_S = 0.8
_CRYSTAL = 20e-6
# What a network finds where a picture is grey.
_HALLUCINATED_PX = 60.0
_GREY_SHARE = 0.6


@dataclass(frozen=True)
class PlayedFault:
    """What happens to some cameras for a while. The clock of a camera jumps once."""

    kind: CameraFaultKind
    cameras: tuple[str, ...]
    begin_s: float
    """Unix time."""
    end_s: float
    seed: int = 0
    """Of how far a camera is moved, or its clock jumps."""


class SimulatedCameras:
    """Cameras of one rate, which take their images together. It is a Feed of one thread: to take is to go on in time.

    Args:
        rig: the cameras.
        clock: which it advances.
        seen: what the detector of a camera finds in an image; images are counted from 0.
        rate_hz: of the images.
        late_s: of LiveCamera.
        seed: of delays, clocks and noise.
        on_event: of LiveCamera.
    """

    def __init__(
        self,
        rig: CameraRig,
        clock: SimulatedClock,
        seen: Callable[[str, int], Detections],
        rate_hz: float,
        late_s: float,
        seed: int,
        on_event: Callable[[CameraEvent], None] | None = None,
    ) -> None:
        self._clock, self._seen, self._rate_hz = clock, seen, rate_hz
        self._late_s, self._on_event = late_s, on_event
        self._rng = np.random.default_rng(seed)
        self._began_s = clock.now_s()
        self._arrivals = PendingDetections(rig.names)
        self._width_px = {camera.name: camera.size_px for camera in rig.cameras}
        self._simulated = {name: _Camera(self._new(name), self._rng) for name in rig.names}
        self._timeline = Timeline(clock)
        for camera in self._simulated.values():
            camera.live.connected()
            self._timeline.at(self._began_s, lambda camera=camera: self._take_image(camera, 0))
        self._timeline.at(self._began_s, self._look)

    def add(self, fault: PlayedFault) -> None:
        """Let it happen; it begins in the future."""
        self._timeline.at(fault.begin_s, lambda: self._begin(fault))
        if fault.kind != "clock":
            self._timeline.at(fault.end_s, lambda: self._end(fault))

    def take(self, timeout_s: float) -> list[RecordedImage]:
        """See Feed."""
        return self._timeline.until_any(self._arrivals, timeout_s)

    def go_on(self, camera_names: Collection[str]) -> None:
        """See Feed."""

    def statuses(self) -> tuple[CameraStatus, ...]:
        """See Feed."""
        now_s = self._clock.now_s()
        return tuple(
            dataclasses.replace(camera.live.status(now_s), n_lost=self._arrivals.n_left_out(name))
            for name, camera in self._simulated.items()
        )

    def _new(self, name: str) -> LiveCamera:
        settings = CameraSource(source="simulated", latency_s=_LATENCY_S)
        return LiveCamera(name, settings, self._clock, self._late_s, self._on_event)

    def _look(self) -> None:
        for camera in self._simulated.values():
            camera.live.look()
        self._timeline.at(self._clock.now_s() + _LOOKS_S, self._look)

    def _begin(self, fault: PlayedFault) -> None:
        for camera in self._of(fault):
            if fault.kind == "clock":
                camera.stamp_offset_s += _jump_s(fault)
                continue
            camera.fault, camera.frozen = fault, None
            if fault.kind == "source":
                camera.live.failed("nothing answers there")
            elif fault.kind == "worker":
                camera.live.failed("its process ended and is started again")

    def _end(self, fault: PlayedFault) -> None:
        for camera in self._of(fault):
            camera.fault = None
            if fault.kind == "worker":
                camera.live = self._new(camera.live.name)
            if fault.kind in ("source", "worker"):
                camera.stamp_offset_s = float(self._rng.uniform(0, 1e5))
                camera.live.connected()

    def _of(self, fault: PlayedFault) -> list[_Camera]:
        return [self._simulated[name] for name in fault.cameras]

    def _take_image(self, camera: _Camera, number: int) -> None:
        taken_s = self._began_s + number / self._rate_hz
        self._timeline.at(self._began_s + (number + 1) / self._rate_hz, lambda: self._take_image(camera, number + 1))
        delay_s = _LATENCY_S + float(self._rng.exponential(_LATENCY_S))
        image = self._image(camera, number, taken_s)
        if image is None:
            return
        arrival_s = taken_s + delay_s
        if camera.fault is not None and camera.fault.kind == "late":
            arrival_s = max(min(taken_s + _LATER_S, camera.fault.end_s), arrival_s)
        camera.arrival_s = max(arrival_s, camera.arrival_s + 1e-4)
        self._timeline.at(camera.arrival_s, lambda: self._arrive(camera, image))

    def _arrive(self, camera: _Camera, image: SourceImage) -> None:
        if camera.is_silent:
            return
        received = camera.live.receive(image)
        if received is not None and received.detections is not None:
            self._arrivals.put(received.recorded(received.detections))

    def _image(self, camera: _Camera, number: int, taken_s: float) -> SourceImage | None:
        """As it leaves the camera; None if it does not."""
        fault = camera.fault
        if camera.is_silent or (fault is not None and fault.kind == "slow" and number % _SLOWER):
            return None
        stamp = Stamp((taken_s - self._began_s) * (1 + camera.drift) + camera.stamp_offset_s)
        found = self._seen(camera.live.name, number)
        image = SourceImage(camera.pictures[number % _N_PICTURES], stamp, found)
        if fault is None:
            return image
        if fault.kind == "frozen":
            camera.frozen = camera.frozen or image
            return dataclasses.replace(camera.frozen, stamp=stamp)
        if fault.kind == "black":
            nobody = _of(found, found.points2d_px[:0], found.confidence[:0])
            return SourceImage(camera.black[number % _N_PICTURES], stamp, nobody)
        return _spoilt(image, fault, self._width_px[camera.live.name])


class _Camera:
    """A camera, and what is wrong with it."""

    def __init__(self, live: LiveCamera, rng: np.random.Generator) -> None:
        self.live = live
        self.pictures, self.black = _pictures(rng)
        self.drift = float(rng.uniform(-_CRYSTAL, _CRYSTAL))
        self.stamp_offset_s = float(rng.uniform(0, 1e5))
        self.fault: PlayedFault | None = None
        self.frozen: SourceImage | None = None
        """The image that comes again and again."""
        self.arrival_s = -np.inf
        """Of its newest image; images do not overtake each other."""

    @property
    def is_silent(self) -> bool:
        return self.fault is not None and self.fault.kind in ("unplugged", "source", "worker")


def _pictures(rng: np.random.Generator) -> tuple[list[ArrayPicture], list[ArrayPicture]]:
    """Of a room with a plain wall and things of all brightnesses, and of the dark, with the noise of a sensor."""
    width, height = _PICTURE_PX
    room = np.kron(rng.integers(20, 236, (height // 8, width // 8)), np.ones((8, 8)))
    room[:, : width // 2] = 150
    dark = np.full_like(room, 16.0)
    return [_noisy(room, rng, 3.0) for _ in range(_N_PICTURES)], [_noisy(dark, rng, 1.0) for _ in range(_N_PICTURES)]


def _noisy(picture: np.ndarray, rng: np.random.Generator, sigma: float) -> ArrayPicture:
    noisy = np.clip(picture + rng.normal(0, sigma, picture.shape), 0, 255).astype(np.uint8)
    return ArrayPicture(np.repeat(noisy[:, :, None], 3, axis=2))


def _jump_s(fault: PlayedFault) -> float:
    rng = np.random.default_rng(fault.seed)
    return float(rng.choice([-1, 1]) * rng.uniform(0.5, 5.0))


def _spoilt(image: SourceImage, fault: PlayedFault, size_px: tuple[int, int]) -> SourceImage:
    """An image of a camera that is garbled, damaged or moved, and what a network finds in it."""
    assert isinstance(image.picture, ArrayPicture)
    assert image.detections is not None
    if fault.kind == "damaged":
        return dataclasses.replace(image, is_damaged=True)
    pixels, found = image.picture.array, image.detections
    if fault.kind == "garbled":
        pixels, found = _garbled(pixels, found, size_px)
    elif fault.kind == "moved":
        shift = np.random.default_rng(fault.seed).integers(2, 11, 2) * [1, -1]
        pixels = np.roll(pixels, shift[::-1], axis=(0, 1))
        found = _of(found, found.points2d_px + shift * np.divide(size_px, _PICTURE_PX), found.confidence)
    return dataclasses.replace(image, picture=ArrayPicture(pixels), detections=found)


def _garbled(
    pixels: UInt8[np.ndarray, "y x 3"], found: Detections, size_px: tuple[int, int]
) -> tuple[UInt8[np.ndarray, "y x 3"], Detections]:
    """The lower part of the picture is grey; what is there is hallucinated."""
    first = round((1 - _GREY_SHARE) * len(pixels))
    grey = pixels.copy()
    grey[first:] = 128
    is_hidden = found.points2d_px[..., 1] > (1 - _GREY_SHARE) * size_px[1]
    error_px = _HALLUCINATED_PX * np.random.default_rng(len(found.points2d_px)).standard_normal(found.points2d_px.shape)
    return grey, _of(found, found.points2d_px + np.where(is_hidden[..., None], error_px, 0.0), found.confidence)


def _of(found: Detections, points2d_px: np.ndarray, confidence: np.ndarray) -> Detections:
    return Detections(found.camera, found.time_s, points2d_px, confidence)
