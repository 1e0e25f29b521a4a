"""Reprojection: a joint projects onto its detection."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache

import gtsam
import numpy as np
from jaxtyping import Float

from fgpose.config import ProjectionConfig
from fgpose.estimation.factors.state import BatchState, Information
from fgpose.estimation.keys import Keys
from fgpose.estimation.segment import Segment
from fgpose.geometry.camera import Camera, CameraRig
from fgpose_factors import Kernel, noise_model, projection_factor, projection_residual, robust_loss, robust_weight

# Making a noise model costs as much as making a factor: sigmas that agree to a thousandth share one.
_SIGMAS_PER_E_FOLD = 1000


@lru_cache(maxsize=4096)
def _noise(sigma_px: float, kernel: Kernel, kernel_scale: float) -> gtsam.noiseModel.Base:
    return noise_model(2, sigma_px, kernel, kernel_scale)


@dataclass(frozen=True, eq=False)
class Projections:
    """Reprojection errors in one camera."""

    camera: Camera
    measured_px: Float[np.ndarray, "frame slot 2"]
    """Finite everywhere."""
    sigma_px: Float[np.ndarray, "frame slot"]
    """inf where there is no detection."""
    kernel: Kernel
    kernel_scale: float

    @classmethod
    def of(cls, segment: Segment) -> Iterator[Projections]:
        """Every detection of an active joint."""
        evidence, joints = segment.evidence, segment.joints
        used = segment.active[:, None, joints, None]
        measured_px = np.where(used, evidence.undistorted_px[:, :, joints], np.nan)
        sigma_px = evidence.detection_sigma_px[:, :, joints]
        return cls.of_detections(segment.rig, measured_px, sigma_px, segment.config.projection)

    @classmethod
    def of_detections(
        cls,
        rig: CameraRig,
        undistorted_px: Float[np.ndarray, "frame camera slot 2"],
        sigma_px: Float[np.ndarray, "frame camera slot"],
        config: ProjectionConfig,
    ) -> Iterator[Projections]:
        """One table per camera."""
        unit_px = rig.in_own_px(1.0)
        steps = np.round(_SIGMAS_PER_E_FOLD * np.log(sigma_px / unit_px))
        sigma_px = unit_px * np.exp(steps / _SIGMAS_PER_E_FOLD)
        sigma_px[np.isnan(undistorted_px).any(axis=-1)] = np.inf
        measured_px = np.nan_to_num(undistorted_px)
        for number, camera in enumerate(rig.cameras):
            yield cls(camera, measured_px[:, number], sigma_px[:, number], config.kernel, config.kernel_scale)

    def graph_factors(self, keys: Keys) -> Iterator[gtsam.NonlinearFactor]:
        for frame, slot in np.argwhere(np.isfinite(self.sigma_px)).tolist():
            noise = _noise(float(self.sigma_px[frame, slot]), self.kernel, self.kernel_scale)
            yield projection_factor(keys.position(frame, slot), self.measured_px[frame, slot], noise, self.camera.gtsam)

    def error(self, state: BatchState) -> float:
        residual_px, _ = self._project(state.joints[:, 0])
        return float(robust_loss(self._squared(residual_px), self.kernel, self.kernel_scale).sum())

    def add_gradient(self, gradient: BatchState, state: BatchState) -> None:
        weighted, _, residual_px = self._linearized(state.joints[:, 0])
        gradient.joints[:, 0] += np.einsum("tjia,tji->tja", weighted, residual_px)

    def add_information(self, information: Information, state: BatchState) -> None:
        information.single_positions[:] += self.information(state.joints[:, 0])

    def information(self, positions_m: Float[np.ndarray, "frame slot 3"]) -> Float[np.ndarray, "frame slot 3 3"]:
        """On each position, 1/m^2."""
        weighted, jacobian, _ = self._linearized(positions_m)
        return np.einsum("tjia,tjib->tjab", weighted, jacobian)

    def whitened(
        self, positions_m: Float[np.ndarray, "frame slot 3"]
    ) -> tuple[Float[np.ndarray, "frame slot 2"], Float[np.ndarray, "frame slot 2 3"], Float[np.ndarray, "frame slot"]]:
        """Residuals and Jacobians in standard deviations of their detections, and weights of the kernel."""
        residual_px, jacobian = self._project(positions_m)
        weight = robust_weight(self._squared(residual_px), self.kernel, self.kernel_scale)
        return residual_px / self.sigma_px[..., None], jacobian / self.sigma_px[..., None, None], weight

    @cached_property
    def _precision(self) -> Float[np.ndarray, "frame slot"]:
        return self.sigma_px**-2

    def _linearized(self, positions_m: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Weighted Jacobian, Jacobian and residual."""
        residual_px, jacobian = self._project(positions_m)
        weight = self._precision * robust_weight(self._squared(residual_px), self.kernel, self.kernel_scale)
        return weight[..., None, None] * jacobian, jacobian, residual_px

    def _squared(self, residual_px: np.ndarray) -> Float[np.ndarray, "frame slot"]:
        return self._precision * np.einsum("tji,tji->tj", residual_px, residual_px)

    def _project(self, positions_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual and its Jacobian; at or behind the camera, as in GTSAM, twice the focal length and a zero
        Jacobian."""
        camera, K = self.camera.camera_T_world, self.camera.K
        residual_px, (jacobian,) = projection_residual(positions_m, camera, K, self.measured_px)
        behind = np.isnan(residual_px[..., 0])
        if behind.any():
            residual_px[behind], jacobian[behind] = 2 * K[0, 0], 0.0
        return residual_px, jacobian


def detection_information(
    rig: CameraRig,
    undistorted_px: Float[np.ndarray, "frame camera joint 2"],
    sigma_px: Float[np.ndarray, "frame camera joint"],
    positions_m: Float[np.ndarray, "frame joint 3"],
    config: ProjectionConfig,
) -> Float[np.ndarray, "frame joint 3 3"]:
    """Information of the detections of a frame alone on points at these positions, 1/m^2; NaN where a point is NaN."""
    tables = Projections.of_detections(rig, undistorted_px, sigma_px, config)
    points_m = np.nan_to_num(positions_m)
    information = np.sum([table.information(points_m) for table in tables], axis=0)
    information[np.isnan(positions_m).any(axis=-1)] = np.nan
    return information
