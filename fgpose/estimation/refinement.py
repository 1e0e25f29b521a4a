"""The paper's method: each frame alone, reprojection error with limb symmetry (eq. 3-5)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from fgpose.config import Config, MotionConfig, ProjectionConfig, SymmetryConfig
from fgpose.estimation.evidence import Evidence
from fgpose.estimation.fusion import fuse
from fgpose.estimation.segment import Segment
from fgpose.estimation.solvers.gtsam_batch import GtsamBatch
from fgpose.estimation.solvers.levenberg_marquardt import levenberg_marquardt
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.reprojection import reprojection_residual_px
from fgpose.observations import Observations
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
    fused_m = fuse(observations, rig, config).positions_m
    segment = _segment(observations, rig, fused_m, config)
    positions_m = np.full_like(fused_m, np.nan)
    solutions = []
    for frame, active in enumerate(segment.active):
        if active.any():
            problem = GtsamBatch(segment.frames(slice(frame, frame + 1)))
            solution = levenberg_marquardt(problem, problem.initial(), config.solver.max_iterations)
            solutions.append(solution.convergence)
            positions_m[frame] = problem.positions_m(solution.state)[0]
        if progress:
            progress(frame + 1, observations.n_frames)
    return Trajectory(
        skeleton=observations.skeleton,
        time_s=observations.frame_time_s,
        positions_m=positions_m,
        status=joint_status(segment.active, observations.seen.sum(axis=1) >= 2),
        residual_px=reprojection_residual_px(observations, rig, positions_m),
        camera_names=rig.names,
        convergence=Convergence.worst(solutions),
        config=config,
    )


def _segment(
    observations: Observations, rig: CameraRig, fused_m: Float[np.ndarray, "frame joint 3"], config: Config
) -> Segment:
    """Eq. 3 and eq. 4, and weak priors around the fused pose."""
    n_frames, n_joints = fused_m.shape[:2]
    no_depth = np.full((n_frames, 0, n_joints), np.nan)
    evidence = Evidence(
        time_s=observations.frame_time_s,
        undistorted_px=rig.undistort(observations.points2d_px),
        weights=np.ones((n_frames, rig.n_cameras, n_joints)),
        n_views=observations.seen.sum(axis=1),
        guess_m=fused_m,
        anchored=np.zeros((n_frames, n_joints), dtype=bool),
        views_m=no_depth[..., None].repeat(3, axis=-1),
        rays=no_depth[..., None].repeat(3, axis=-1),
        depth_sigma_m=no_depth,
        delay_s=np.zeros((n_frames, rig.n_cameras)),
    )
    symmetry = SymmetryConfig(form="frame", sigma_m=1e-3 / config.refinement.px_per_mm)
    paper = replace(
        config,
        projection=_SQUARED_PIXELS,
        symmetry=symmetry,
        motion=MotionConfig(model="none"),
        solver=replace(config.solver, step_tolerance_m=_STEP_TOLERANCE_M),
    )
    active = np.asarray(np.isfinite(fused_m).all(axis=-1))
    no_lengths_m = np.full(observations.skeleton.n_lengths, np.nan)
    no_motion = np.ones((n_frames, n_joints))
    return Segment(
        rig, observations.skeleton, paper, evidence, active, no_lengths_m, config.prior.length_sigma_m, no_motion
    )
