"""Batch smoothing of a whole recording, of any length."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from fgpose.config import Config
from fgpose.estimation.delays import image_motion_px
from fgpose.estimation.evidence import Evidence, gather
from fgpose.estimation.initial_guess import active_joints, fill_gaps, median_lengths, time_to_known_s
from fgpose.estimation.persistence import persistence_weights
from fgpose.estimation.process_noise import initial_density, is_adaptive, process_density
from fgpose.estimation.segment import Segment
from fgpose.estimation.solvers.gtsam_batch import GtsamBatch
from fgpose.estimation.solvers.levenberg_marquardt import Problem, State, Step, levenberg_marquardt
from fgpose.estimation.solvers.normal_equations import NormalEquations
from fgpose.estimation.uncertainty import doubt, with_correlated_errors, with_swing
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.sampling import spread_evenly, usual_step_s
from fgpose.trajectory import Convergence, Trajectory, joint_status

Progress = Callable[[int, int], None]
"""Called with the number of frames done and the number of frames in all."""

# Lengths learned from the sample are held: the windows then agree on them, and nothing is to be gained from each alone.
_HELD_LENGTH_SIGMA_M = 1e-4
_SAMPLE_FRAMES = 600  # spread over the recording: far apart, their errors are independent
# Where hardly any detection is distrusted, doing so would change nothing that can be seen.
_DISTRUSTED, _FEW = 0.5, 0.01
_DELAY_ROUNDS = 2
# A motion that is only to be learned from need not be known to the last millimetre.
_ROUGHLY = 50.0


@dataclass(frozen=True, eq=False)
class _Lengths:
    """What is known of the shared bone lengths before a window is solved."""

    lengths_m: Float[np.ndarray, " length"]
    sigma_m: float


@dataclass(frozen=True, eq=False)
class _Solved:
    positions_m: Float[np.ndarray, "frame joint 3"]
    covariance_m2: Float[np.ndarray, "frame joint 3 3"] | None
    lengths_m: Float[np.ndarray, " length"]
    convergence: Convergence


def smooth(
    observations: Observations, rig: CameraRig, config: Config | None = None, progress: Progress | None = None
) -> Trajectory:
    """The most probable motion given all frames, by batch optimisation of the factor graph.

    A recording longer than solver.window_s is solved in overlapping windows, with bone lengths learned beforehand from
    frames spread over all of it, so that windows agree where they meet.

    Raises:
        ValueError: the cameras of the observations and of the rig differ.
    """
    config = config or Config()
    evidence = gather(observations, rig, config)
    active = active_joints(evidence.guess_m, evidence.time_s, config.motion)
    evidence = replace(evidence, guess_m=fill_gaps(evidence.guess_m, evidence.time_s))
    skeleton = observations.skeleton

    def segment(frames: slice | np.ndarray, lengths: _Lengths) -> Segment:
        part = evidence.frames(frames), active[frames]
        density = np.full(active[frames].shape, initial_density(config.motion))
        return Segment(rig, skeleton, config, *part, lengths.lengths_m, lengths.sigma_m, density)

    spans = _spans(evidence.time_s, config.solver.window_s, config.solver.overlap_s)
    lengths = _Lengths(median_lengths(skeleton, evidence.guess_m), config.prior.length_sigma_m)
    if len(spans) > 1:
        sample = _sampled(segment(spread_evenly(observations.n_frames, _SAMPLE_FRAMES), lengths))
        lengths = _Lengths(_first_known([sample.lengths_m, lengths.lengths_m]), _HELD_LENGTH_SIGMA_M)
    solved = []
    for span in spans:
        solved.append(_cut(_solve(segment(span.solve, lengths), config.solver.covariance), span))
        if progress:
            progress(span.keep.stop, observations.n_frames)
    positions_m = np.concatenate([part.positions_m for part in solved])
    covariance_m2 = None
    if config.solver.covariance:
        linear_m2 = np.concatenate([part.covariance_m2 for part in solved if part.covariance_m2 is not None])
        unseen_s = time_to_known_s(evidence.seen, evidence.time_s)
        covariance_m2 = with_swing(linear_m2, positions_m, unseen_s, skeleton, config.swing)
    return Trajectory(
        skeleton=skeleton,
        time_s=evidence.time_s,
        positions_m=positions_m,
        status=joint_status(active, evidence.observed),
        covariance_m2=covariance_m2,
        residual_px=_residual_px(evidence, rig, positions_m),
        camera_names=rig.names,
        bone_lengths_m=_first_known([part.lengths_m for part in solved]),
        convergence=Convergence.worst([part.convergence for part in solved]),
        config=config,
    )


def _residual_px(
    evidence: Evidence, rig: CameraRig, positions_m: Float[np.ndarray, "frame joint 3"]
) -> Float[np.ndarray, "frame camera joint"]:
    """Distance between each detection and where the joint was when the image was taken."""
    moved_px = image_motion_px(positions_m, evidence.time_s, evidence.delay_s, rig)
    return np.linalg.norm(rig.project(positions_m) + moved_px - evidence.undistorted_px, axis=-1)


def _solve(segment: Segment, covariance: bool) -> _Solved:
    """A first solution tells by how much to move late detections, which to distrust, and how fast each joint moves;
    with that, the second one."""
    if not segment.active.any():
        return _nobody(segment)
    # Blocks of 100 x 100 are too small to share between cores: threads that wait for each other take 100 times as long.
    with threadpool_limits(limits=1, user_api="blas"):
        first = _roughly(segment) if is_adaptive(segment.config.motion) else segment
        solved = _optimized(first)
        for _ in range(_DELAY_ROUNDS if segment.evidence.delay_s.any() else 0):
            solved = _optimized(_from(solved, _on_time(first, solved)))
        on_time = _on_time(segment, solved)
        segment = _adapted(_trusting(on_time, solved), solved)
        if segment is not on_time:
            segment = _from(solved, segment)
            solved = _optimized(segment)
        if not covariance:
            return solved
        return replace(solved, covariance_m2=_covariance_m2(segment, solved))


def _sampled(segment: Segment) -> _Solved:
    """Frames far apart: the motion between them, by which delays would be undone, is not known."""
    if not segment.active.any():
        return _nobody(segment)
    with threadpool_limits(limits=1, user_api="blas"):
        return _optimized(segment)


def _nobody(segment: Segment) -> _Solved:
    shape = segment.active.shape
    no_lengths_m = np.full(segment.skeleton.n_lengths, np.nan)
    nobody_m, no_covariance_m2 = np.full((*shape, 3), np.nan), np.full((*shape, 3, 3), np.nan)
    return _Solved(nobody_m, no_covariance_m2, no_lengths_m, Convergence(True, 0, 0.0, 0.0))


def _covariance_m2(segment: Segment, solved: _Solved) -> Float[np.ndarray, "frame joint 3 3"]:
    chain, active = NormalEquations(segment), segment.active
    covariance_m2 = chain.covariance_m2(solved.positions_m)
    information = chain.frame_information(solved.positions_m)
    factor = doubt(segment.evidence.total_weight[active])
    step_s = usual_step_s(segment.evidence.time_s)
    correlated_m2 = with_correlated_errors(covariance_m2[active], information[active], step_s)
    covariance_m2[active] = factor[:, None, None] * correlated_m2
    return covariance_m2


def _optimized(segment: Segment) -> _Solved:
    solver = segment.config.solver
    if solver.backend == "chain":
        return _optimize(NormalEquations(segment), solver.max_iterations)
    return _optimize(GtsamBatch(segment), solver.max_iterations)


def _roughly(segment: Segment) -> Segment:
    """The segment with a wider tolerance."""
    solver = replace(segment.config.solver, step_tolerance_m=_ROUGHLY * segment.config.solver.step_tolerance_m)
    return replace(segment, config=replace(segment.config, solver=solver))


def _from(solved: _Solved, segment: Segment) -> Segment:
    """The segment with what was solved as its first guess."""
    guess_m = np.where(np.isnan(solved.positions_m), segment.evidence.guess_m, solved.positions_m)
    lengths_m = _first_known([solved.lengths_m, segment.lengths_m])
    return replace(segment, evidence=replace(segment.evidence, guess_m=guess_m), lengths_m=lengths_m)


def _on_time(segment: Segment, solved: _Solved) -> Segment:
    """The segment with its detections where they would be if all cameras were synchronous."""
    evidence = segment.evidence
    moved_px = image_motion_px(solved.positions_m, evidence.time_s, evidence.delay_s, segment.rig)
    return replace(segment, evidence=replace(evidence, undistorted_px=evidence.undistorted_px - moved_px))


def _trusting(segment: Segment, solved: _Solved) -> Segment:
    """The segment with less trust in detections that have not fitted for a while; itself where hardly any have not."""
    evidence, config = segment.evidence, segment.config.projection
    error_px = np.linalg.norm(segment.rig.project(solved.positions_m) - evidence.undistorted_px, axis=-1)
    trust = persistence_weights(error_px, evidence.time_s, config)
    if np.mean(trust < _DISTRUSTED) <= _FEW:
        return segment
    weights = np.maximum(evidence.weights * trust, config.min_weight)
    return replace(segment, evidence=replace(evidence, weights=weights))


def _adapted(segment: Segment, solved: _Solved) -> Segment:
    """The segment with the process noise that its motion calls for; itself where that is fixed."""
    if not is_adaptive(segment.config.motion):
        return segment
    density = process_density(solved.positions_m, segment.evidence.time_s, segment.config.motion)
    return replace(segment, process_density=density)


@runtime_checkable
class _SegmentProblem(Problem[State, Step], Protocol):
    """What the chain and the GTSAM window have in common."""

    def initial(self) -> State: ...

    def positions_m(self, state: State) -> Float[np.ndarray, "frame joint 3"]: ...

    def lengths_m(self, state: State) -> Float[np.ndarray, " length"]: ...


def _optimize(problem: _SegmentProblem[State, Step], max_iterations: int) -> _Solved:
    solution = levenberg_marquardt(problem, problem.initial(), max_iterations)
    return _Solved(problem.positions_m(solution.state), None, problem.lengths_m(solution.state), solution.convergence)


@dataclass(frozen=True)
class _Span:
    """The frames that a window solves, and those of them that it contributes."""

    solve: slice
    keep: slice


def _spans(time_s: Float[np.ndarray, " frame"], window_s: float, overlap_s: float) -> list[_Span]:
    """Windows that cover the recording; each sees overlap_s beyond the frames that it contributes."""
    duration_s = time_s[-1] - time_s[0]
    count = max(1, int(np.ceil(duration_s / window_s - 0.25)))  # a short rest is not worth a window
    cuts = np.searchsorted(time_s, time_s[0] + np.arange(1, count) * duration_s / count)
    edges = np.unique([0, *cuts.tolist(), len(time_s)])
    spans = []
    for start, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        before = int(np.searchsorted(time_s, time_s[start] - overlap_s)) if start else 0
        after = int(np.searchsorted(time_s, time_s[stop - 1] + overlap_s, side="right"))
        spans.append(_Span(slice(before, after), slice(start, stop)))
    return spans


def _first_known(lengths_m: list[np.ndarray]) -> Float[np.ndarray, " length"]:
    """Each length from the first that knows it: a person may come late."""
    known = lengths_m[0]
    for others in lengths_m[1:]:
        known = np.where(np.isnan(known), others, known)
    return known


def _cut(solved: _Solved, span: _Span) -> _Solved:
    keep = slice(span.keep.start - span.solve.start, span.keep.stop - span.solve.start)
    covariance_m2 = None if solved.covariance_m2 is None else solved.covariance_m2[keep]
    return _Solved(solved.positions_m[keep], covariance_m2, solved.lengths_m, solved.convergence)
