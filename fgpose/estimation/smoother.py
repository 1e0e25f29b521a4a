"""Batch smoothing of a whole recording, of any length."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from fgpose.config import Config
from fgpose.estimation.covariances.error_components import covariance_of_errors_m2, length_covariance_of_errors_m2
from fgpose.estimation.covariances.few_view_errors import widened
from fgpose.estimation.covariances.other_side import other_sides_m2
from fgpose.estimation.covariances.uncertainty import distrust_factor, speed_unseen_mps, with_swing
from fgpose.estimation.evidence.delays import image_motion_px, of_one_moment
from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.evidence.gathered import Gathered, gather_long
from fgpose.estimation.evidence.image_checks.left_out import with_left_out
from fgpose.estimation.evidence.inputs import check_inputs
from fgpose.estimation.evidence.other_bones import other_bone
from fgpose.estimation.evidence.presence import present
from fgpose.estimation.initial_guess import time_to_known_s
from fgpose.estimation.parts.batch import smooth_whole_body
from fgpose.estimation.segment import Recording, Segment
from fgpose.estimation.settling import settled
from fgpose.estimation.solution import Solution, SolvedWindows, first_known
from fgpose.estimation.solvers.block_tridiagonal import one_blas_thread
from fgpose.estimation.windows import Window, cut_windows
from fgpose.freed_memory import hand_back
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.vectors import norm
from fgpose.observations import Observations
from fgpose.sampling import spread_evenly
from fgpose.skeleton import BoneLengths, Skeleton
from fgpose.trajectory import Convergence, OtherBone, Status, Trajectory, joint_status

Progress = Callable[[int, int], None]
"""Called with the number of frames done and the number of frames in all."""

# Lengths learned from the sample are held, so that all windows have the same.
_HELD_LENGTH_SIGMA_M = 1e-4
_SAMPLE_FRAMES = 600  # spread over the recording: far apart, their errors are independent


def smooth(
    observations: Observations,
    rig: CameraRig,
    config: Config | None = None,
    progress: Progress | None = None,
    unfinished: Path | None = None,
    bones: BoneLengths | None = None,
) -> Trajectory:
    """The most probable motion given all frames, by batch optimisation of the factor graph.

    Detections that repeat those of the image before to the last digit are left out, and so are views while their
    detector has gone over to somebody else (fgpose.estimation.evidence.image_checks). They have visibility 0.

    A recording longer than solver.window_s is solved in overlapping windows, with bone lengths learned beforehand from
    frames spread over all of it, so that windows agree where they meet.

    Args:
        observations: of one person.
        rig: cameras of the observations, in their order.
        config: see fgpose.config; all sections except [online], [refinement] and [calibration] are used.
        progress: told after each window.
        unfinished: a folder for the windows that are solved, if there are several: after it was killed, the same call
            goes on from there. It is to be removed when the result is saved. None: nothing is kept.
        bones: of the same person, from an earlier recording (Trajectory.bones). If this one shows that they are
            somebody else's they are not used: Trajectory.other_bone.

    Returns:
        The trajectory of all frames, each at the mean time at which the cameras took it: by time stamps and time
        offsets. Where a camera's clock is more than 0.1 s from their mean, the images that were taken together make
        other frames than in the observations (on_common_clock). Its convergence says whether the optimiser settled in
        every window. Where nobody is there (before the first and after the last sighting, and between sightings farther
        apart than tracking.coast_s, see fgpose.estimation.evidence.presence) it is NaN: Trajectory.absent.

    Raises:
        ValueError: the cameras of the observations and of the rig differ, bones are not those of the skeleton, or a
            window that was kept is damaged.
        TypeError: the observations are of several people, or the arguments are exchanged.
        OSError: a window cannot be kept.

    Warns:
        UserWarning: a window did not converge within solver.max_iterations; windows were there already; or bones are
            somebody else's.
    """
    check_inputs("smooth", observations, rig)
    if bones is not None:
        bones.check(observations.skeleton)
    config = config or Config()
    observations, rig = of_one_moment(observations, rig)
    evidence = gather_long(observations, rig, config)
    smoothed = smooth_evidence(evidence, observations.skeleton, rig, config, progress, unfinished, bones)
    return with_left_out(smoothed, observations, rig, evidence.sides_exchanged)


@one_blas_thread()
def smooth_evidence(
    evidence: Evidence | Gathered,
    skeleton: Skeleton,
    rig: CameraRig,
    config: Config,
    progress: Progress | None = None,
    unfinished: Path | None = None,
    bones: BoneLengths | None = None,
) -> Trajectory:
    """smooth for a recording whose evidence is gathered already."""
    if skeleton.parts:
        smooth_part = partial(smooth_evidence, rig=rig, unfinished=unfinished)
        return smooth_whole_body(evidence, skeleton, rig, config, smooth_part, progress, bones)
    here = np.flatnonzero(evidence.present(config.tracking.coast_s))
    here = here if len(here) else np.arange(len(evidence.time_s))
    recording = Recording.of(evidence, here, rig, skeleton, config, bones)
    windows = cut_windows(recording.time_s, config.solver.window_s, config.solver.overlap_s)
    solved = SolvedWindows(recording, unfinished if len(windows) > 1 else None)
    if solved.n_solved:
        warnings.warn(
            f"{solved.n_solved} of {len(windows)} windows were solved by a run that did not end; it goes on from there",
            stacklevel=4,  # past the decorator and smooth
        )
        if progress:
            progress(windows[solved.n_solved - 1].contributed.stop, recording.n_frames)
    other = None
    # Where all windows are kept, whose bones they are is not.
    if solved.n_solved < len(windows) or bones is not None:
        whole = len(windows) == 1
        first, other = _first(recording.frames(windows[0].solved) if whole else _sample(recording), bones)
        if not whole:
            held_m = first_known([first.lengths_m, recording.lengths_m])
            held = BoneLengths(np.where(held_m > 0, held_m, np.nan), np.full_like(held_m, _HELD_LENGTH_SIGMA_M))
            recording = replace(recording, lengths_m=held_m, known=held)
        for window in windows[solved.n_solved :]:
            solution = first if whole else _solve(recording.frames(window.solved))
            solution = replace(solution, length_sigma_m=first.length_sigma_m)
            solved.append(solution.frames(window.contributed_of_solved))
            if progress:
                progress(window.contributed.stop, recording.n_frames)
    hand_back()
    joined = _Joined.of(recording, windows, solved)
    recording = replace(recording, guess_m=None)  # of an hour 88 MB
    return replace(_trajectory(recording, windows, solved, joined), other_bone=other)


def _sample(recording: Recording) -> Segment:
    """Frames whose bone lengths are learned, solved as a window is: hallucinated detections would stretch them.

    Delays are not corrected there, because the motion between frames so far apart is not known.
    """
    sample = recording.frames(spread_evenly(recording.n_frames, _SAMPLE_FRAMES))
    at_once = replace(sample.evidence, delay_s=np.zeros_like(sample.evidence.delay_s))
    return replace(sample, evidence=at_once, config=sample.config.replace(solver={"covariance": False}))


def _solve(segment: Segment) -> Solution:
    """The optimum, with covariances if they are wanted."""
    return _described(*settled(segment))


def _first(segment: Segment, bones: BoneLengths | None) -> tuple[Solution, OtherBone | None]:
    """With the standard deviations of the lengths. Those that were known are a prior of it, unless it shows without
    them that they are somebody else's: with them, what contradicts them could be taken for hallucinated."""
    alone, covariance_m2 = _solve_lengths(replace(segment, known=None))
    if bones is None:
        return alone, None
    other = other_bone(bones, alone.lengths_m, covariance_m2, segment.skeleton.length_names)
    if other is None:
        return _solve_lengths(segment)[0], None
    warnings.warn(f"the bones that were given are somebody else's, and are not used: {other}", stacklevel=5)
    return alone, other


def _solve_lengths(segment: Segment) -> tuple[Solution, Float[np.ndarray, "length length"]]:
    """The same, and the covariance of the lengths."""
    informed, solution = settled(segment)
    if not segment.active.any():
        unknown_m = np.full_like(solution.lengths_m, np.nan)
        return replace(solution, length_sigma_m=unknown_m), np.full(2 * solution.lengths_m.shape, np.nan)
    lengths_m = first_known([solution.lengths_m, informed.lengths_m])
    covariance_m2 = length_covariance_of_errors_m2(replace(informed, lengths_m=lengths_m), solution.positions_m)
    sigma_m = np.where(np.isfinite(solution.lengths_m), np.sqrt(np.diag(covariance_m2)), np.nan)
    return _described(informed, replace(solution, length_sigma_m=sigma_m)), covariance_m2


def _described(informed: Segment, solution: Solution) -> Solution:
    return _with_covariance(informed, solution) if informed.config.solver.covariance else solution


def _with_covariance(segment: Segment, solution: Solution) -> Solution:
    if not segment.active.any():
        return solution
    covariance_m2, lasting = covariance_of_errors_m2(segment, solution.positions_m)
    covariance_m2 = distrust_factor(segment.evidence.total_weight)[..., None, None] * covariance_m2
    known, people = (segment.evidence, solution.positions_m), (segment.rig, segment.skeleton)
    widened_m2 = widened(covariance_m2, *known, lasting, *people)
    widened_m2 = widened_m2 + other_sides_m2(*known, widened_m2, *people)
    return replace(solution, covariance_m2=widened_m2, widening_m2=widened_m2 - covariance_m2)


@dataclass(frozen=True, eq=False)
class _Joined:
    """Of all windows, in all frames: what decides who is there when, which needs the visibility of all."""

    positions_m: Float[np.ndarray, "all joint 3"]
    visibility: Float[np.ndarray, "all camera joint"]
    seen: Bool[np.ndarray, "frame joint"]
    """Of the frames of the recording, as those that follow. See Evidence."""
    observed: Bool[np.ndarray, "frame joint"]
    located: Bool[np.ndarray, " frame"]
    """Whether any joint is."""
    convergences: tuple[Convergence, ...]
    lengths_m: list[np.ndarray]
    sigmas_m: list[np.ndarray]

    @staticmethod
    def of(recording: Recording, windows: Sequence[Window], solved: SolvedWindows) -> _Joined:
        here, shape, n_frames = recording.here, recording.active.shape, len(recording.evidence.time_s)
        positions_m = np.full((n_frames, shape[1], 3), np.nan)
        # Nothing is known of it to seven digits, and it is a part of what a long recording leaves in memory.
        visibility = np.full((n_frames, recording.rig.n_cameras, shape[1]), np.nan, dtype=np.float32)
        (seen, observed), located = np.empty((2, *shape), dtype=bool), np.empty(shape[0], dtype=bool)
        convergences, lengths_m, sigmas_m = [], [], []
        for window, solution in zip(windows, solved, strict=True):
            own = window.contributed
            evidence = replace(recording.evidence_of(own), visibility=solution.visibility)
            positions_m[here[own]], visibility[here[own]] = solution.positions_m, evidence.detection_visibility
            seen[own], observed[own], located[own] = evidence.seen, evidence.observed, evidence.located.any(axis=1)
            convergences.append(solution.convergence)
            lengths_m.append(solution.lengths_m)
            sigmas_m.append(solution.length_sigma_m)
        _warn_unless_converged(convergences, recording.config)
        return _Joined(positions_m, visibility, seen, observed, located, tuple(convergences), lengths_m, sigmas_m)


def _trajectory(recording: Recording, windows: Sequence[Window], solved: SolvedWindows, joined: _Joined) -> Trajectory:
    """The result; what is of each window alone is made window by window."""
    rig, config, here, positions_m = recording.rig, recording.config, recording.here, joined.positions_m
    n_frames, n_joints = positions_m.shape[:2]
    unseen_s = time_to_known_s(joined.seen, recording.time_s)
    # Hallucinated detections, by what is known now, do not show that somebody is there.
    anybody = np.asarray(joined.seen.any(axis=1))
    is_there = present(anybody, joined.located, recording.time_s, config.tracking.coast_s)
    active = recording.active & (unseen_s <= config.motion.max_unseen_s) & is_there[:, None]
    frame, joint = np.nonzero(~active)
    positions_m[here[frame], joint] = np.nan
    residual_px = np.full(joined.visibility.shape, np.nan, dtype=np.float32)
    covariance_m2 = np.full((n_frames, n_joints, 3, 3), np.nan, np.float32) if config.solver.covariance else None
    speed_mps = speed_unseen_mps(positions_m, here, recording.time_s, anybody)
    for window, solution in zip(windows, solved, strict=True):
        own = window.contributed
        around = recording.evidence_of(window.solved)
        of_around_px = _residual_px(around, rig, positions_m[here[window.solved]])
        residual_px[here[own]] = of_around_px[window.contributed_of_solved]
        if covariance_m2 is not None and solution.covariance_m2 is not None:
            swing = unseen_s[own], recording.skeleton, config.swing, solution.widening_m2
            more = 1 - around.credible[window.contributed_of_solved], speed_mps[own]
            of_window_m2 = with_swing(solution.covariance_m2, positions_m[here[own]], *swing, *more)
            covariance_m2[here[own]] = np.where(active[own, :, None, None], of_window_m2, np.nan)
        hand_back()
    status = np.full((n_frames, n_joints), Status.UNOBSERVABLE, dtype=np.int8)
    status[here] = joint_status(active, joined.observed)
    return Trajectory(
        skeleton=recording.skeleton,
        time_s=recording.evidence.time_s,
        positions_m=positions_m,
        status=status,
        covariance_m2=covariance_m2,
        residual_px=residual_px,
        camera_names=rig.names,
        bone_lengths_m=first_known(joined.lengths_m),
        bone_length_sigma_m=first_known(joined.sigmas_m),
        convergence=Convergence.worst(joined.convergences),
        config=config,
        visibility=joined.visibility,
        implausible_frames=recording.evidence.implausible_frames,
    )


def _warn_unless_converged(windows: Sequence[Convergence], config: Config) -> None:
    n_astray = sum(not window.converged for window in windows)
    if n_astray:
        warnings.warn(
            f"the smoother has not converged within solver.max_iterations = {config.solver.max_iterations} in "
            f"{n_astray} of {len(windows)} windows; the largest errors may be centimetres",
            stacklevel=6,  # past _Joined.of, the decorator and smooth
        )


def _residual_px(
    evidence: Evidence, rig: CameraRig, positions_m: Float[np.ndarray, "frame joint 3"]
) -> Float[np.ndarray, "frame camera joint"]:
    """Distance between each detection and the projection of the joint at the time when the image was taken."""
    moved_px = image_motion_px(positions_m, evidence.time_s, evidence.delay_s, rig)
    return norm(rig.project(positions_m) + moved_px - evidence.undistorted_px)
