"""Whether focal lengths that were given are right: what the recording would make of each, were it unknown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.calibration.adjustment.problem import Bundle, BundleProblem
from fgpose.calibration.adjustment.unknowns import FOCAL, Unknowns


@dataclass(frozen=True, eq=False)
class FocalCheck:
    """By how much focal lengths that were given would change; shares of them, positive: it should be longer."""

    change: Float[np.ndarray, " camera"]
    sigma: Float[np.ndarray, " camera"]
    """Standard deviation of the change."""


def check_focal(problem: BundleProblem, adjusted: Bundle) -> FocalCheck:
    """One Gauss-Newton step from a scene that was adjusted with the given focal lengths, for each camera with its own
    free: Rao's score test. Large changes are too small, as the step is that of a linear problem.

    All at once would be as bad as it is to estimate them all: those of a short walk move by tens of per cent.
    """
    found = [_step(problem, adjusted, c) for c in range(problem.unknowns.n_cameras)]
    change, sigma = np.array(found).T
    return FocalCheck(change, sigma)


def _step(problem: BundleProblem, adjusted: Bundle, camera: int) -> tuple[float, float]:
    """Change of the focal length of a camera, and its standard deviation."""
    held = problem.unknowns
    free = problem.with_unknowns(Unknowns.of(held.n_cameras, held.poses, ((camera,),), clocks=held.clocks))
    step = free.equations(adjusted).solve(-free.gradient(adjusted))[: free.unknowns.n_shared]
    change = free.unknowns.of_cameras(step)[camera, FOCAL]
    return float(change), float(np.sqrt(free.covariance(adjusted)[camera, FOCAL, camera, FOCAL]))
