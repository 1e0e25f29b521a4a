"""People who are others in a mirror or a window."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.diagnosis.finished import FinishedRecording
from fgpose.finding import Code, Finding, Severity
from fgpose.sampling import spread_evenly
from fgpose.trajectory import Trajectory

# Of two people who have nothing to do with each other, what is not explained is more than the motion of either; who
# imitates somebody in a dance is late, and has another body.
_UNEXPLAINED_SHARE, _LEAST_S = 0.25, 2.0
_MOST_FRAMES = 2000


def reflections(recording: FinishedRecording) -> list[Finding]:
    """People who move as somebody else does in a plane mirror: two cameras that see the image of a mirror agree on
    somebody behind it."""
    # The cameras that see a mirror see who stands before it, too.
    by_views = sorted(recording.people, key=lambda person: -_n_views(recording.people[person]))
    shares = {
        (image, real): _unexplained_share(recording.people[real], recording.people[image])
        for real, image in combinations(by_views, 2)
    }
    return [
        Finding(
            Code.REFLECTION,
            Severity.DOUBTFUL,
            f"person {image} moves as person {real} does in a plane mirror, left and right exchanged: that explains "
            f"{100 * (1 - share):.0f} % of how the limbs move",
            "Is there a mirror or a window? Leave this person out, and cover the mirror.",
            0.5,
            person=image,
        )
        for (image, real), share in shares.items()
        if share < _UNEXPLAINED_SHARE
    ]


def _n_views(trajectory: Trajectory) -> int:
    """In how many images joints are detected."""
    seen = trajectory.observed if trajectory.visibility is None else np.isfinite(trajectory.visibility)
    return int(seen.sum())


def _unexplained_share(one: Trajectory, other: Trajectory) -> float:
    """Which share of the motion of somebody's joints around their body is not that of somebody else's, reflected in the
    plane that fits best; inf if they are not there together for long enough."""
    _, of_one, of_other = np.intersect1d(one.time_s, other.time_s, return_indices=True)
    if len(of_one) < 2 or one.time_s[of_one[-1]] - one.time_s[of_one[0]] < _LEAST_S:
        return np.inf
    # All frames of an hour take 90 MB for each of eight arrays, for every two people.
    some = spread_evenly(len(of_one), _MOST_FRAMES)
    of_one, of_other = of_one[some], of_other[some]
    # What a detector calls left is on the side on which it sees it.
    one_m, other_m = one.positions_m[of_one], other.positions_m[of_other][:, one.skeleton.mirror]
    known = np.asarray(np.isfinite(one_m + other_m).all(axis=-1))
    if not known.any():
        return np.inf
    off_m = (other_m - one_m)[known]
    # A mirror moves all points along its normal.
    normal = np.linalg.eigh(off_m.T @ off_m)[1][:, -1]
    around_one_m, around_other_m = (_less_mean(each_m, known, axis=1) for each_m in (one_m, other_m))
    reflected_m = around_one_m - 2 * (around_one_m @ normal)[..., None] * normal
    motion_m = _less_mean(around_other_m, known, axis=0)[known]
    return float(np.sum((around_other_m - reflected_m)[known] ** 2) / max(np.sum(motion_m**2), 1e-12))


def _less_mean(
    positions_m: Float[np.ndarray, "frame joint 3"], known: Bool[np.ndarray, "frame joint"], axis: int
) -> Float[np.ndarray, "frame joint 3"]:
    total_m = np.where(known[..., None], positions_m, 0.0).sum(axis=axis, keepdims=True)
    return positions_m - total_m / np.maximum(known.sum(axis=axis, keepdims=True), 1)[..., None]
