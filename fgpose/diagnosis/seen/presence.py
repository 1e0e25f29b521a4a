"""When nobody is seen, or by one camera only."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.diagnosis.examined import Examined
from fgpose.finding import Code, Finding, Severity
from fgpose.sampling import usual_step_s

# Less is a detector that misses somebody in a few images.
_LEAST_S, _LEAST_SHARE = 1.0, 0.02
_FEWEST_JOINTS = 3  # fewer are no body
_AT_MOST = 4  # intervals that are listed

Interval = tuple[float, float]


def nobody(examined: Examined) -> list[Finding]:
    """Stretches of time without anybody, and those that one camera sees alone."""
    time_s, n_cameras = cameras_with_somebody(examined)
    # Of one person, others may have been there.
    who = "The person is" if examined.association is None else "Nobody is"
    if examined.rig.n_cameras < 2:
        return _absent(time_s, n_cameras, who)
    return [*_absent(time_s, n_cameras, who), *_alone(time_s, n_cameras)]


def cameras_with_somebody(examined: Examined) -> tuple[Float[np.ndarray, " frame"], Int[np.ndarray, " frame"]]:
    """The time of each frame of the whole recording, and how many cameras see somebody then."""
    if examined.association is None:
        return examined.main.frame_time_s, _shows(examined.main.seen).sum(axis=1)
    time_s = examined.association.frames.frame_time_s
    shown = np.zeros((len(time_s), examined.rig.n_cameras), dtype=bool)
    for person, seen in examined.people.items():
        shown[examined.association.people[person].frames] |= _shows(seen.seen)
    return time_s, shown.sum(axis=1)


def _shows(seen: Bool[np.ndarray, "frame camera joint"]) -> Bool[np.ndarray, "frame camera"]:
    return np.asarray(seen.sum(axis=-1) >= min(_FEWEST_JOINTS, seen.shape[-1]))


def _absent(time_s: Float[np.ndarray, " frame"], n_cameras: Int[np.ndarray, " frame"], who: str) -> list[Finding]:
    intervals, share = _intervals(time_s, np.asarray(n_cameras == 0))
    if not intervals:
        return []
    return [
        Finding(
            Code.NOBODY,
            Severity.NOTE,
            f"{who} in no image in {100 * share:.0f} % of the time: {_listed(intervals)}",
            "There are no results there. If that is not true, is the detector's threshold too high?",
            0.3 * share,
            from_s=intervals[0][0],
            to_s=intervals[-1][1],
            numbers={"share": share},
        )
    ]


def _alone(time_s: Float[np.ndarray, " frame"], n_cameras: Int[np.ndarray, " frame"]) -> list[Finding]:
    intervals, share = _intervals(time_s, np.asarray(n_cameras == 1))
    if not intervals:
        return []
    return [
        Finding(
            Code.FEW_CAMERAS,
            Severity.DOUBTFUL,
            f"One camera alone sees anybody in {100 * share:.0f} % of the time: {_listed(intervals)}",
            "How far away somebody is, one camera hardly tells. Did the others stop, or was the person outside?",
            0.5 * share,
            from_s=intervals[0][0],
            to_s=intervals[-1][1],
            numbers={"share": share},
        )
    ]


def _intervals(time_s: Float[np.ndarray, " frame"], chosen: Bool[np.ndarray, " frame"]) -> tuple[list[Interval], float]:
    """Of at least a second, and their share of the recording; none if it is small."""
    step_s = usual_step_s(time_s) if len(time_s) > 1 else 0.0
    edges = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]).astype(int)))
    found = [(float(time_s[a]), float(time_s[b - 1] + step_s)) for a, b in edges.reshape(-1, 2).tolist()]
    found = [(a, b) for a, b in found if b - a >= _LEAST_S]
    duration_s = float(time_s[-1] - time_s[0]) + step_s
    share = sum(b - a for a, b in found) / max(duration_s, 1e-9)
    return (found, share) if share > _LEAST_SHARE else ([], 0.0)


def _listed(intervals: list[Interval]) -> str:
    longest = sorted(sorted(intervals, key=lambda each: each[0] - each[1])[:_AT_MOST])
    more = len(intervals) - len(longest)
    listed = ", ".join(f"{a:.1f} to {b:.1f} s" for a, b in longest)
    return listed + (f" and {more} shorter ones" if more else "")
