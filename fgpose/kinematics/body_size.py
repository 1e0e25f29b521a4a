"""How long the legs of a body are, which tells the unit of lengths."""

from __future__ import annotations

import numpy as np

from fgpose.kinematics.landmarks import landmarks, points_of
from fgpose.trajectory import Trajectory


def leg_length(trajectory: Trajectory) -> float:
    """Length of a thigh and a shank together, in the unit of the positions: the median over frames and sides; NaN where
    the skeleton has no legs or they are never known."""
    points = points_of(trajectory.positions_m, landmarks(trajectory.skeleton))
    lengths = [
        np.linalg.norm(points[f"{side}_hip"] - points[f"{side}_knee"], axis=-1)
        + np.linalg.norm(points[f"{side}_knee"] - points[f"{side}_ankle"], axis=-1)
        for side in ("left", "right")
        if {f"{side}_{joint}" for joint in ("hip", "knee", "ankle")} <= points.keys()
    ]
    known = np.concatenate(lengths) if lengths else np.zeros(0)
    known = known[np.isfinite(known)]
    return float(np.median(known)) if len(known) else float("nan")
