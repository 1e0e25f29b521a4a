"""Refinements that no bump explains: something else is wrong, and cameras were moved to make it look right."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.calibration.used_parts import Adjusted
from fgpose.config import Config
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate_robust
from fgpose.skeleton import Skeleton

BUMP_DEG, BUMP_M = 10.0, 0.15
"""What a bump does: more is another place."""
MOST_DEG, MOST_M = BUMP_DEG, 0.35
"""A camera that is kicked is not turned further. It moves by BUMP_M, but images of a second or two hardly tell a move
from a turn about the body: 5 degrees at 4 m are 35 cm."""
# Of limbs. Cameras that agree hold the size of the body; of two, one that is bumped changes the distance, and with it
# the size, by what one degree is of the angle between them.
_MOST_GROWTH, _MOST_GROWTH_OF_TWO = 0.05, 0.15


def refuse_large_moves(
    before: CameraRig,
    found: Adjusted,
    rotation_deg: Float[np.ndarray, " camera"],
    translation_m: Float[np.ndarray, " camera"],
    skeleton: Skeleton,
    config: Config,
) -> None:
    """Raise ValueError if a camera was moved by more than a bump does, or the body has another size then.

    Args:
        before: the cameras as they were calibrated.
        found: what they are said to be, and the detections that it rests on.
        rotation_deg: by how much each was turned; translation_m: and moved.
        skeleton: of the people.
        config: the parameters; fusion.inlier_px is used.
    """
    far = (rotation_deg > MOST_DEG) | (translation_m > MOST_M)
    growth = _growth(before, found, skeleton, config)
    most = _MOST_GROWTH if before.n_cameras > 2 else _MOST_GROWTH_OF_TWO
    if not far.any() and not abs(growth) > most:
        return
    moved = [
        f"would move camera {name} by {100 * move_m:.0f} cm and {turn_deg:.1f} degrees"
        for name, turn_deg, move_m in zip(before.names, rotation_deg.tolist(), translation_m.tolist(), strict=True)
        if turn_deg > MOST_DEG or move_m > MOST_M
    ]
    if abs(growth) > most:
        moved.append(f"would make the body {100 * abs(growth):.0f} % {'larger' if growth > 0 else 'smaller'}")
    raise ValueError(
        f"the calibration is not refined: this {' and '.join(moved)}, and a bump moves a camera by {100 * MOST_M:.0f} "
        f"cm and {MOST_DEG:.0f} degrees at most. Something else is wrong: keypoints of images of another size, "
        "exchanged cameras, another calibration? fgpose info tries such causes. Or more than one camera was moved: "
        "calibrate anew"
    )


def _growth(before: CameraRig, found: Adjusted, skeleton: Skeleton, config: Config) -> float:
    """Of the limbs, as a share of their lengths: median; NaN where they are not known with both rigs."""
    bones = [bone for pair in skeleton.limb_pairs for bone in pair] or list(skeleton.bones)
    if not bones:
        return np.nan
    start, end = np.array(bones).T
    lengths_m = []
    for rig in (before, found.rig):
        inlier_px = rig.in_own_px(config.fusion.inlier_px)
        joints_m = triangulate_robust(found.undistorted_px, found.confidence, rig, inlier_px).positions_m
        length_m = np.linalg.norm(joints_m[:, start] - joints_m[:, end], axis=-1)
        length_m[:, np.isfinite(length_m).sum(axis=0) == 0] = np.inf  # never known
        lengths_m.append(np.nanmedian(length_m, axis=0))
    before_m, after_m = lengths_m
    known = np.isfinite(before_m) & np.isfinite(after_m) & (before_m > 0)
    return float(np.median(after_m[known] / before_m[known])) - 1 if known.any() else np.nan
