"""The paper's method: each frame alone, reprojection error with limb symmetry (eq. 3-5)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from fgpose.config import Config, MotionConfig, ProjectionConfig, SymmetryConfig
from fgpose.estimation.evidence.delays import of_one_moment
from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.evidence.gather import gather
from fgpose.estimation.evidence.inputs import check_inputs
from fgpose.estimation.segment import Segment
from fgpose.estimation.solvers.block_tridiagonal import one_blas_thread
from fgpose.estimation.solvers.optimum import optimum
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.reprojection import reprojection_residual_px
from fgpose.observations import Observations
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Convergence, Trajectory, joint_status

# Eq. 3 sums squared pixels over all views: no robust kernel, no weights.
_SQUARED_PIXELS = ProjectionConfig(sigma_px=1.0, kernel="none", weighting="uniform")
# A step of 1 um is a hundredth of the agreement that the tests ask for with an independent solution of eq. 5.
_STEP_TOLERANCE_M = 1e-6
_FRAMES_AT_ONCE = 32  # a step of twice as many takes as long for each


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
        TypeError: the observations are of several people, or the arguments are exchanged.
    """
    check_inputs("refine", observations, rig)
    config = config or Config()
    observations, rig = of_one_moment(observations, rig)
    return refine_evidence(gather(observations, rig, config), observations.skeleton, rig, config, progress)


@one_blas_thread()
def refine_evidence(
    evidence: Evidence,
    skeleton: Skeleton,
    rig: CameraRig,
    config: Config,
    progress: Callable[[int, int], None] | None = None,
) -> Trajectory:
    """refine for a recording whose evidence is gathered already."""
    segment = _segment(evidence, skeleton, rig, config)
    positions_m, convergences = np.full_like(evidence.fused_m, np.nan), list[Convergence]()
    for first in range(0, segment.n_frames, _FRAMES_AT_ONCE):
        frames = slice(first, min(first + _FRAMES_AT_ONCE, segment.n_frames))
        positions_m[frames], convergence = _optima(segment.frames(frames))
        convergences += convergence
        if progress:
            progress(frames.stop, segment.n_frames)
    return Trajectory(
        skeleton=skeleton,
        time_s=evidence.time_s,
        positions_m=positions_m,
        status=joint_status(segment.active, evidence.observed),
        residual_px=reprojection_residual_px(evidence.undistorted_px, rig, positions_m),
        camera_names=rig.names,
        convergence=Convergence.worst(convergences),
        config=config,
        implausible_frames=evidence.implausible_frames,
    )


def _optima(segment: Segment) -> tuple[Float[np.ndarray, "frame joint 3"], list[Convergence]]:
    """Of frames that know nothing of each other, solved together as they share the damping only; where that does not
    converge, in halves."""
    if not segment.active.any():
        return np.full(segment.start_m.shape, np.nan), []
    positions_m, _, convergence = optimum(segment)
    if convergence.converged or segment.n_frames == 1:
        return positions_m, [convergence]
    middle = segment.n_frames // 2
    halves = [_optima(segment.frames(half)) for half in (slice(0, middle), slice(middle, None))]
    return np.concatenate([each for each, _ in halves]), [one for _, each in halves for one in each]


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
        weights=np.broadcast_to(1.0, evidence.weights.shape),
        sigma_px=np.broadcast_to(_SQUARED_PIXELS.sigma_px, evidence.weights.shape),
        guess_m=evidence.fused_m,
        anchored=np.zeros_like(evidence.anchored),
        depth_sigma_m=np.broadcast_to(np.nan, evidence.depth_sigma_m.shape),
    )
    active = np.asarray(np.isfinite(evidence.fused_m).all(axis=-1))
    no_lengths_m, no_motion = np.full(skeleton.n_lengths, np.nan), np.ones(active.shape)
    return Segment(rig, skeleton, paper, unweighted, active, no_lengths_m, no_motion)
