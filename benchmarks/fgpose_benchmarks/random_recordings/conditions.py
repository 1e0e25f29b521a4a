"""What is drawn for a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, TypeVar

import numpy as np

from fgpose_benchmarks.accuracy.variants import TEST_CLIPS, TUNING_CLIPS

_Option = TypeVar("_Option")

# Several times in a list: as many times as likely. What is absent in some recordings tells what it does in the others.
_OPTIONS: dict[str, Sequence[Any]] = {
    "clip": TUNING_CLIPS + TEST_CLIPS,
    "speed": (0.5, 1.0, 1.0, 2.0),
    "duration_s": (1.0, 5.0, 5.0, 8.0),
    "fps": (15.0, 25.0, 30.0, 60.0, 100.0),
    "n_cameras": (2, 3, 4, 4, 6, 8),
    "size_px": ((640, 480), (1280, 720), (1920, 1080), (1080, 1920)),
    "field_of_view_deg": (50.0, 70.0, 95.0),
    "radius_m": (3.0, 4.5, 7.0),
    "arc_deg": (360.0, 360.0, 180.0, 100.0),
    "turned_deg": (0.0, 0.0, 0.05, 0.3),
    "moved_m": (0.0, 0.0, 0.003, 0.015),
    "zoomed": (0.0, 0.0, 0.003, 0.015),
    "late_s": (0.0, 0.0, 0.004, 0.02),
    "sigma_m": (0.002, 0.006, 0.012, 0.025),
    "heavy_tails": (False, True, True),
    "correlated_share": (0.0, 0.5, 0.9),
    "correlation_s": (0.1, 0.4, 1.0),
    "bias_m": (0.0, 0.01, 0.03),
    "body_m": (0.0, 0.0, 0.01),
    "hidden": ("nothing", "limbs", "left side", "whole body", "joints"),
    "hidden_s": (0.3, 1.0, 3.0),
    "visible_s": (1.0, 3.0),
    "hidden_are": ("missing", "adrift", "frozen", "towards the body", "in the background"),
    "hidden_confidence": (0.2, 0.5, 0.85),
    "swapped_s": (0.0, 0.0, 0.3),
    "confidence": ("of the error", "one", "small", "random"),
    "outlier_share": (0.0, 0.01, 0.05),
    "stride_px": (0.0, 0.0, 4.0),
    "outside_are": ("missing", "clamped", "beyond"),
    "dropped_share": (0.0, 0.0, 0.1),
    "views3d": ("none", "none", "on the rays", "of their own"),
    "depth_m": (0.03, 0.1),
    "stature_share": (0.0, 0.05),
    # Drawn last: what was drawn before it came stays the same.
    "swapped_are": ("whole body", "whole body", "legs", "arms", "both legs on one"),
}


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """How a recording was made. Lengths of detections' errors are at the joint's depth, across the ray."""

    seed: int
    clip: str
    speed: float
    """How many times faster the motion is played."""
    duration_s: float
    fps: float
    n_cameras: int
    size_px: tuple[int, int]
    field_of_view_deg: float
    """Of the longer side of the image."""
    radius_m: float
    """Of the ring on which the cameras stand; each its own 0.8 to 1.25 of it."""
    arc_deg: float
    """Over which they stand."""
    turned_deg: float
    """SD of the error of each camera's orientation, each axis."""
    moved_m: float
    """SD of the error of each camera's position, each axis."""
    zoomed: float
    """SD of the relative error of each camera's focal length."""
    late_s: float
    """SD of how much later than it says each camera takes its images."""
    sigma_m: float
    """SD of a detection, each coordinate; each joint has its own 0.4 to 2.5 times as much."""
    heavy_tails: bool
    """Student's t of three degrees of freedom instead of a normal distribution."""
    correlated_share: float
    """Of the variance, correlated over correlation_s."""
    correlation_s: float
    bias_m: float
    """SD of the constant error of each joint in each view."""
    body_m: float
    """SD of what all joints of a view are off by together."""
    hidden: str
    """What is hidden at once from a camera."""
    hidden_s: float
    """Mean time for which it is."""
    visible_s: float
    """Mean time for which it is not."""
    hidden_are: str
    """Where detections of hidden joints are."""
    hidden_confidence: float
    swapped_s: float
    """Mean time for which sides are taken for each other in a view, every four seconds; 0: never."""
    confidence: str
    """What it tells."""
    outlier_share: float
    """Of the detections, off by 0.3 m."""
    stride_px: float
    """Of the grid that detections are on; 0: none."""
    outside_are: str
    """Detections of joints outside the image."""
    dropped_share: float
    """Of the images that have no detections."""
    views3d: str
    """Absolute 3D joints of each view."""
    depth_m: float
    """SD of their depth, body and joint."""
    stature_share: float
    """SD of how much larger each view takes the person to be, and so farther away."""
    swapped_are: str
    """Which sides are exchanged; with both legs on one, the right one is detected where the left one is."""

    def unusual(self) -> str:
        """What goes wrong, in words for one line."""
        values = ((field.name, getattr(self, field.name)) for field in fields(self) if field.name in _OPTIONS)
        return ", ".join(f"{name} {_plain(value)}" for name, value in values if value not in (0.0, "nothing", "none"))


def draw(seed: int) -> Conditions:
    """The conditions of a recording; of a seed always the same.

    Raises:
        ValueError: the seed is negative.
    """
    rng = np.random.default_rng(seed)
    return Conditions(seed=seed, **{name: pick(rng, options) for name, options in _OPTIONS.items()})


def pick(rng: np.random.Generator, options: Sequence[_Option]) -> _Option:
    """One of these, each as likely as the others."""
    return options[int(rng.integers(len(options)))]


def _plain(value: object) -> str:
    if isinstance(value, tuple):
        return "x".join(map(str, value))
    return f"{value:g}" if isinstance(value, float) else str(value)
