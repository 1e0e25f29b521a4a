"""The state of the adjustment: cameras, clocks, lengths of bones, biases of the views, and the joints."""

from __future__ import annotations

from dataclasses import dataclass, replace

import gtsam
import numpy as np
from jaxtyping import Float

from fgpose.calibration.from_people.evidence import Evidence
from fgpose.calibration.from_people.projection import (
    CENTRE,
    FOCAL,
    N_OF_CAMERA,
    OFFSET,
    RADIAL,
    ROTATION,
    TRANSLATION,
    Views,
)
from fgpose.geometry.camera import Camera, CameraRig


@dataclass(frozen=True, eq=False)
class SceneState:
    """What the adjustment estimates."""

    world_T_camera: Float[np.ndarray, "camera 4 4"]
    log_focal: Float[np.ndarray, " camera"]
    """Of the focal lengths, relative to those of the rig."""
    k1: Float[np.ndarray, " camera"]
    """Radial distortion on top of that of the rig."""
    centre: Float[np.ndarray, "camera 2"]
    """Of the principal points from those of the rig, as a share of the diagonal of the image."""
    offset_s: Float[np.ndarray, " camera"]
    """How much later than the walk says a camera saw it."""
    lengths_m: Float[np.ndarray, " length"]
    bias_m: Float[np.ndarray, "sector view joint 2"]
    """Of the detections, to the body's right and down (sectors.upright), metres at the joint; of each camera, or of all
    the same."""
    joints_m: Float[np.ndarray, "frame joint 3"]
    """Zero where there is none."""

    @staticmethod
    def of(
        rig: CameraRig,
        joints_m: Float[np.ndarray, "frame joint 3"],
        evidence: Evidence,
        n_sectors: int,
        *,
        in_common: bool = True,
    ) -> SceneState:
        """The cameras of a rig and joints, NaN = not known; nothing is known of the rest."""
        lengths_m = _lengths_m(joints_m, evidence)
        return SceneState(
            world_T_camera=np.stack([camera.world_T_camera for camera in rig.cameras]),
            log_focal=np.zeros(rig.n_cameras),
            k1=np.zeros(rig.n_cameras),
            centre=np.zeros((rig.n_cameras, 2)),
            offset_s=np.zeros(rig.n_cameras),
            lengths_m=lengths_m,
            bias_m=np.zeros((n_sectors, 1 if in_common else rig.n_cameras, joints_m.shape[1], 2)),
            joints_m=np.nan_to_num(joints_m),
        )

    @property
    def positions_m(self) -> Float[np.ndarray, "camera 3"]:
        return self.world_T_camera[:, :3, 3]

    @property
    def camera_values(self) -> Float[np.ndarray, "camera 11"]:
        """The unknowns of each camera that have usual values, in their places; zero for its pose."""
        values = np.zeros((len(self.k1), N_OF_CAMERA))
        values[:, FOCAL], values[:, RADIAL], values[:, CENTRE] = self.log_focal, self.k1, self.centre
        values[:, OFFSET] = self.offset_s
        return values

    def with_lenses_and_clocks_of(self, other: SceneState) -> SceneState:
        return replace(self, log_focal=other.log_focal, k1=other.k1, centre=other.centre, offset_s=other.offset_s)

    def views(self, rig: CameraRig) -> Views:
        """The cameras; the lenses of the rig are where they start from."""
        focal_px = np.stack([np.diag(camera.K)[:2] for camera in rig.cameras])
        centre_px = np.stack([camera.K[:2, 2] for camera in rig.cameras])
        diagonal_px = np.array([_diagonal_px(camera) for camera in rig.cameras])
        focal_px, centre_px = focal_px * np.exp(self.log_focal)[:, None], centre_px + diagonal_px[:, None] * self.centre
        return Views(self.world_T_camera, focal_px, centre_px, diagonal_px, self.k1)

    def rig(self, start: CameraRig) -> CameraRig:
        """The rig with its cameras as they are now."""
        return CameraRig(tuple(self._camera(c, camera) for c, camera in enumerate(start.cameras)))

    def moved(
        self,
        cameras: Float[np.ndarray, "camera 11"],
        lengths_m: Float[np.ndarray, " length"],
        bias_m: Float[np.ndarray, "sector view joint 2"],
        joints_m: Float[np.ndarray, "frame joint 3"],
    ) -> SceneState:
        """After a step of everything."""
        return SceneState(
            np.stack([_moved(pose, step) for pose, step in zip(self.world_T_camera, cameras, strict=True)]),
            self.log_focal + cameras[:, FOCAL],
            self.k1 + cameras[:, RADIAL],
            self.centre + cameras[:, CENTRE],
            self.offset_s + cameras[:, OFFSET],
            self.lengths_m + lengths_m,
            self.bias_m + bias_m,
            self.joints_m + joints_m,
        )

    def _camera(self, c: int, camera: Camera) -> Camera:
        K, ratio = camera.K.copy(), float(np.exp(self.log_focal[c]))
        K[[0, 1], [0, 1]] *= ratio
        K[:2, 2] += _diagonal_px(camera) * self.centre[c]
        distortion = _rescaled(camera.distortion, ratio)
        if self.k1[c]:
            distortion = np.array([self.k1[c], 0.0, 0.0, 0.0])
        return replace(
            camera,
            K=K,
            world_T_camera=self.world_T_camera[c],
            distortion=distortion,
            time_offset_s=camera.time_offset_s + float(self.offset_s[c]),
        )


def _diagonal_px(camera: Camera) -> float:
    return float(np.hypot(*camera.size_px))


def _rescaled(distortion: Float[np.ndarray, " coefficients"], ratio: float) -> Float[np.ndarray, " coefficients"]:
    """The same displacements in pixels at a focal length that is larger by a ratio: k r^2 with r in focal lengths."""
    powers = np.array([2, 4, 1, 1, 6, 2, 4, 6])[: distortion.size]
    return distortion * ratio ** powers.astype(float)


def _moved(world_T_camera: Float[np.ndarray, "4 4"], step: Float[np.ndarray, " 11"]) -> Float[np.ndarray, "4 4"]:
    moved = world_T_camera.copy()
    moved[:3, 3] += moved[:3, :3] @ step[TRANSLATION]
    moved[:3, :3] = moved[:3, :3] @ gtsam.Rot3.Expmap(step[ROTATION]).matrix()
    return moved


def _lengths_m(joints_m: Float[np.ndarray, "frame joint 3"], evidence: Evidence) -> Float[np.ndarray, " length"]:
    """Medians over frames and mirrored bones; zero where none is known."""
    start, end = evidence.bones.T
    bones_m = np.linalg.norm(joints_m[:, end] - joints_m[:, start], axis=-1)
    own_m = [bones_m[:, evidence.length_of_bone == length] for length in range(evidence.n_lengths)]
    return np.array([np.nanmedian(own) if np.isfinite(own).any() else 0.0 for own in own_m])
