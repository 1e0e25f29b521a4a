"""Input and output of the methods of the benchmark of calibration from people."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from fgpose.calibration.from_people.calibrated import CameraSigmas
from fgpose.calibration.from_people.walk import Walk
from fgpose.geometry.camera import CameraRig
from fgpose.people_observations import PeopleObservations
from fgpose_benchmarks.comparison.recording import Method
from fgpose_benchmarks.synthetic import WalkScene

Focal = Literal["known", "shared", "each"]
Outcome = Literal["good", "coarse", "failed", "unjudged"]
"""The verdict on a calibration; unjudged: the method has none."""


@dataclass(frozen=True)
class Given:
    """What a user tells a calibration besides videos and intrinsics."""

    focal: Focal = "known"
    stature_m: float | None = None
    distances: tuple[tuple[str, str, float], ...] = ()
    synchronised: bool = True


@dataclass(frozen=True, eq=False)
class KnownRigRecording:
    """A recording whose rig is known. Methods see people, intrinsics and given; told is for the baselines, which have
    no tracking and no clocks of their own, the rest for scoring."""

    clip: str
    """Name of the draw of the person, of the walk and of the errors."""
    variant: str
    people: PeopleObservations
    """Each camera by its own clock; per-view 3D joints in the frame of each camera."""
    intrinsics: CameraRig
    given: Given
    rig: CameraRig
    """True; its world has z up and the floor at z = 0, unless it is of a real recording."""
    told: Walk
    """The walker by the true clocks: the image of each camera that is nearest in time to each of the first."""
    image_s: Float[np.ndarray, "frame camera"]
    """When these images were taken, by the clock of their own camera; NaN: there is none."""
    on_time_s: Float[np.ndarray, "frame camera"]
    """The same by the clock of the first camera."""
    joints_m: Float[np.ndarray, "frame joint 3"]
    """True joints of the walker, for real recordings those of the true rig; NaN: unknown."""
    fps: float
    """Of the slowest camera: errors of starts are counted in its frames."""
    scene: WalkScene | None = None
    """None for real recordings."""

    def of_cameras(self, names: tuple[str, ...]) -> KnownRigRecording:
        """With some of the cameras. Raises ValueError for an unknown name."""
        rig, walk = self.rig.subset(names), self.told
        kept = [self.rig.names.index(name) for name in names]
        told = replace(
            walk,
            camera_names=names,
            points2d_px=walk.points2d_px[:, kept],
            confidence=walk.confidence[:, kept],
            points3d_m=None if walk.points3d_m is None else walk.points3d_m[:, kept],
        )
        return replace(
            self,
            people=self.people.subset(names),
            intrinsics=self.intrinsics.subset(names),
            rig=rig,
            told=told,
            image_s=self.image_s[:, kept],
            on_time_s=self.on_time_s[:, kept],
        )


@dataclass(frozen=True, eq=False)
class CalibrationResult:
    """What a method made of a recording."""

    rig: CameraRig | None
    """None: it refused."""
    outcome: Outcome
    reasons: tuple[str, ...]
    """Of the verdict."""
    sigmas: CameraSigmas | None
    is_metric: bool
    """Whether scale, vertical and floor are estimated."""
    time_s: float


CalibrationMethod = Method[KnownRigRecording, CalibrationResult]
"""One line of the tables; its group is ours or baseline."""
