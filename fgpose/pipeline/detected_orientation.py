"""Whether keypoints are of images as recorded, or of upright ones, where the calibration knows that cameras lie on
their side: the orientation in which the views agree."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

from fgpose.geometry.camera import CameraRig
from fgpose.geometry.reprojection import reprojection_residual_px
from fgpose.geometry.triangulation import triangulate_robust
from fgpose.geometry.turned_images import turn_images
from fgpose.io.calibration import load_quarter_turns
from fgpose.observations import Observations
from fgpose.sampling import spread_evenly

_MAX_FRAMES = 100
# In the wrong orientation joints are off by hundreds of pixels; half as much is clearly better.
_BETTER = 0.5


def as_detected(rig: CameraRig, calibration: Path, seen_by: Callable[[CameraRig], Observations]) -> CameraRig:
    """The cameras of the images in which the keypoints were detected.

    Args:
        rig: the cameras of the images as recorded.
        calibration: their file, which may say by how much caliscope turned the images of each (rotation_count).
        seen_by: what these cameras saw of one person.

    Warns:
        UserWarning: the keypoints are of turned images.

    Raises:
        ValueError: the keypoints cannot be read.
        OSError: a file cannot be read.
    """
    turns = {name: turn for name, turn in load_quarter_turns(calibration).items() if name in rig.names}
    if not turns or rig.n_cameras < 2:
        return rig
    turned = turn_images(rig, turns)
    which = [rig.names.index(name) for name in turns]
    as_recorded_px, upright_px = (_residual_px(each, seen_by(each), which) for each in (rig, turned))
    if not upright_px < _BETTER * as_recorded_px:
        return rig
    warnings.warn(
        f"{calibration}: the keypoints of {', '.join(turns)} are of images turned as rotation_count says (so the views "
        f"agree to {upright_px:.0f} px, as recorded to {as_recorded_px:.0f} px): the calibration is turned alike",
        stacklevel=3,
    )
    return turned


def _residual_px(rig: CameraRig, seen: Observations, cameras: list[int]) -> float:
    """Median distance of the joints in these cameras from where all views together have them; infinite if none can be
    triangulated."""
    frames = spread_evenly(seen.n_frames, _MAX_FRAMES)
    undistorted_px = rig.undistort(seen.points2d_px[frames])
    positions_m = triangulate_robust(undistorted_px, seen.confidence[frames], rig).positions_m
    residual_px = reprojection_residual_px(undistorted_px, rig, positions_m)[:, cameras]
    known = residual_px[np.isfinite(residual_px)]
    return float(np.median(known)) if len(known) else float("inf")
