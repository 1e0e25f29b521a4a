"""The optimum of some frames, with what follows from it for the evidence: delays, hallucinated detections, noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from fgpose.config import Config
from fgpose.estimation.evidence.delays import motion_m
from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.process_noise import process_density
from fgpose.estimation.segment import Segment
from fgpose.estimation.solution import Solution, first_known
from fgpose.estimation.solvers.optimum import optimum
from fgpose.estimation.visibility.sole_views import with_distances
from fgpose.estimation.visibility.visibility import judged
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton

# What follows from a solution has settled when a step is shorter than so many tolerances.
_ROUGHLY = 50.0
# Before they decide which detections are hallucinated, the joints must lie near the optimum of all detections: sooner,
# good detections next to hallucinated ones lose their weight too. On the tuning clips of the benchmark 2, 4, 6 and 15
# steps differ by less than 0.4 mm, and 15 need a third more factorisations.
_FIRST_STEPS = 6
# The weights that follow from two solutions may lead from one to the other for ever.
_MOST_ROUNDS = 12


def settled(segment: Segment) -> tuple[Segment, Solution]:
    """Alternate between a step to the optimum and the delays, hallucinated detections and process noise that follow
    from it (as expectation-maximisation does), until both have settled; then go to the optimum."""
    solution, visibility = _steps(segment, _FIRST_STEPS), None
    for _ in range(_MOST_ROUNDS):
        solution = _steps(_informed(segment, solution, visibility), 1)
        visibility = solution.visibility
        if solution.convergence.converged:
            break
    informed = _informed(segment, solution, visibility)
    return informed, _optimum(informed)


def _steps(segment: Segment, count: int) -> Solution:
    """So many steps of the optimiser, or fewer if it converges to a wider tolerance."""
    tolerance_m = _ROUGHLY * segment.config.solver.step_tolerance_m
    rough = segment.config.replace(solver={"step_tolerance_m": tolerance_m, "max_iterations": count})
    return _optimum(replace(segment, config=rough))


def _informed(
    segment: Segment, solution: Solution, visibility: Float[np.ndarray, "frame camera joint"] | None
) -> Segment:
    """The segment informed by a solution: the solution is the first guess, and the evidence and each joint's process
    noise follow from its motion."""
    evidence = replace(segment.evidence, sigma_px=solution.sigma_px)
    positions_m, config = solution.positions_m, segment.config
    known = informed(evidence, positions_m, segment.rig, segment.skeleton, config, visibility)
    # From a path that lost a fast limb the optimiser would not find back, and its accelerations are too small.
    positions_m = np.where(np.isnan(known.off_path_m), positions_m, known.off_path_m)
    information = known.information(positions_m, segment.rig)
    lengths_m = first_known([solution.lengths_m, segment.lengths_m])
    return replace(
        segment,
        evidence=with_distances(known, positions_m, lengths_m, segment.rig, segment.skeleton),
        initial_m=np.where(np.isnan(positions_m), evidence.guess_m, positions_m),
        lengths_m=lengths_m,
        process_density=process_density(positions_m, evidence.time_s, information, config.motion),
    )


def informed(
    evidence: Evidence,
    positions_m: Float[np.ndarray, "frame joint 3"],
    rig: CameraRig,
    skeleton: Skeleton,
    config: Config,
    visibility: Float[np.ndarray, "frame camera joint"] | None = None,
) -> Evidence:
    """The evidence with what a motion tells about it: detections are moved to the time of their frame and lose their
    bias, and hallucinated ones lose weight.

    Args:
        evidence: as gathered, with the standard deviations with which the motion was found.
        positions_m: as estimated from it; NaN where a joint is not estimated.
        rig, skeleton, config: what it was gathered with.
        visibility: probability that each detection is of its joint, if that is known already.
    """
    moved_m = motion_m(positions_m, evidence.time_s, evidence.delay_s)
    on_time = evidence.on_time(positions_m, moved_m, rig)
    if config.visibility.model == "none":
        return on_time
    return judged(on_time, positions_m, rig, skeleton, config, visibility)


def _optimum(segment: Segment) -> Solution:
    if not segment.active.any():
        return Solution.of_nobody(segment)
    evidence, (positions_m, lengths_m, convergence) = segment.evidence, optimum(segment)
    return Solution(positions_m, None, lengths_m, convergence, evidence.visibility, evidence.sigma_px)
