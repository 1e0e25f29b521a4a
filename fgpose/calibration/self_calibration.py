"""Where the cameras are and how much their clocks are off, both from the recording itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.calibration.rig_refinement import RigRefinement, refine_rig
from fgpose.calibration.time_offsets import TimeOffsets, estimate_time_offsets
from fgpose.config import Config
from fgpose.estimation.smoother import smooth
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations

# Where the reprojection error of a detection counts half; beyond, it counts ever less.
_FIT_PX = 12.0


@dataclass(frozen=True, eq=False)
class SelfCalibration:
    """A rig whose cameras agree better in place and time."""

    rig: CameraRig
    observations: Observations
    """The observations, their per-view 3D moved with the cameras that saw it."""
    refinement: RigRefinement
    time_offsets: TimeOffsets


def self_calibrate(observations: Observations, rig: CameraRig, config: Config | None = None) -> SelfCalibration:
    """Refine the poses of the cameras and estimate their time offsets, in turns.

    A camera that is late and one that was moved look alike while the person walks in one direction, and what is done
    first explains both. So both orders are tried, and the one that fits the detections better counts.

    Raises:
        ValueError: see refine_rig and estimate_time_offsets.
    """
    config = config or Config()
    starts_s = rig.time_offsets_s, estimate_time_offsets(observations, rig, config).offsets_s
    candidates = [_turn(observations, rig, start_s, config) for start_s in starts_s]
    best = min(candidates, key=lambda candidate: _misfit(candidate, config))
    return _turn(observations, rig, best.rig.time_offsets_s, config)


def _turn(
    observations: Observations, rig: CameraRig, offsets_s: Float[np.ndarray, " camera"], config: Config
) -> SelfCalibration:
    """Poses with these offsets, then offsets with these poses."""
    # Always from the poses as they were given: the prior holds for those.
    refinement = refine_rig(observations, rig.with_time_offsets(offsets_s), config)
    offsets = estimate_time_offsets(refinement.observations, refinement.rig, config)
    return SelfCalibration(offsets.rig, refinement.observations, refinement, offsets)


def _misfit(calibration: SelfCalibration, config: Config) -> float:
    """Robust (Geman-McClure) reprojection error of the smoothed motion, and what the prior says of the moves."""
    residual_px = smooth(calibration.observations, calibration.rig, config).residual_px
    assert residual_px is not None
    squared = (residual_px[np.isfinite(residual_px)] / _FIT_PX) ** 2
    prior, moves = config.calibration, calibration.refinement
    moved = (moves.rotation_deg / prior.rotation_sigma_deg) ** 2 + (
        moves.translation_m / prior.translation_sigma_m
    ) ** 2
    looks = prior.independent_looks * len(moved)
    return looks * float(np.mean(squared / (1 + squared))) + 0.5 * float(np.sum(np.log1p(moved)))
