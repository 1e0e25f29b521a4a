"""What is known of a hand or a face before it is estimated: where it hangs, its bones, the noise of its detections."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from jaxtyping import Float

from fgpose.config import Config
from fgpose.skeleton import BodyPart, Skeleton
from fgpose_factors.robust_statistics import robust_sigma

# How far apart two joints are that stand for one place (a wrist and the root of a hand), until a recording tells it.
_APART_M = 0.02
_ENOUGH = 30  # frames that tell it
# The errors of an estimate last for about so long: as many frames together tell what one does.
_CORRELATED_S = 0.2


def apart_m(away_m: Float[np.ndarray, "frame 3"]) -> float:
    """How far the joint of a part and that of the body on which it hangs are apart, as a standard deviation.

    Args:
        away_m: the joint of the part, as triangulated alone, from that of the body; NaN: not known.
    """
    away_m = away_m[np.isfinite(away_m).all(axis=-1)]
    if len(away_m) < _ENOUGH:
        return _APART_M
    lasting_m = np.median(away_m, axis=0)
    return float(np.hypot(robust_sigma(away_m - lasting_m), np.abs(lasting_m).max()))


def place_covariance_m2(
    covariance_m2: Float[np.ndarray, "frame 3 3"], apart: float, step_s: float
) -> Float[np.ndarray, "frame 3 3"]:
    """How surely a part is where a joint of the body is, as if errors of different frames were independent.

    Args:
        covariance_m2: of the joint of the body.
        apart: see apart_m.
        step_s: usual time from frame to frame.
    """
    return max(1.0, _CORRELATED_S / step_s) * (covariance_m2 + apart**2 * np.eye(3))


def alone(part: BodyPart, skeleton: Skeleton) -> Skeleton:
    """The skeleton of a part, whose root is where it hangs: its own bones; of a rigid set of points, those that carry
    it, all joined."""
    own = skeleton.of_joints(part.estimated, f"{skeleton.name}: {part.name}", part.hangs_on[1])
    if not part.carried_by:
        return own
    return Skeleton(own.name, own.joints, list(combinations(range(own.n_joints), 2)), own.root, own.left_right)


def config_of(part: BodyPart, config: Config) -> Config:
    """With the standard deviations of a part in place of those of a body."""
    sigmas = {
        "projection": ("sigma_px",),
        "visibility": ("sigma_m", "hallucinated_m"),
        "symmetry": ("sigma_m",),
    }
    return config.replace(
        **{
            section: {name: part.relative_sigma * getattr(getattr(config, section), name) for name in names}
            for section, names in sigmas.items()
        }
    )
