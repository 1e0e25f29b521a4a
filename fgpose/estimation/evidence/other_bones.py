"""Whether somebody has other bones than were known of them: then it is somebody else."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from fgpose.skeleton import BoneLengths
from fgpose.trajectory import OtherBone

# Ten lengths then differ by 2.2 standard deviations each, or one by 6.9; their squares sum to 48. On the benchmark
# those of the same person sum to 3 at most. Other grown men pass (benchmarks/README.md).
_BY_CHANCE = 1e-6


def other_bone(
    known: BoneLengths,
    seen_m: Float[np.ndarray, " length"],
    covariance_m2: Float[np.ndarray, "length length"],
    names: Sequence[str],
) -> OtherBone | None:
    """The bone that differs most from what was known, where bones do by more than chance; None: they may be the same.

    Args:
        known: from before.
        seen_m: as estimated without that; NaN: not estimated.
        covariance_m2: of these; NaN where it is not determined.
        names: of the lengths.
    """
    from scipy.special import chdtrc

    both = np.isfinite(known.lengths_m) & np.isfinite(seen_m) & np.isfinite(covariance_m2).all(axis=1)
    away_m = (seen_m - known.lengths_m)[both]
    between_m2 = covariance_m2[np.ix_(both, both)] + np.diag(known.sigma_m[both] ** 2)
    squared = float(away_m @ np.linalg.solve(between_m2, away_m))
    if not (both.any() and chdtrc(len(away_m), squared) < _BY_CHANCE):
        return None
    sigmas = np.abs(away_m) / np.sqrt(np.diag(between_m2))
    number = int(np.flatnonzero(both)[sigmas.argmax()])
    return OtherBone(names[number], float(known.lengths_m[number]), float(seen_m[number]), float(sigmas.max()))


def without_known(
    known: BoneLengths,
    lengths_m: Float[np.ndarray, " length"],
    covariance_m2: Float[np.ndarray, "length length"],
    in_graph_m2: Float[np.ndarray, "length length"],
) -> tuple[Float[np.ndarray, " length"], Float[np.ndarray, "length length"]]:
    """What an estimate and its covariance would be without what was known, which was a prior of it.

    Args:
        known: the prior.
        lengths_m: the estimate.
        covariance_m2: of its errors.
        in_graph_m2: by which the graph has weighed detections against the prior.
    """
    is_known = np.isfinite(known.lengths_m)
    of_known = np.where(is_known, 1 / np.where(is_known, known.sigma_m, 1.0) ** 2, 0.0)
    information = np.linalg.inv(in_graph_m2)
    without_m2 = np.linalg.inv(information - np.diag(of_known))
    by_estimate = without_m2 @ information
    of_prior_m2 = in_graph_m2 @ (of_known[:, None] * in_graph_m2)
    return (
        by_estimate @ lengths_m - without_m2 @ (of_known * np.nan_to_num(known.lengths_m)),
        by_estimate @ (covariance_m2 - of_prior_m2) @ by_estimate.T,
    )
