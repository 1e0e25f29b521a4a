"""Cameras whose image stands still while others move."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.diagnosis.examined import Examined
from fgpose.diagnosis.seen.repeated import repeats
from fgpose.finding import Code, Finding, Severity

_LEAST_FRAMES, _LEAST_S = 8, 0.3
_OTHERS_MOVE = 0.5  # in so many of these frames another camera shows something new


def frozen_cameras(examined: Examined) -> list[Finding]:
    """The same keypoints to the last digit for long."""
    found = []
    for person, seen in examined.people.items():
        same, judged = repeats(seen)
        for c, name in enumerate(seen.camera_names):
            others = [o for o in range(seen.n_cameras) if o != c]
            others_new = np.asarray((judged & ~same)[:, others].any(axis=1))
            runs = _runs(same[:, c], others_new, seen.frame_time_s)
            if runs:
                found.append(_finding(name, runs, examined.number(person)))
    return found


def _runs(
    same: Bool[np.ndarray, " frame"], others_new: Bool[np.ndarray, " frame"], time_s: Float[np.ndarray, " frame"]
) -> list[tuple[float, float]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(int)))
    runs = [(first - 1, last - 1) for first, last in edges.reshape(-1, 2).tolist()]  # with the image that is repeated
    return [
        (float(time_s[first]), float(time_s[last]))
        for first, last in runs
        if last - first >= _LEAST_FRAMES
        and time_s[last] - time_s[first] >= _LEAST_S
        and np.mean(others_new[first + 1 : last + 1]) > _OTHERS_MOVE
    ]


def _finding(name: str, runs: list[tuple[float, float]], person: int | None) -> Finding:
    start_s, end_s = max(runs, key=lambda run: run[1] - run[0])
    total_s = sum(b - a for a, b in runs)
    more = f", the longest of {len(runs)} such times" if len(runs) > 1 else ""
    return Finding(
        Code.FROZEN_CAMERA,
        Severity.WRONG,
        f"The image of {name} stands still from {start_s:.2f} to {end_s:.2f} s{more}: its keypoints are the same to "
        "the last digit while other cameras show motion",
        "The camera or its recorder hung. Leave these images of it out, or record again.",
        0.7,
        camera=name,
        person=person,
        from_s=start_s,
        to_s=end_s,
        numbers={"total_s": total_s},
    )
