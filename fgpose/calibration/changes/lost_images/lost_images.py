"""Whether images were lost again and again, told by joints that did not enter; and when, and how many."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from fgpose.calibration.changes.change import Change, Kind, later_s
from fgpose.calibration.changes.clock_changes import score
from fgpose.calibration.changes.comparison import Comparison
from fgpose.calibration.changes.credible import NOTICEABLE_FRAMES, is_of_several_seconds
from fgpose.calibration.changes.lag_costs import BLOCK_S, edges_as_good
from fgpose.calibration.changes.lost_images.clock_paths import Paths, clock_paths, jumps_beside
from fgpose.calibration.changes.lost_images.fine_costs import PER_IMAGE, FineCosts, fine_costs, together

_PARTS = 4  # of the joints


def lost_images(compared: Comparison, others: Sequence[Change]) -> list[Change]:
    """Jumps of the clocks of all cameras, if they suit better than what was found of clocks one by one; else none.

    One by one, clocks are measured by others that jump as well, and a clock of many jumps is nearest to one that
    drifts. Which part of the jumps all cameras have in common nothing tells, and nothing depends on it.

    Args:
        compared: on top of changes of poses.
        others: of clocks.
    """
    (costs,) = fine_costs(compared, 1)
    lag = _lags_of(others, costs)
    if not others and not jumps_beside(costs, lag):
        return []
    paths = clock_paths(costs)
    if not paths.n_jumps:
        return []
    if costs.total(lag).sum() - costs.total(paths.lag).sum() < paths.price:
        return []
    parts = fine_costs(compared, _PARTS)
    if len(parts) < 2:
        return []
    gain = _gain(parts, lag)
    return _as_changes(paths, costs, score(gain)) if is_of_several_seconds(gain) else []


def _gain(parts: Sequence[FineCosts], lag: Int[np.ndarray, "camera moment"]) -> Float[np.ndarray, " second"]:
    """By how much the joints of each part agree better with the paths of all others than with these lags."""
    gain, moments = np.zeros(lag.shape[1]), parts[0].moments
    reach = 0
    for number, judge in enumerate(parts):
        others = together([*parts[:number], *parts[number + 1 :]])
        paths = clock_paths(others)
        gain += judge.total(lag) - judge.total(paths.lag)
        reach = max(reach, int(np.ptp(paths.lag)))
    since_s = moments.time_s - moments.time_s[0]
    # So near to the beginning or the end some cameras have no image at the lags of others.
    gain[np.minimum(since_s, since_s[-1] - since_s) <= parts[0].step_s * reach] = 0.0
    return np.bincount((since_s / max(BLOCK_S, moments.length_s)).astype(int), gain)


def _lags_of(changes: Sequence[Change], costs: FineCosts) -> Int[np.ndarray, "camera moment"]:
    """In steps of the costs, by the common clock."""
    time_s = costs.moments.time_s
    lag_s = np.zeros((costs.n_cameras, len(time_s)))
    for c, own_s in enumerate(lag_s):
        for _ in range(3):  # a contraction: clocks drift by a small part
            own_s[:] = later_s(changes, c, time_s - own_s)
    return np.round(lag_s / costs.step_s).astype(int)


def _as_changes(paths: Paths, costs: FineCosts, reliability: float) -> list[Change]:
    """By the stamps of the cameras."""
    found: list[Change] = []
    image_s = PER_IMAGE * costs.step_s
    for c, start in enumerate(paths.lag[:, 0].tolist()):
        profile = costs.of_camera(c, paths.lag, [o for o in range(costs.n_cameras) if o != c])
        jumps = paths.jumps(c)
        firsts = [0, *(first for first, _ in jumps), len(profile)]
        sigmas = [_sigma(profile[begin:end]) for begin, end in pairwise(firsts)]
        late_s = costs.step_s * start
        if abs(late_s) > NOTICEABLE_FRAMES * image_s:
            sigma = costs.step_s * sigmas[0]
            found.append(Change(Kind.OFFSET, c, offset_s=late_s, sigma=sigma, reliability=reliability))
        for number, (first, frames) in enumerate(jumps):
            at_s = float(costs.moments.time_s[first]) - 0.5 * costs.moments.length_s
            part = slice(firsts[number], firsts[number + 2])
            between_s = _between_s(profile[part], paths.lag[c, [first - 1, first]], part.start, costs)
            found.append(
                Change(
                    Kind.JUMP,
                    c,
                    at_s=at_s - late_s,
                    between_s=(min(between_s[0], at_s - late_s), max(between_s[1], at_s - late_s)),
                    offset_s=frames * image_s,
                    sigma=costs.step_s * float(np.hypot(sigmas[number], sigmas[number + 1])),
                    reliability=reliability,
                )
            )
            late_s += frames * image_s
    return found


def _sigma(profile: Float[np.ndarray, "moment lag"]) -> float:
    """Standard deviation of a lag that these moments have in common, in steps."""
    total = profile.sum(axis=0)
    weight = np.exp(total.min() - total)
    lags = np.arange(len(total))
    mean = float(weight @ lags / weight.sum())
    return float(np.sqrt(weight @ (lags - mean) ** 2 / weight.sum() + 1 / 12))


def _between_s(
    profile: Float[np.ndarray, "moment lag"], lags: Int[np.ndarray, " 2"], begin: int, costs: FineCosts
) -> tuple[float, float]:
    """Within which times it goes over from the one lag to the other, by the moments of both."""
    before, after = (profile[:, int(lag) + costs.n_lags // 2] for lag in lags)
    first, last = edges_as_good(before, after)
    time_s, half_s = costs.moments.time_s, 0.5 * costs.moments.length_s
    return float(time_s[begin + first]) - half_s, float(time_s[min(begin + last, len(time_s) - 1)]) + half_s
