"""How late each camera is, learned online from the residuals of the newest frames."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.config import Config, ProjectionConfig
from fgpose.estimation.elimination import eliminate_joints
from fgpose.estimation.noise import CORRELATION_S, correlated_frames
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.reprojection import linearized_projection
from fgpose_factors import robust_weight


class RunningOffsets:
    """Time offsets frame by frame, from the residuals of all frames so far; older frames have less weight.

    Args:
        rig: with the offsets known so far, around which calibration.offset_sigma_s is the prior.
    """

    def __init__(self, rig: CameraRig, config: Config) -> None:
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
            positions_m[None], velocities_mps[None], undistorted_px[None], weights[None], rig, self._config.projection
        )
        calibration = self._config.calibration
        keep = np.exp(-step_s / calibration.offset_memory_s)
        correlated = correlated_frames(step_s, CORRELATION_S)
        self._information = keep * self._information + information / correlated
        self._moment = keep * self._moment + (information @ rig.time_offsets_s - gradient) / correlated

    def rig(self) -> CameraRig:
        """The rig with the offsets that fit best; that of the first camera is held."""
        offsets_s = self._rig.time_offsets_s
        prior = np.eye(len(offsets_s)) / self._config.calibration.offset_sigma_s**2
        gradient = self._information @ offsets_s - self._moment
        change_s = np.zeros_like(offsets_s)
        change_s[1:] = -np.linalg.solve((self._information + prior)[1:, 1:], gradient[1:])
        return self._rig.with_time_offsets(offsets_s + change_s)


def offset_information(
    positions_m: Float[np.ndarray, "frame joint 3"],
    velocities_mps: Float[np.ndarray, "frame joint 3"],
    undistorted_px: Float[np.ndarray, "frame camera joint 2"],
    weights: Float[np.ndarray, "frame camera joint"],
    rig: CameraRig,
    config: ProjectionConfig,
) -> tuple[Float[np.ndarray, "camera camera"], Float[np.ndarray, " camera"]]:
    """Gauss-Newton's information matrix (1/s^2) and gradient (1/s) of the offsets; the joints are eliminated.

    Args:
        undistorted_px: detections, moved to the times of their frames with the offsets so far.
    """
    residual_px, by_joint, projected = linearized_projection(undistorted_px, rig, positions_m)
    by_offset = by_joint @ velocities_mps[:, None, ..., None]
    known = projected & np.isfinite(by_offset).all(axis=(-1, -2))
    squared = np.where(known, np.sum(residual_px**2, axis=-1), 0.0) / config.sigma_px**2
    weights = np.where(known, weights * robust_weight(squared, config.kernel, config.kernel_scale), 0.0)
    jacobians = np.nan_to_num(by_joint), np.nan_to_num(by_offset)
    reduced = eliminate_joints(np.nan_to_num(residual_px), *jacobians, weights / config.sigma_px**2)
    return reduced.information, reduced.gradient
