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
from fgpose.geometry.camera import CameraRig
from fgpose_factors import Kernel, noise_model, project, projection_factor, robust_loss, robust_weight

# Making a noise model costs as much as making a factor: sigmas that agree to a thousandth share one.
_SIGMAS_PER_E_FOLD = 1000
_Projected = tuple[
    Float[np.ndarray, "camera 2 point"], Float[np.ndarray, "camera 2 3 point"], Float[np.ndarray, "camera point"]
]


@lru_cache(maxsize=4096)
def _noise(sigma_px: float, kernel: Kernel, kernel_scale: float) -> gtsam.noiseModel.Base:
    return noise_model(2, sigma_px, kernel, kernel_scale)


@dataclass(frozen=True, eq=False)
class Projections:
    """Reprojection errors in all cameras."""

    rig: CameraRig
    measured_px: Float[np.ndarray, "frame camera slot 2"]
    """Finite everywhere."""
    sigma_px: Float[np.ndarray, "frame camera slot"]
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
        yield cls.of_detections(segment.rig, measured_px, sigma_px, segment.config.projection)

    @classmethod
    def of_detections(
        cls,
        rig: CameraRig,
        undistorted_px: Float[np.ndarray, "frame camera slot 2"],
        sigma_px: Float[np.ndarray, "frame camera slot"],
        config: ProjectionConfig,
    ) -> Projections:
        """NaN where there is no detection."""
        unit_px = rig.in_own_px(1.0)
        steps = np.round(_SIGMAS_PER_E_FOLD * np.log(sigma_px / unit_px))
        sigma_px = unit_px * np.exp(steps / _SIGMAS_PER_E_FOLD)
        missing = np.asarray(np.isnan(undistorted_px).any(axis=-1))
        sigma_px[missing] = np.inf
        measured_px = np.where(missing[..., None], 0.0, undistorted_px)
        return cls(rig, measured_px, sigma_px, config.kernel, config.kernel_scale)

    def graph_factors(self, keys: Keys) -> Iterator[gtsam.NonlinearFactor]:
        for number, camera in enumerate(self.rig.cameras):
            measured_px, sigma_px = self.measured_px[:, number], self.sigma_px[:, number]
            there = np.isfinite(sigma_px)
            rows = zip(np.argwhere(there).tolist(), measured_px[there], sigma_px[there].tolist(), strict=True)
            for (frame, slot), detection_px, sigma in rows:
                noise = _noise(sigma, self.kernel, self.kernel_scale)
                yield projection_factor(keys.position(frame, slot), detection_px, noise, camera.gtsam)

    def error(self, state: BatchState) -> float:
        _, _, squared = self._at(state)
        return float(robust_loss(squared, self.kernel, self.kernel_scale).sum())

    def add_gradient(self, gradient: BatchState, state: BatchState) -> None:
        residual_px, jacobian, squared = self._at(state)
        pull = (self._precision * self._weight(squared))[:, None] * residual_px
        gradient.joints[:, 0] += self._by_frame(np.einsum("cian,cin->an", jacobian, pull))

    def add_information(self, information: Information, state: BatchState) -> None:
        _, jacobian, squared = self._at(state)
        information.single_positions[:] += self._information(jacobian, squared)

    def information(self, positions_m: Float[np.ndarray, "frame slot 3"]) -> Float[np.ndarray, "frame slot 3 3"]:
        """On each position, 1/m^2."""
        _, jacobian, squared = self._projected(positions_m)
        return self._information(jacobian, squared)

    def _information(
        self, jacobian: Float[np.ndarray, "camera 2 3 point"], squared: Float[np.ndarray, "camera point"]
    ) -> Float[np.ndarray, "frame slot 3 3"]:
        weighted = (self._precision * self._weight(squared))[:, None, None] * jacobian
        return self._by_frame(np.einsum("cian,cibn->abn", weighted, jacobian))

    def whitened(
        self, positions_m: Float[np.ndarray, "frame slot 3"]
    ) -> tuple[
        Float[np.ndarray, "frame camera slot 2"],
        Float[np.ndarray, "frame camera slot 2 3"],
        Float[np.ndarray, "frame camera slot"],
    ]:
        """Residuals and Jacobians in standard deviations of their detections, and weights of the kernel."""
        residual_px, jacobian, squared = self._projected(positions_m)
        root = np.sqrt(self._precision)
        arrays = root[:, None] * residual_px, root[:, None, None] * jacobian, self._weight(squared)
        residual, whitened, weight = (self._by_frame(array).swapaxes(1, 2) for array in arrays)
        return residual, whitened, weight

    @cached_property
    def _measured_px(self) -> Float[np.ndarray, "camera 2 point"]:
        """All points of a coordinate side by side, as project has them."""
        return np.ascontiguousarray(self.measured_px.transpose(1, 3, 0, 2)).reshape(self.rig.n_cameras, 2, -1)

    @cached_property
    def _precision(self) -> Float[np.ndarray, "camera point"]:
        return (self.sigma_px.swapaxes(0, 1) ** -2).reshape(self.rig.n_cameras, -1)

    def _by_frame(self, of_points: Float[np.ndarray, "*values point"]) -> Float[np.ndarray, "frame slot *values"]:
        return of_points.transpose(-1, *range(of_points.ndim - 1)).reshape(
            *self.measured_px.shape[::2], *of_points.shape[:-1]
        )

    def _weight(self, squared: Float[np.ndarray, "camera point"]) -> Float[np.ndarray, "camera point"]:
        return robust_weight(squared, self.kernel, self.kernel_scale)

    def _at(self, state: BatchState) -> _Projected:
        return state.evaluated(self, lambda state: self._projected(state.joints[:, 0]))

    def _projected(self, positions_m: Float[np.ndarray, "frame slot 3"]) -> _Projected:
        """Residual, its Jacobian, and its square in standard deviations; at or behind the camera, as in GTSAM, twice
        the focal length and a zero Jacobian."""
        projected_px, jacobian = project(positions_m.reshape(-1, 3), self.rig.camera_T_world, self.rig.K)
        residual_px = projected_px - self._measured_px
        behind = np.isnan(residual_px[:, 0])
        if behind.any():
            camera, point = np.nonzero(behind)
            residual_px[camera, :, point] = 2 * self.rig.K[camera, 0, 0, None]
            jacobian[camera, :, :, point] = 0.0
        return residual_px, jacobian, self._precision * (residual_px**2).sum(axis=1)


def detection_information(
    rig: CameraRig,
    undistorted_px: Float[np.ndarray, "frame camera joint 2"],
    sigma_px: Float[np.ndarray, "frame camera joint"],
    positions_m: Float[np.ndarray, "frame joint 3"],
    config: ProjectionConfig,
) -> Float[np.ndarray, "frame joint 3 3"]:
    """Information of the detections of a frame alone on points at these positions, 1/m^2; NaN where a point is NaN."""
    table = Projections.of_detections(rig, undistorted_px, sigma_px, config)
    unknown = np.isnan(positions_m)
    information = table.information(np.where(unknown, 0.0, positions_m))
    information[unknown.any(axis=-1)] = np.nan
    return information
