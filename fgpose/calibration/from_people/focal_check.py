"""Whether focal lengths that were given are right: what the recording would make of each, were it unknown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.calibration.from_people.elimination import Eliminated
from fgpose.calibration.from_people.projection import FOCAL
from fgpose.calibration.from_people.scene import SceneState
from fgpose.calibration.from_people.scene_problem import SceneProblem
from fgpose.calibration.from_people.unknowns import Unknowns


@dataclass(frozen=True, eq=False)
class FocalCheck:
    """By how much focal lengths that were given would change; shares of them, positive: it should be longer."""

    change: Float[np.ndarray, " camera"]
    sigma: Float[np.ndarray, " camera"]
    """Standard deviation of the change."""


def check_focal(problem: SceneProblem, adjusted: SceneState) -> FocalCheck:
    """One Gauss-Newton step from a scene that was adjusted with the given focal lengths, for each camera with its own
    free: Rao's score test. Large changes are too small, as the step is that of a linear problem.

    All at once would be as bad as it is to estimate them all: those of a short walk move by tens of per cent.
    """
    found = [_step(problem, adjusted, c) for c in range(problem.unknowns.n_cameras)]
    change, sigma = np.array(found).T
    return FocalCheck(change, sigma)


def _step(problem: SceneProblem, adjusted: SceneState, camera: int) -> tuple[float, float]:
    """Change of the focal length of a camera, and its standard deviation."""
    held = problem.unknowns
    unknowns = Unknowns.of(held.n_cameras, held.n_lengths, ((camera,),), clocks=held.clocks)
    free = problem.with_unknowns(unknowns)
    equations = Eliminated(free.equations(adjusted))
    step = equations.solve(-free.gradient(adjusted))[: unknowns.n_shared]
    covariance = unknowns.camera_covariance(equations.shared_covariance())
    change = unknowns.of_cameras(step)[camera, FOCAL]
    return float(change), float(np.sqrt(covariance[camera, FOCAL, camera, FOCAL]))
