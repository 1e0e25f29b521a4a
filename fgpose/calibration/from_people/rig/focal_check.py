"""Whether focal lengths that were given are right: what the recording would make of each, were it unknown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.calibration.adjustment.problem import Bundle, BundleProblem, Linearized
from fgpose.calibration.adjustment.unknowns import FOCAL, N_OF_CAMERA, Unknowns
from fgpose.estimation.solvers.elimination import ReducedSystem

# A focal length in so many is that of another lens, resolution or mode, and then so far off (standard deviation).
_WRONG, _WRONG_BY = 0.1, 0.1
# Errors of detections last, and differ between views: in 24 simulated calibrations with right focal lengths the changes
# are 1.6 of their standard deviations (root mean square), and 4.6 at most.
_ERRORS = 2.0
# What is known less well is not known: who stays in one place looks alike at all focal lengths.
_KNOWN = 0.05


@dataclass(frozen=True, eq=False)
class FocalCheck:
    """By how much focal lengths that were given would change; shares of them, positive: it should be longer."""

    change: Float[np.ndarray, " camera"]
    sigma: Float[np.ndarray, " camera"]
    """Standard deviation of the change, if errors of detections were independent."""
    moves: Float[np.ndarray, "changed camera 6"]
    """By how much all cameras would move with each change, each in its own frame: rotation vector (radians), then
    translation (unit of the rig)."""

    @property
    def wrong(self) -> Float[np.ndarray, " camera"]:
        """Probability that each focal length is wrong: a mixture of two normal distributions of the change."""
        from scipy.stats import norm

        errors = _ERRORS * self.sigma
        log_wrong = np.log(_WRONG) + norm.logpdf(self.change, scale=np.hypot(errors, _WRONG_BY))
        log_right = np.log(1 - _WRONG) + norm.logpdf(self.change, scale=errors)
        return np.where(self.sigma < _KNOWN, 1 / (1 + np.exp(log_right - log_wrong)), 0.0)

    @property
    def covariance(self) -> Float[np.ndarray, "camera 6 camera 6"]:
        """Second moment of the errors of the poses that come of it."""
        return np.einsum("l,lci,ldj->cidj", self.wrong, self.moves, self.moves)


def check_focal(problem: BundleProblem, adjusted: Bundle) -> FocalCheck:
    """One Gauss-Newton step from a scene that was adjusted with the given focal lengths, for each camera with its own
    free: Rao's score test. Large changes are too small, as the step is that of a linear problem.

    All at once would be as bad as it is to estimate them all: those of a short walk move by tens of per cent.
    """
    # Most of the work, and the same whichever focal length is free.
    terms = problem.linearized(adjusted)
    reduced = problem.without_joints(terms)
    each = [_step(problem, adjusted, terms, reduced, c) for c in range(problem.unknowns.n_cameras)]
    steps, sigmas = zip(*each, strict=True)
    moves = np.stack(steps)
    return FocalCheck(np.einsum("cc->c", moves[:, :, FOCAL]), np.array(sigmas), moves[:, :, :6])


def _step(
    problem: BundleProblem, adjusted: Bundle, terms: Linearized, reduced: ReducedSystem, camera: int
) -> tuple[Float[np.ndarray, "camera 11"], float]:
    """Change of all cameras with the focal length of one, and the standard deviation of that."""
    held = problem.unknowns
    free = problem.with_unknowns(Unknowns.of(held.n_cameras, held.poses, ((camera,),), clocks=held.clocks))
    equations = free.equations(adjusted, reduced=reduced)
    step = equations.solve(-free.gradient(adjusted, terms))[: free.unknowns.n_shared]
    of_focal = free.unknowns.columns[N_OF_CAMERA * camera + FOCAL]
    sigma = np.sqrt(of_focal @ equations.covariance() @ of_focal)
    return free.unknowns.of_cameras(step), float(sigma)
