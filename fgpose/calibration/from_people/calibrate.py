"""The chain from what uncalibrated cameras saw of people to a calibrated rig."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

from fgpose.calibration.from_people.calibrated import CalibratedFromPeople
from fgpose.geometry.camera import CameraRig
from fgpose.people import PeopleObservations

Focal = Literal["known", "shared", "each"]
"""Focal lengths are those of the intrinsics; are unknown, one for all cameras of a model; or one for each camera."""
Progress = Callable[[int, int], None]
"""Called with the number of steps done and the number of steps in all."""


def calibrate(
    people: PeopleObservations,
    intrinsics: CameraRig,
    *,
    focal: Focal = "known",
    stature_m: float | None = None,
    distances: Sequence[tuple[str, str, float]] = (),
    synchronised: bool = False,
    progress: Progress | None = None,
) -> CalibratedFromPeople:
    """Calibrate cameras from nothing but people who walk through the scene."""
    raise NotImplementedError("the chain is put together from its parts")
