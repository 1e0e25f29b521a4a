"""What two trajectories have in common: joints by what their names mean, frames by time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.sampling import nearest
from fgpose.shown.joint_meanings import found_among
from fgpose.skeleton import Skeleton


@dataclass(frozen=True)
class CommonJoints:
    """The joints that two skeletons have, in the order of the estimate's."""

    names: tuple[str, ...]
    """As the estimate calls them."""
    estimate: tuple[int, ...]
    """Their indices there."""
    reference: tuple[int, ...]
    """And there."""


def common_joints(estimate: Skeleton, reference: Skeleton) -> CommonJoints:
    """The joints whose names mean the same (joint_meanings): RHip of one is right_hip of the other.

    Raises:
        ValueError: there is none; the message shows both sides.
    """
    partner = found_among(estimate.joints, reference.joints)
    own = tuple(np.flatnonzero(partner >= 0).tolist())
    if not own:
        raise ValueError(
            f"no joint in common: the estimate has {', '.join(estimate.joints)}; "
            f"the reference has {', '.join(reference.joints)}"
        )
    return CommonJoints(tuple(estimate.joints[joint] for joint in own), own, tuple(partner[list(own)].tolist()))


def same_times(
    estimate_s: Float[np.ndarray, " frame"], reference_s: Float[np.ndarray, " reference"]
) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the pairs of frames that are each other's nearest in time and no farther apart than half the shorter
    of the two (median) frame intervals. Both empty where there is none.

    Args:
        estimate_s: increasing, seconds; so is the other.
    """
    if len(estimate_s) == 0 or len(reference_s) == 0:
        return np.empty(0, dtype=int), np.empty(0, dtype=int)
    partner = nearest(estimate_s, reference_s)
    mutual = nearest(reference_s, estimate_s)[partner] == np.arange(len(estimate_s))
    intervals_s = [np.median(np.diff(time_s)) for time_s in (estimate_s, reference_s) if len(time_s) > 1]
    tolerance_s = 0.5 * min(intervals_s, default=0.0)
    kept = np.flatnonzero(mutual & (np.abs(estimate_s - reference_s[partner]) <= tolerance_s))
    return kept, partner[kept]
