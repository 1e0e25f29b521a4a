"""What is said between the tracker's process and those of cameras."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fgpose.geometry.camera import CameraRig
from fgpose.live.cameras.rig_file import LiveRig
from fgpose.monocular.network import Network


@dataclass(frozen=True)
class CameraJob:
    """What a process of cameras is to do."""

    live_rig: LiveRig
    """Its cameras."""
    open_network: Callable[[], Network]
    """Opens the network in the process; it can be pickled."""
    late_s: float
    n_detectors: int
    """Images that the network works on at once."""
    unix_minus_monotonic_s: float
    """Of the clock of the live system."""
    has_viewer: bool = False
    """Small pictures are sent, to look at."""
    is_known: bool = False
    """The sources were open before, see LiveCameras."""


@dataclass(frozen=True)
class Opened:
    """The sources are open that can be."""

    rig: CameraRig
    period_s: float
    """Length of the longest recording."""
    warnings: tuple[str, ...]
    awaited: tuple[str, ...]
    """Cameras that could not be opened."""


@dataclass(frozen=True)
class Begin:
    """Read from now on; recordings begin at this Unix time, and loop after this period."""

    start_s: float
    period_s: float


@dataclass(frozen=True, eq=False)
class SmallPicture:
    """A picture to look at."""

    camera: str
    picture_rgb: np.ndarray
    """(H, W, 3) uint8, scaled down."""
    time_s: float
    """Unix time at which it was taken."""
