"""An estimator of each person."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.config import Config
from fgpose.estimation.estimator import Estimator
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Estimate


@dataclass(frozen=True, eq=False)
class Newest:
    """What is new of somebody, as the estimator takes it."""

    camera: str | None
    """Of an image that comes alone; None: one frame of several cameras."""
    time_s: float | Float[np.ndarray, " camera"]
    """Of the image, or of that of each camera (NaN: none)."""
    arrays: Mapping[str, np.ndarray]
    """Of the image, or of all cameras; see Estimator.update_arrays."""


class Estimators:
    """The estimators of the people in a room, by the number of their track."""

    def __init__(self, rig: CameraRig, skeleton: Skeleton, config: Config) -> None:
        self._rig, self._skeleton, self._config = rig, skeleton, config
        self._of: dict[int, Estimator] = {}

    def update(self, newest: Mapping[int, Newest]) -> dict[int, Estimate]:
        """The pose of each of these; who is new gets an estimator, and who is not among them loses theirs."""
        self._of = {number: self._of.get(number) or self._new() for number in newest}
        return {number: _updated(self._of[number], new) for number, new in newest.items()}

    def _new(self) -> Estimator:
        return Estimator(self._rig, self._skeleton, self._config)


def _updated(estimator: Estimator, new: Newest) -> Estimate:
    if new.camera is None:
        return estimator.update_arrays(new.time_s, **new.arrays)
    return estimator.update_camera(new.camera, float(new.time_s), **new.arrays)
