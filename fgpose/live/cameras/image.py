"""An image on its way from a source to a detector."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np

from fgpose.io.live.recordings import RecordedImage
from fgpose.live.cameras.clock_model import Stamp
from fgpose.people_observations import Detections


@runtime_checkable
class Picture(Protocol):
    """Pixels as the source has them; converting every image of a fast camera costs more than is looked at."""

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height."""
        ...

    def rgb(self) -> np.ndarray:
        """(H, W, 3) uint8."""
        ...

    def luma(self) -> np.ndarray:
        """(H, W) uint8, about the brightness; perhaps a view. Sides may be exchanged, as the sensor has them."""
        ...


@dataclass(frozen=True, eq=False)
class ArrayPicture:
    """A picture that is an array already."""

    array: np.ndarray
    """(H, W, 3) RGB uint8"""

    @property
    def size_px(self) -> tuple[int, int]:
        return self.array.shape[1], self.array.shape[0]

    def rgb(self) -> np.ndarray:
        return self.array

    def luma(self) -> np.ndarray:
        return self.array[:, :, 1]


@dataclass(frozen=True, eq=False)
class SourceImage:
    """What a source gives: a picture, or the detections in one that was taken elsewhere."""

    picture: Picture | None = None
    stamp: Stamp | None = None
    """None: the source says nothing of when it was taken."""
    detections: Detections | None = None
    """Their time is not used."""
    is_damaged: bool = False
    """The decoder says that parts are missing; perhaps there is no picture then."""


@dataclass(frozen=True, eq=False)
class Image:
    """The newest image of a camera."""

    camera: str
    number: int
    """Of the images that have arrived from this camera, from 0."""
    captured_s: float
    """Unix time at which it was taken."""
    arrived_s: float
    """Unix time."""
    source: SourceImage
    time_sigma_s: float = 0.0
    """By about so much the times of all images of the camera are off."""
    is_trusted: bool = True
    """No fault is seen in its picture."""

    @property
    def detections(self) -> Detections | None:
        """Of a camera whose detector is elsewhere, at the time when the image was taken; their picture is not here."""
        return self.source.detections

    def recorded(self, detections: Detections) -> RecordedImage:
        """What was found in it, with all that is known of its time."""
        stamp_s = None if self.source.stamp is None else self.source.stamp.stamp_s
        return RecordedImage(detections, self.arrived_s, stamp_s, self.is_trusted, self.time_sigma_s)

    @cached_property
    def picture(self) -> np.ndarray:
        """(H, W, 3) RGB uint8, converted when it is first asked for.

        Raises:
            ValueError: there are detections instead.
        """
        if self.source.picture is None:
            raise ValueError(f"camera {self.camera}: its detector is elsewhere, there is no picture")
        return self.source.picture.rgb()
