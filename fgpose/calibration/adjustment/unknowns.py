"""The unknowns of the cameras: which of them are free, and which are shared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

N_OF_CAMERA = 11
"""Changes of a camera from what it was given as: rotation vector (radians) and translation (metres) in its own frame,
log of the focal length, k1, principal point (share of the diagonal of the image), time offset (seconds)."""
ROTATION, TRANSLATION, FOCAL, RADIAL, CENTRE, OFFSET = slice(0, 3), slice(3, 6), 6, 7, slice(8, 10), 10
POSE = slice(0, 6)

Groups = Sequence[Sequence[int]]
"""Cameras that share a lens."""

# How the damping of a metre acts on unknowns of other units: an image moves as much by 1 / 4.5 rad, or by that relative
# change of the focal length, as by a metre at 4.5 m.
DISTANCE_M = 4.5


@dataclass(frozen=True, eq=False)
class Unknowns:
    """What is free: a column for each unknown, with the changes of all cameras as rows."""

    columns: Float[np.ndarray, "row shared"]
    poses: Sequence[int]
    """Cameras whose pose is free."""
    focal: Groups
    """Each shares one focal length that is free."""
    radial: Groups
    """Each shares one k1 that is free."""
    centres: Sequence[int]
    """Cameras whose principal point is free."""
    clocks: bool
    """Whether time offsets are free, but for that of the first camera."""

    @staticmethod
    def of(
        n_cameras: int,
        poses: Sequence[int],
        focal: Groups = (),
        radial: Groups = (),
        centres: Sequence[int] = (),
        *,
        clocks: bool = False,
    ) -> Unknowns:
        """See the attributes."""
        cells = [[(c, row)] for c in poses for row in range(POSE.start, POSE.stop)]
        cells += [[(c, FOCAL) for c in group] for group in focal]
        cells += [[(c, RADIAL) for c in group] for group in radial]
        cells += [[(c, row)] for c in centres for row in range(CENTRE.start, CENTRE.stop)]
        cells += [[(c, OFFSET)] for c in range(1, n_cameras) if clocks]
        columns = np.zeros((N_OF_CAMERA * n_cameras, len(cells)))
        for column, members in enumerate(cells):
            columns[[N_OF_CAMERA * c + row for c, row in members], column] = 1.0
        return Unknowns(columns, poses, focal, radial, centres, clocks)

    @property
    def n_cameras(self) -> int:
        return len(self.columns) // N_OF_CAMERA

    @property
    def n_shared(self) -> int:
        return self.columns.shape[1]

    @property
    def scale_m2(self) -> Float[np.ndarray, " shared"]:
        """Squared metres that a unit of each unknown moves what a camera sees by, roughly."""
        of_camera = np.ones(N_OF_CAMERA)
        of_camera[[*range(ROTATION.start, ROTATION.stop), FOCAL, *range(CENTRE.start, CENTRE.stop)]] = DISTANCE_M**2
        return np.max(np.tile(of_camera, self.n_cameras)[:, None] * self.columns, axis=0, initial=0.0)

    def of_cameras(self, shared: Float[np.ndarray, " shared"]) -> Float[np.ndarray, "camera 11"]:
        return (self.columns @ shared).reshape(-1, N_OF_CAMERA)
