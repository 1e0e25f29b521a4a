"""Which unknowns of cameras and bones are free, and which are shared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.calibration.from_people.projection import CENTRE, FOCAL, N_OF_CAMERA, OFFSET, RADIAL, ROTATION

Groups = Sequence[Sequence[int]]
"""Cameras that share a lens."""

# How the damping of a metre acts on unknowns of other units: an image moves as much by 1 / 4.5 rad, or by that relative
# change of the focal length, as by a metre at 4.5 m.
_DISTANCE_M = 4.5


@dataclass(frozen=True, eq=False)
class Unknowns:
    """What is free: a column for each unknown, with the unknowns of all cameras and then the lengths as rows."""

    columns: Float[np.ndarray, "row shared"]
    n_cameras: int
    focal: Groups
    """Each shares one focal length that is free."""
    radial: Groups
    """Each shares one k1 that is free."""
    centres: Sequence[int]
    """Cameras whose principal point is free."""
    clocks: bool
    """Whether time offsets are free."""

    @staticmethod
    def of(
        n_cameras: int,
        n_lengths: int,
        focal: Groups = (),
        radial: Groups = (),
        centres: Sequence[int] = (),
        *,
        clocks: bool = False,
    ) -> Unknowns:
        """Lengths, poses and offsets of all cameras but the first, a focal length and k1 for each group."""
        cells = [[(c, row)] for c in range(1, n_cameras) for row in range(6)]
        cells += [[(c, FOCAL) for c in group] for group in focal]
        cells += [[(c, RADIAL) for c in group] for group in radial]
        cells += [[(c, row)] for c in centres for row in range(CENTRE.start, CENTRE.stop)]
        cells += [[(c, OFFSET)] for c in range(1, n_cameras) if clocks]
        columns = np.zeros((N_OF_CAMERA * n_cameras + n_lengths, len(cells) + n_lengths))
        for column, members in enumerate(cells):
            columns[[N_OF_CAMERA * c + row for c, row in members], column] = 1.0
        columns[N_OF_CAMERA * n_cameras :, len(cells) :] = np.eye(n_lengths)
        return Unknowns(columns, n_cameras, focal, radial, centres, clocks)

    @property
    def n_shared(self) -> int:
        return self.columns.shape[1]

    @property
    def n_lengths(self) -> int:
        return len(self.columns) - N_OF_CAMERA * self.n_cameras

    @property
    def scale_m2(self) -> Float[np.ndarray, " shared"]:
        """Squared metres that a unit of each unknown moves what a camera sees by, roughly."""
        of_camera = np.ones(N_OF_CAMERA)
        of_camera[[*range(ROTATION.start, ROTATION.stop), FOCAL, *range(CENTRE.start, CENTRE.stop)]] = _DISTANCE_M**2
        rows = np.ones(len(self.columns))
        rows[: N_OF_CAMERA * self.n_cameras] = np.tile(of_camera, self.n_cameras)
        return np.max(rows[:, None] * self.columns, axis=0, initial=0.0)

    def of_cameras(self, shared: Float[np.ndarray, " shared"]) -> Float[np.ndarray, "camera 11"]:
        return (self.columns @ shared)[: N_OF_CAMERA * self.n_cameras].reshape(-1, N_OF_CAMERA)

    def of_lengths(self, shared: Float[np.ndarray, " shared"]) -> Float[np.ndarray, " length"]:
        return (self.columns @ shared)[N_OF_CAMERA * self.n_cameras :]

    def camera_covariance(self, shared: Float[np.ndarray, "shared shared"]) -> Float[np.ndarray, "camera 11 camera 11"]:
        """Of all unknowns of all cameras; zero for what is held."""
        of_cameras = self.columns[: N_OF_CAMERA * self.n_cameras]
        covariance = of_cameras @ shared @ of_cameras.T
        return covariance.reshape(self.n_cameras, N_OF_CAMERA, self.n_cameras, N_OF_CAMERA)
