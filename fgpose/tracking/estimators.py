"""An estimator of each person."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module

import numpy as np
from jaxtyping import Float

from fgpose.config import Config
from fgpose.estimation.estimator import Estimator
from fgpose.estimation.online.arrivals import TooLateError
from fgpose.estimation.online.clock_offsets import RunningOffsets
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import BoneLengths, Skeleton
from fgpose.trajectory import Estimate


@dataclass(frozen=True, eq=False)
class NewDetections:
    """What is new of somebody, as the estimator takes it."""

    camera: str | None
    """Of an image that comes alone; None: one frame of several cameras."""
    time_s: float | Float[np.ndarray, " camera"]
    """Of the image, or of that of each camera (NaN: none)."""
    arrays: Mapping[str, np.ndarray]
    """Of the image, or of all cameras; see Estimator.update_arrays."""
    bones: BoneLengths | None = None
    """What is known of the bones of who has just been recognised."""


class Estimators:
    """The estimators of the people in a room, by the number of their track."""

    def __init__(self, rig: CameraRig, skeleton: Skeleton, config: Config) -> None:
        self._rig, self._skeleton, self._config = rig, skeleton, config
        self._of: dict[int, Estimator] = {}
        self.offsets = RunningOffsets(rig, config)
        """What everybody's motion tells of the cameras' clocks."""

    def update(self, newest: Mapping[int, NewDetections]) -> dict[int, Estimate]:
        """The pose of each of these; who is new gets an estimator, and who is not among them loses theirs."""
        self._of = {number: self._of.get(number) or self._new() for number in newest}
        return self.add(newest)

    def add(self, newest: Mapping[int, NewDetections]) -> dict[int, Estimate]:
        """The pose of each of these, who may be new; nobody is forgotten."""
        self._of |= {number: self._new() for number in newest if number not in self._of}
        return {number: _updated(self._of[number], new) for number, new in newest.items()}

    def tidy(self) -> None:
        """See Estimator."""
        for estimator in self._of.values():
            estimator.tidy()

    def _new(self) -> Estimator:
        needs = self._rig, self._skeleton, self._config, self.offsets
        return Estimator(*needs, times_are_checked=True, is_one_person=True)  # the tracker sees to both


def load_libraries() -> None:
    """Those that are loaded at their first use, a third of a second in which images would be lost."""
    for name in ("scipy.linalg", "scipy.optimize"):
        import_module(name)


def _updated(estimator: Estimator, new: NewDetections) -> Estimate:
    if new.bones is not None:
        estimator.know(new.bones)
    try:
        if new.camera is None:
            return estimator.update_arrays(new.time_s, **new.arrays)
        return estimator.update_camera(new.camera, float(new.time_s), **new.arrays)
    except TooLateError:
        # Each image joins the frame in the window that is nearest to its time, if one is near.
        for camera, time_s, arrays in [] if new.camera else _images(estimator.rig.names, new):
            with suppress(TooLateError):
                estimator.update_camera(camera, time_s, **arrays)
        assert estimator.newest is not None
        return estimator.newest


def _images(camera_names: Sequence[str], new: NewDetections) -> Iterator[tuple[str, float, dict[str, np.ndarray]]]:
    """The images of a frame of several cameras, in the order of time."""
    time_s = np.asarray(new.time_s)
    for c in np.argsort(time_s):
        if np.isfinite(time_s[c]):
            yield str(camera_names[c]), float(time_s[c]), {name: each[c] for name, each in new.arrays.items()}
