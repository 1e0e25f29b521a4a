"""Estimating by how much each camera's clock is off, from the recording itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.config import Config
from fgpose.estimation.clock_offsets import (
    CORRELATION_S,
    offset_change_s,
    offset_information,
    offset_sigma_s,
    prior_gradient,
)
from fgpose.estimation.delays import on_time_px
from fgpose.estimation.noise import correlated_frames
from fgpose.estimation.smoother import smooth
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.sampling import usual_step_s

_MAX_ROUNDS = 6
_TOLERANCE_FRAMES = 0.03
_MAX_DURATION_S = 30.0


@dataclass(frozen=True, eq=False)
class TimeOffsets:
    """How much later than its time stamps say each camera takes its images, the first camera's clock being right."""

    offsets_s: Float[np.ndarray, " camera"]
    sigma_s: Float[np.ndarray, " camera"]
    """Standard deviation; zero for the first camera, near 0.1 s where there was no motion to tell."""
    rig: CameraRig
    """The rig with these offsets."""


def estimate_time_offsets(observations: Observations, rig: CameraRig, config: Config | None = None) -> TimeOffsets:
    """Constant time offset of every camera but the first.

    Joints that move are seen too far ahead or behind by a camera whose clock is off, by the velocity of their image
    times the offset. In turns the motion is estimated with the offsets so far (fgpose.smooth), and the offsets from the
    reprojection errors that it leaves; in that step the joints are free to move along (Schur complement), without
    which it would take many more rounds. At most half a minute in the middle of the recording is used.

    Raises:
        ValueError: the cameras of the observations and of the rig differ.
    """
    config = config or Config()
    observations.check_cameras(rig.names)
    part = _middle(observations)
    step_s = usual_step_s(part.frame_time_s)
    information = np.zeros((rig.n_cameras, rig.n_cameras))
    for _ in range(_MAX_ROUNDS):
        information, gradient = _of_recording(part, rig, config)
        change_s = offset_change_s(information, gradient + prior_gradient(rig.time_offsets_s))
        rig = rig.with_time_offsets(rig.time_offsets_s + change_s)
        if np.abs(change_s).max() < _TOLERANCE_FRAMES * step_s:
            break
    alike = correlated_frames(step_s, CORRELATION_S)
    return TimeOffsets(rig.time_offsets_s, offset_sigma_s(information / alike), rig)


def _middle(observations: Observations) -> Observations:
    time_s = observations.frame_time_s
    middle_s = (time_s[0] + time_s[-1]) / 2
    first, last = np.searchsorted(time_s, middle_s + np.array([-0.5, 0.5]) * _MAX_DURATION_S)
    return observations.frames(slice(int(first), max(int(first) + 1, int(last))))


def _of_recording(
    observations: Observations, rig: CameraRig, config: Config
) -> tuple[Float[np.ndarray, "camera camera"], Float[np.ndarray, " camera"]]:
    """Information about the offsets, and gradient, around those of the rig."""
    trajectory = smooth(observations, rig, config)
    positions_m, time_s = trajectory.positions_m, observations.frame_time_s
    if len(time_s) < 2:
        return np.zeros((rig.n_cameras, rig.n_cameras)), np.zeros(rig.n_cameras)
    return offset_information(
        positions_m,
        np.gradient(positions_m, time_s, axis=0),
        on_time_px(observations, rig, positions_m),
        observations.confidence,
        rig,
        config.projection,
    )
