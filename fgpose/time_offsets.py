"""Estimating by how much each camera's clock is off, from the recording itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.camera import CameraRig
from fgpose.config import Config, ProjectionConfig
from fgpose.delays import on_time_px
from fgpose.observations import Observations
from fgpose.smoother import smooth
from fgpose.tracks import frames_alike, usual_step_s
from fgpose_factors import projection_residual, robust_weight

_MAX_ROUNDS = 6
_TOLERANCE_FRAMES = 0.03
_PRIOR_S = 0.1
"""Standard deviation of an offset before anything is known: cameras that film one person start within a few frames."""
_MAX_DURATION_S = 30.0
_MEMORY_S = 30.0
"""Time constant with which the online estimate forgets: clocks drift."""
_CORRELATION_S = 0.15
"""Time over which the errors of a pose network stay alike: so much time counts as one measurement."""
_MIN_INFORMATION = 1e-9  # 1/m^2, keeps a joint that no two cameras see invertible; it then contributes nothing


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
    observations.check_rig(rig)
    part = _middle(observations)
    step_s = usual_step_s(part.frame_time_s)
    information = np.zeros((rig.n_cameras, rig.n_cameras))
    for _ in range(_MAX_ROUNDS):
        information, gradient = _of_recording(part, rig, config)
        change_s = _solved(information, gradient + _prior_gradient(rig.time_offsets_s))
        rig = rig.with_time_offsets(rig.time_offsets_s + change_s)
        if np.abs(change_s).max() < _TOLERANCE_FRAMES * step_s:
            break
    alike = frames_alike(step_s, _CORRELATION_S)
    return TimeOffsets(rig.time_offsets_s, _sigma_s(information / alike), rig)


class RunningOffsets:
    """The same frame by frame: what the newest frames say, older ones counting ever less.

    Args:
        rig: with the offsets known so far.
    """

    def __init__(self, rig: CameraRig, config: ProjectionConfig) -> None:
        self._rig, self._config = rig, config
        self._information = np.zeros((rig.n_cameras, rig.n_cameras))
        self._moment = np.zeros(rig.n_cameras)

    def add(
        self,
        step_s: float,
        positions_m: Float[np.ndarray, "joint 3"],
        velocities_mps: Float[np.ndarray, "joint 3"],
        undistorted_px: Float[np.ndarray, "camera joint 2"],
        weights: Float[np.ndarray, "camera joint"],
        rig: CameraRig,
    ) -> None:
        """Take a frame, its detections moved to its time with the offsets of the rig."""
        information, gradient = offset_information(
            positions_m[None], velocities_mps[None], undistorted_px[None], weights[None], rig, self._config
        )
        keep, alike = np.exp(-step_s / _MEMORY_S), frames_alike(step_s, _CORRELATION_S)
        self._information = keep * self._information + information / alike
        self._moment = keep * self._moment + (information @ rig.time_offsets_s - gradient) / alike

    def rig(self) -> CameraRig:
        """The rig with the offsets that fit best."""
        offsets_s = self._rig.time_offsets_s
        change_s = _solved(self._information, self._information @ offsets_s - self._moment)
        return self._rig.with_time_offsets(offsets_s + change_s)


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


def offset_information(
    positions_m: Float[np.ndarray, "frame joint 3"],
    velocities_mps: Float[np.ndarray, "frame joint 3"],
    undistorted_px: Float[np.ndarray, "frame camera joint 2"],
    weights: Float[np.ndarray, "frame camera joint"],
    rig: CameraRig,
    config: ProjectionConfig,
) -> tuple[Float[np.ndarray, "camera camera"], Float[np.ndarray, " camera"]]:
    """Gauss-Newton's information matrix (1/s^2) and gradient (1/s) by a change of the offsets, the joints eliminated.

    Args:
        undistorted_px: detections, moved to the times of their frames with the offsets so far.
    """
    residuals_px, slopes = [], []
    for c, camera in enumerate(rig.cameras):
        residual_px, (slope,) = projection_residual(positions_m, camera.camera_T_world, camera.K, undistorted_px[:, c])
        residuals_px.append(residual_px)
        slopes.append(slope)
    residual_px, by_position = np.stack(residuals_px, axis=1), np.stack(slopes, axis=1)  # (T,C,J,2), (T,C,J,2,3)
    by_offset = (by_position @ velocities_mps[:, None, ..., None])[..., 0]
    known = np.isfinite(residual_px).all(axis=-1) & np.isfinite(by_offset).all(axis=-1)
    squared = np.where(known, np.sum(residual_px**2, axis=-1), 0.0) / config.sigma_px**2
    weight = np.where(known, weights * robust_weight(squared, config.kernel, config.kernel_scale), 0.0)
    weight = weight[..., None] / config.sigma_px**2
    residual_px, by_position, by_offset = (np.nan_to_num(array) for array in (residual_px, by_position, by_offset))
    of_position = np.einsum("tcji,tcjia,tcjib->tjab", weight * np.ones_like(residual_px), by_position, by_position)
    of_position += _MIN_INFORMATION * np.eye(3)
    across = np.einsum("tcji,tcjia->tjca", weight * by_offset, by_position)
    pull = np.einsum("tcji,tcjia->tja", weight * residual_px, by_position)
    eliminated = np.linalg.solve(of_position[:, :, None], across[..., None])[..., 0]  # (T,J,C,3)
    own = np.einsum("tcji,tcji->c", weight * by_offset, by_offset)
    information = np.diag(own) - np.einsum("tjca,tjda->cd", eliminated, across)
    gradient = np.einsum("tcji,tcji->c", weight * by_offset, residual_px) - np.einsum("tjca,tja->c", eliminated, pull)
    return information, gradient


def _prior_gradient(offsets_s: Float[np.ndarray, " camera"]) -> Float[np.ndarray, " camera"]:
    return offsets_s / _PRIOR_S**2


def _solved(information: np.ndarray, gradient: np.ndarray) -> Float[np.ndarray, " camera"]:
    """The change of the offsets; none for the first camera."""
    change_s = np.zeros(len(gradient))
    change_s[1:] = -np.linalg.solve(_of_others(information), gradient[1:])
    return change_s


def _sigma_s(information: np.ndarray) -> Float[np.ndarray, " camera"]:
    return np.concatenate([[0.0], np.sqrt(np.diag(np.linalg.inv(_of_others(information))))])


def _of_others(information: np.ndarray) -> np.ndarray:
    """What is known of all cameras but the first, with the prior."""
    return information[1:, 1:] + np.eye(len(information) - 1) / _PRIOR_S**2
