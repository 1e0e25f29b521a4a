"""The paper's method: each frame alone, reprojection error with limb symmetry (eq. 3-5)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fgpose.config import Config, MotionConfig, ProjectionConfig, SymmetryConfig
from fgpose.estimation.evidence.delays import of_one_moment
from fgpose.estimation.evidence.evidence import Evidence, gather
from fgpose.estimation.segment import Segment
from fgpose.estimation.solvers.gtsam_batch import GtsamBatch
from fgpose.estimation.solvers.levenberg_marquardt import levenberg_marquardt
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.reprojection import reprojection_residual_px
from fgpose.observations import Observations
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Convergence, Trajectory, joint_status

# Eq. 3 sums squared pixels over all views: no robust kernel, no weights.
_SQUARED_PIXELS = ProjectionConfig(sigma_px=1.0, kernel="none", weighting="uniform")
# A step of 1 um is a hundredth of the agreement that the tests ask for with an independent solution of eq. 5.
_STEP_TOLERANCE_M = 1e-6


def refine(
    observations: Observations,
    rig: CameraRig,
    config: Config | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Trajectory:
    """The minimum of eq. 5 in every frame, started from the fused pose (eq. 1-2).

    Faithful to the paper: squared error, equal weights, no time. Eq. 5 leaves the unit of length open, see
    RefinementConfig. A joint that fewer than two views see is not determined by eq. 5; it stays near the fused pose.

    Raises:
        ValueError: the cameras of the observations and of the rig differ.
    """
    config = config or Config()
    observations, rig = of_one_moment(observations, rig)
    return refine_evidence(gather(observations, rig, config), observations.skeleton, rig, config, progress)


def refine_evidence(
    evidence: Evidence,
    skeleton: Skeleton,
    rig: CameraRig,
    config: Config,
    progress: Callable[[int, int], None] | None = None,
) -> Trajectory:
    """refine for a recording whose evidence is gathered already."""
    segment = _segment(evidence, skeleton, rig, config)
    positions_m = np.full_like(evidence.fused_m, np.nan)
    solutions = []
    for frame, active in enumerate(segment.active):
        if active.any():
            problem = GtsamBatch(segment.frames(slice(frame, frame + 1)))
            solution = levenberg_marquardt(problem, problem.initial(), config.solver.max_iterations)
            solutions.append(solution.convergence)
            positions_m[frame] = problem.positions_m(solution.state)[0]
        if progress:
            progress(frame + 1, segment.n_frames)
    return Trajectory(
        skeleton=skeleton,
        time_s=evidence.time_s,
        positions_m=positions_m,
        status=joint_status(segment.active, evidence.observed),
        residual_px=reprojection_residual_px(evidence.undistorted_px, rig, positions_m),
        camera_names=rig.names,
        convergence=Convergence.worst(solutions),
        config=config,
        implausible_frames=evidence.implausible_frames,
    )


def _segment(evidence: Evidence, skeleton: Skeleton, rig: CameraRig, config: Config) -> Segment:
    """Eq. 3 and eq. 4, and weak priors around the fused pose; all detections have equal weight, as in the paper."""
    paper = config.replace(
        projection=_SQUARED_PIXELS,
        symmetry=SymmetryConfig(form="frame", sigma_m=1e-3 / config.refinement.px_per_mm),
        motion=MotionConfig(model="none"),
        solver={"step_tolerance_m": _STEP_TOLERANCE_M},
    )
    unweighted = replace(
        evidence,
        weights=np.ones_like(evidence.weights),
        sigma_px=np.full_like(evidence.weights, _SQUARED_PIXELS.sigma_px),
        guess_m=evidence.fused_m,
        anchored=np.zeros_like(evidence.anchored),
        depth_sigma_m=np.full_like(evidence.depth_sigma_m, np.nan),
    )
    active = np.asarray(np.isfinite(evidence.fused_m).all(axis=-1))
    no_lengths_m, no_motion = np.full(skeleton.n_lengths, np.nan), np.ones(active.shape)
    return Segment(rig, skeleton, paper, unweighted, active, no_lengths_m, config.prior.length_sigma_m, no_motion)
