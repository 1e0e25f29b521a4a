"""A kind of damage: what it does to a recording, what it should be called, and what helps."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fgpose.finding import Code
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose_benchmarks.faults.take import FPS, Take

# For a real recording: what changes in its middle is told from what it was before and after.
_LEAST_S = 4.0


@dataclass(frozen=True, eq=False)
class Damaged:
    """What fgpose is given, and what is true."""

    rig: CameraRig
    observations: Observations
    truth_m: Float[np.ndarray, "frame joint 3"]
    """NaN where nobody is there."""
    cameras: tuple[str, ...] = ()
    """Those that are damaged; empty: all, or none in particular."""
    at_s: float | None = None
    """When it happened, if it did during the recording."""
    slower: float = 1.0
    """Its times are so many times as long as they were."""


@dataclass(frozen=True)
class Damage:
    """One kind."""

    name: str
    codes: tuple[Code, ...]
    """The findings that name the cause rightly."""
    inflict: Callable[[Take, np.random.Generator], Damaged]
    least_cameras: int = 2
    """With fewer it cannot be inflicted."""
    is_constant: bool = False
    """Whether it does the same to every frame: a few seconds show its errors."""
    of_simulated: bool = False
    """Whether it needs a body that stands upright, and all of whose joints are seen."""

    def can_befall(self, take: Take) -> bool:
        """Whether a recording has enough cameras, is long enough, and shows enough."""
        if take.is_control or take.rig.n_cameras < self.least_cameras or (self.of_simulated and take.is_real):
            return False
        return self.is_constant or len(take.truth_m) / FPS > _LEAST_S or not take.is_real


def with_points(
    observations: Observations,
    points2d_px: Float[np.ndarray, "frame camera joint 2"],
    confidence: Float[np.ndarray, "frame camera joint"] | None = None,
) -> Observations:
    """The same recording with other detections; NaN = missing."""
    given = observations.confidence if confidence is None else confidence
    known = np.asarray(np.isfinite(points2d_px).all(axis=-1))
    points2d_px = np.where(known[..., None], points2d_px, np.nan)
    return replace(observations, points2d_px=points2d_px, confidence=np.where(known, given, 0.0))


def with_sides_exchanged(observations: Observations, camera: int, joints: Iterable[str] = ()) -> Observations:
    """Left and right of these joints (of neither side), or of all, in one camera."""
    skeleton = observations.skeleton
    own = [skeleton.index(f"{side}_{joint}") for joint in joints for side in ("left", "right")]
    order = skeleton.mirror.copy()
    if own:
        order = np.arange(skeleton.n_joints)
        order[own] = skeleton.mirror[own]
    points, confidence = observations.points2d_px.copy(), observations.confidence.copy()
    points[:, camera], confidence[:, camera] = points[:, camera][:, order], confidence[:, camera][:, order]
    return with_points(observations, points, confidence)


def some_camera(take: Take, rng: np.random.Generator) -> int:
    return int(rng.integers(take.rig.n_cameras))
