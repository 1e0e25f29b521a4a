"""People at the times of a camera's images."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from fgpose.overlay.drawing import Pose
from fgpose.sampling import between_images, nearest
from fgpose.trajectory import Trajectory


class Moments:
    """Everybody at each of these times: positions linear between two frames, the rest of the nearer one.

    Args:
        people: by number.
        time_s: of the images.
    """

    def __init__(self, people: Mapping[int, Trajectory], time_s: Float[np.ndarray, " image"]) -> None:
        self._people = people
        self._positions_m = {n: between_images(each.time_s, each.positions_m, time_s) for n, each in people.items()}
        self._nearest = {n: nearest(time_s, each.time_s) for n, each in people.items()}

    def poses(self, image: int) -> list[Pose]:
        """Of everybody of whom something is estimated then."""
        found = []
        for person, trajectory in self._people.items():
            positions_m, frame = self._positions_m[person][image], self._nearest[person][image]
            if np.isfinite(positions_m).any():
                covariance_m2 = None if trajectory.covariance_m2 is None else trajectory.covariance_m2[frame]
                found.append(Pose(person, positions_m, trajectory.status[frame], covariance_m2))
        return found
