"""Input and output of the methods of the benchmark."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from jaxtyping import Bool, Float

from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations

RecordingT = TypeVar("RecordingT")
ResultT = TypeVar("ResultT")


@dataclass(frozen=True, eq=False)
class BenchmarkRecording:
    """A recording whose truth is known. Methods see the observations and the rig; the rest is for scoring and for the
    oracle."""

    clip: str
    """Name of the motion (and of its draw of noise)."""
    variant: str
    observations: Observations
    """What the cameras delivered, at the times that they claim."""
    rig: CameraRig
    """As calibrated, which may be slightly wrong."""
    fps: float
    truth_m: Float[np.ndarray, "frame joint 3"]
    """World frame, metres, at the time of the first camera's images."""
    occluded: Bool[np.ndarray, "frame camera joint"]
    true_rig: CameraRig
    true_offsets_s: Float[np.ndarray, " camera"]
    """How much later than it claims each camera took its images, constant over the recording."""
    oracle_observations: Observations | None = None
    """What the oracle gets: the same noise, taken at the times claimed, no detection of an occluded joint, per-view 3D
    placed by the true rig. None where nobody knows."""
    sigma_px: float | None = None
    """True standard deviation of each pixel coordinate of a detection that is neither occluded nor an outlier."""


@dataclass(frozen=True, eq=False)
class MethodResult:
    """What a method made of a recording."""

    positions_m: Float[np.ndarray, "frame joint 3"]
    """NaN where the method gives nothing."""
    covariance_m2: Float[np.ndarray, "frame joint 3 3"] | None
    """None for methods that state none."""
    time_s: float
    """Wall-clock time for all frames."""
    offsets_s: Float[np.ndarray, " camera"] | None = None
    """Estimated true_offsets_s, for methods that estimate them."""


@dataclass(frozen=True)
class Method(Generic[RecordingT, ResultT]):
    """One line of the tables."""

    name: str
    group: str
    """per-frame, linear, baseline, peer, ours, oracle or file: which lines are compared with which."""
    solve: Callable[[RecordingT], ResultT]
