"""Trajectories as the marker files of motion analysis (TRC, C3D) know them: named points over time, no skeleton."""

from __future__ import annotations

import re
import warnings
from collections import Counter
from pathlib import Path

import numpy as np
from jaxtyping import Float

from fgpose.io.tables import one_line
from fgpose.sampling import frames_per_second, usual_step_s
from fgpose.shown.joint_meanings import meanings
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status, Trajectory

# Of a marker of Vicon and OptiTrack: Sub1:Nose.
_SUBJECT = re.compile(r"([^:]+):(.+)")
_MAX_NAMED = 4
# Of a frame whose time a constant rate cannot hold. Times rounded to milliseconds, and most jitter, are below.
_NOTICED_INTERVALS = 0.2


def without_subject(markers: list[str], path: Path) -> list[str]:
    """Names without the subject that Vicon and OptiTrack put before them, if it is the same of all that have one:
    Sub1:Nose is Nose. Those of several subjects keep it: they are different people, or things.

    Warns:
        UserWarning: there are several subjects; it names them.
    """
    found = {marker: match for marker in markers if (match := _SUBJECT.fullmatch(marker))}
    counts = Counter(match[1] for match in found.values())
    if len(counts) > 1:
        named = [f"{subject} ({n})" for subject, n in counts.most_common(_MAX_NAMED)]
        whose = ", ".join(named) + (", ..." if len(counts) > _MAX_NAMED else "")
        warnings.warn(
            f"{path}: its markers are of several subjects: {whose}. They keep these before their names, so none is "
            "taken for a joint; export the subject that is wanted alone",
            stacklevel=5,
        )
        return markers
    alone = [found[marker][2].strip() if marker in found else marker for marker in markers]
    return alone if len(set(alone)) == len(set(markers)) else markers


def without_zeros(
    markers: list[str], positions: Float[np.ndarray, "frame marker 3"], path: Path
) -> Float[np.ndarray, "frame marker 3"]:
    """NaN where a marker is at exactly (0, 0, 0), in any unit: no marker is there to the last digit, but many programs
    write so what they have not seen.

    Warns:
        UserWarning: there are such; how many, and of which markers.
    """
    zero = (positions == 0).all(axis=-1)
    if not zero.any():
        return positions
    names = [marker for marker, its in zip(markers, zero.any(axis=0), strict=True) if its]
    named = ", ".join(names[:_MAX_NAMED]) + (f" and {len(names) - _MAX_NAMED} more" if len(names) > _MAX_NAMED else "")
    warnings.warn(
        f"{path}: {zero.sum()} of {zero.size} positions are exactly (0, 0, 0), of {named}: they are taken for missing",
        stacklevel=5,
    )
    return np.where(zero[..., None], np.nan, positions)


def markers_to_trajectory(
    markers: list[str],
    time_s: Float[np.ndarray, " frame"],
    positions_m: Float[np.ndarray, "frame marker 3"],
) -> Trajectory:
    """A trajectory whose skeleton is the markers alone, without bones; its root is the pelvis, the hips or the first.

    Joints have the names that their markers mean (joint_meanings). A marker is observed where all three coordinates are
    known, otherwise NaN.

    Raises:
        ValueError: there is no marker, or two have the same name.
    """
    if not markers:
        raise ValueError("it holds no marker")
    markers = [one_line(marker) or f"marker_{n}" for n, marker in enumerate(markers, 1)]
    joints = meanings(markers)
    known = np.asarray(np.isfinite(positions_m).all(axis=-1))
    return Trajectory(
        skeleton=Skeleton("markers", joints, bones=(), root=_root(joints)),
        time_s=time_s,
        positions_m=np.where(known[..., None], positions_m, np.nan),
        status=np.where(known, int(Status.OBSERVED), int(Status.UNOBSERVABLE)),
    )


def _root(joints: tuple[str, ...]) -> tuple[int, ...]:
    for root in (("pelvis",), ("left_hip", "right_hip")):
        if set(root) <= set(joints):
            return tuple(joints.index(joint) for joint in root)
    return (0,)


def constant_rate_hz(time_s: Float[np.ndarray, " frame"]) -> float:
    """Frames per second, over the whole recording without its gaps; 1 where there are fewer than two frames.

    Raises:
        ValueError: the times do not increase.
    """
    if len(time_s) < 2:
        return 1.0
    interval_s = usual_step_s(time_s)
    if not interval_s > 0:
        raise ValueError(f"time_s must increase to have a frame rate, its median interval is {interval_s:g} s")
    return frames_per_second(time_s)


def in_whole_frames(trajectory: Trajectory, rate_hz: float, at_most: int) -> Trajectory:
    """The same with frames of nobody where frames are missing, for formats that have a rate and no times: then each
    frame is at its time within half an interval.

    As it is where two frames are closer than that, and where it would have more frames than at_most.
    """
    since = (trajectory.time_s - trajectory.time_s[:1]) * rate_hz
    if not trajectory.n_frames or not since[-1] < at_most - 0.5:
        return trajectory
    frames = np.rint(since).astype(int)
    if frames[-1] + 1 == len(frames) or (np.diff(frames) < 1).any():
        return trajectory
    all_s = trajectory.time_s[0] + np.arange(frames[-1] + 1) / rate_hz
    all_s[frames] = trajectory.time_s
    return trajectory.in_frames(all_s, frames)


def warn_of_uneven_times(time_s: Float[np.ndarray, " frame"], rate_hz: float, path: Path, file_format: str) -> None:
    """Of a format without times: say where those of frames differ from what the rate implies, counted from the first.

    Warns:
        UserWarning: a frame is off by more than a fifth of an interval.
    """
    off_s = time_s - time_s[0] - np.arange(len(time_s)) / rate_hz
    if np.abs(off_s).max() * rate_hz <= _NOTICED_INTERVALS:
        return
    intervals_s, worst = np.diff(time_s), int(np.argmax(np.abs(off_s)))
    warnings.warn(
        f"{path}: {file_format} holds a constant frame rate, {rate_hz:.4g} Hz is written; the true intervals are "
        f"{intervals_s.min():.4g} to {intervals_s.max():.4g} s, and frame {worst} is {1000 * abs(off_s[worst]):.3g} ms "
        f"{'later' if off_s[worst] > 0 else 'earlier'} than the file says; TRC, parquet and npz hold all times",
        UserWarning,
        stacklevel=4,
    )
