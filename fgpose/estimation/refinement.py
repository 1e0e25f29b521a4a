"""The paper's method: each frame alone, reprojection error with limb symmetry (eq. 3-5)."""

from __future__ import annotations

from collections.abc import Callable

import gtsam
import numpy as np
from jaxtyping import Bool, Float

from fgpose.config import Config, ProjectionConfig, SymmetryConfig
from fgpose.estimation import frame_factors
from fgpose.estimation.evidence import Evidence, gather
from fgpose.estimation.keys import position_key
from fgpose.estimation.solvers.gtsam_problem import GraphProblem
from fgpose.estimation.solvers.levenberg_marquardt import Solution, levenberg_marquardt
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.reprojection import reprojection_residual_px
from fgpose.observations import Observations
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Convergence, Trajectory, joint_status

# Eq. 3 sums squared pixels of all views alike: no robust kernel, no weights.
_SQUARED_PIXELS = ProjectionConfig(sigma_px=1.0, kernel="none", weighting="uniform")
# A mean step of 1 um is a hundredth of the agreement that the tests ask for with an independent solution of eq. 5.
_STEP_TOLERANCE_M = 1e-6


def refine(
    observations: Observations,
    rig: CameraRig,
    config: Config | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Trajectory:
    """The minimum of eq. 5 in every frame, started from the fused pose (eq. 1-2).

    Faithful to the paper: squared error, all views alike, no time. Eq. 5 leaves the unit of length open, see
    RefinementConfig. A joint that fewer than two views see is not determined by eq. 5; it stays near the fused pose.

    Raises:
        ValueError: the cameras of the observations and of the rig differ.
    """
    config = config or Config()
    return refine_evidence(gather(observations, rig, config), observations.skeleton, rig, config, progress)


def refine_evidence(
    evidence: Evidence,
    skeleton: Skeleton,
    rig: CameraRig,
    config: Config,
    progress: Callable[[int, int], None] | None = None,
) -> Trajectory:
    """refine for a recording whose evidence is gathered already."""
    fused_m, undistorted_px = evidence.fused_m, evidence.undistorted_px
    positions_m = np.full_like(fused_m, np.nan)
    solutions = []
    for frame in range(len(fused_m)):
        active = np.asarray(np.isfinite(fused_m[frame]).all(axis=-1))
        if active.any():
            problem = _frame_problem(rig, skeleton, undistorted_px[frame], fused_m[frame], active, config)
            solution = _solve(problem, fused_m[frame], active, config.solver.max_iterations)
            solutions.append(solution.convergence)
            positions_m[frame, active] = gtsam.utilities.extractPoint3(solution.state)
        if progress:
            progress(frame + 1, len(fused_m))
    active = np.asarray(np.isfinite(positions_m).all(axis=-1))
    return Trajectory(
        skeleton=skeleton,
        time_s=evidence.time_s,
        positions_m=positions_m,
        status=joint_status(active, evidence.observed),
        residual_px=reprojection_residual_px(undistorted_px, rig, positions_m),
        camera_names=rig.names,
        convergence=Convergence.worst(solutions),
        config=config,
    )


def _frame_problem(
    rig: CameraRig,
    skeleton: Skeleton,
    undistorted_px: Float[np.ndarray, "camera joint 2"],
    fused_m: Float[np.ndarray, "joint 3"],
    active: Bool[np.ndarray, " joint"],
    config: Config,
) -> GraphProblem:
    weights = np.ones(undistorted_px.shape[:2])
    symmetry = SymmetryConfig(form="frame", sigma_m=1e-3 / config.refinement.px_per_mm)
    graph = gtsam.NonlinearFactorGraph()
    for factor in frame_factors.projection_factors(rig, 0, undistorted_px, weights, active, _SQUARED_PIXELS):  # eq. 3
        graph.add(factor)
    for factor in frame_factors.symmetry_factors(skeleton, 0, active, symmetry):  # eq. 4
        graph.add(factor)
    joints = np.flatnonzero(active).tolist()
    for factor in frame_factors.prior_factors(0, joints, fused_m, config.prior, with_velocity=False):
        graph.add(factor)
    return GraphProblem(graph, _STEP_TOLERANCE_M)


def _solve(
    problem: GraphProblem, fused_m: np.ndarray, active: np.ndarray, max_iterations: int
) -> Solution[gtsam.Values]:
    initial = gtsam.Values()
    for joint in np.flatnonzero(active).tolist():
        initial.insert(position_key(joint, 0), fused_m[joint])
    return levenberg_marquardt(problem, initial, max_iterations)
