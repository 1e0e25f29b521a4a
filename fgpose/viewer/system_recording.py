"""The interface through which a live system is shown. Does not import Rerun."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from fgpose.association.track import TrackEvent
from fgpose.association.tracked import Tracked
from fgpose.people import Detections
from fgpose.viewer.recording import Recording


@dataclass(frozen=True)
class CameraSaid:
    """What is said of a camera."""

    state: str
    """A key of palette.CAMERA_STATES, or another word."""
    reason: str = ""
    is_silent: bool = False
    """No images come from it: what it showed last is taken away."""


@dataclass(frozen=True, eq=False)
class Moment:
    """What a live system says at one time."""

    time_s: float
    """Unix time at which the people are there."""
    people: Sequence[Tracked]
    images: Sequence[Detections] = ()
    """That are new; at most one of each camera. Cameras without one stay as they were."""
    pictures: Mapping[str, np.ndarray] = field(default_factory=dict)
    """(H, W, 3) RGB uint8 by the camera; perhaps scaled down."""
    events: Sequence[TrackEvent] = ()
    """Since the moment before."""
    cameras: Mapping[str, CameraSaid] = field(default_factory=dict)
    """By name; of those that are not here nothing is known."""
    delay_s: float | None = None
    """From the newest image to its frame; None: there was no new image."""
    observed_share: float | None = None
    """Of the volume."""
    note: str = ""
    """Of the recording itself; empty: there is none."""


class SystemRecording(Recording):
    """Takes what a live system says, moment by moment; this one shows nothing.

    ``fgpose.viewer.open_system_recording`` gives one that does. Its memory does not grow with time.
    """

    def log_moment(self, moment: Moment) -> None:
        """Show people, detections, pictures, the states of the cameras and the delay.

        Raises:
            ValueError: a camera is unknown or has two images, an image has another number of joints, or the skeleton or
                the cameras of an estimate differ.
            OSError: the disk is full, or so slow that memory would fill.
        """
