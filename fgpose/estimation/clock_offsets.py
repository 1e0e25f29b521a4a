"""How late each camera is, learned from the residuals of an estimate: the joints are eliminated (Schur complement)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.config import ProjectionConfig
from fgpose.estimation.noise import correlated_frames
from fgpose.geometry.camera import CameraRig
from fgpose_factors import projection_residual, robust_weight

_PRIOR_S = 0.1
"""Standard deviation of an offset before anything is known: cameras that film one person start within a few frames."""
_MEMORY_S = 30.0
"""Time constant with which the online estimate forgets: clocks drift."""
CORRELATION_S = 0.15
"""Time over which the errors of a pose network are correlated: so much time counts as one measurement."""
_MIN_INFORMATION = 1e-9  # 1/m^2, keeps a joint that no two cameras see invertible; it then contributes nothing


class RunningOffsets:
    """Time offsets frame by frame: what the newest frames say, older ones counting ever less.

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
        keep, alike = np.exp(-step_s / _MEMORY_S), correlated_frames(step_s, CORRELATION_S)
        self._information = keep * self._information + information / alike
        self._moment = keep * self._moment + (information @ rig.time_offsets_s - gradient) / alike

    def rig(self) -> CameraRig:
        """The rig with the offsets that fit best."""
        offsets_s = self._rig.time_offsets_s
        change_s = offset_change_s(self._information, self._information @ offsets_s - self._moment)
        return self._rig.with_time_offsets(offsets_s + change_s)


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


def prior_gradient(offsets_s: Float[np.ndarray, " camera"]) -> Float[np.ndarray, " camera"]:
    return offsets_s / _PRIOR_S**2


def offset_change_s(information: np.ndarray, gradient: np.ndarray) -> Float[np.ndarray, " camera"]:
    """The change of the offsets; none for the first camera."""
    change_s = np.zeros(len(gradient))
    change_s[1:] = -np.linalg.solve(_of_others(information), gradient[1:])
    return change_s


def offset_sigma_s(information: np.ndarray) -> Float[np.ndarray, " camera"]:
    return np.concatenate([[0.0], np.sqrt(np.diag(np.linalg.inv(_of_others(information))))])


def _of_others(information: np.ndarray) -> np.ndarray:
    """What is known of all cameras but the first, with the prior."""
    return information[1:, 1:] + np.eye(len(information) - 1) / _PRIOR_S**2
