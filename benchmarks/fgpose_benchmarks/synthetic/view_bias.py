"""Where a detector sees the joints of a body instead of where they are, depending on the side from which it sees it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.skeleton import Skeleton

_FROM_EDGE = 1e-9
# Of _harmonics, when left and right are interchanged.
_MIRRORED = np.array([1.0, 1.0, -1.0, 1.0, -1.0, -1.0, 1.0, 1.0, 1.0])
# Directions for which the size of the bias is stated: from all around, at the elevations of cameras in a room.
_AZIMUTHS = np.deg2rad(np.arange(0.0, 360.0, 10.0))
_ELEVATIONS = np.deg2rad([0.0, 15.0, 30.0, 45.0])


@dataclass(frozen=True, eq=False)
class ViewBias:
    """A smooth function of the direction from which the body is seen, for each joint; one detector has one, whatever
    the camera. No fixed point of the body explains it: that part would only be another definition of the joint.
    """

    harmonics_m: Float[np.ndarray, "joint 2 9"]
    """Of the bias along the horizontal (to the right as seen from the camera) and upwards, both across the ray."""
    fixed_m: Float[np.ndarray, "joint 3"]
    """What is subtracted, in the frame of the body: the point of the body that explains the most."""
    depth: Float[np.ndarray, "joint 9"]
    """Harmonics of the bias along the ray, which per-view 3D alone has; of unit mean square."""

    @staticmethod
    def drawn(rng: np.random.Generator, skeleton: Skeleton, low_m: float = 0.02, high_m: float = 0.04) -> ViewBias:
        """A detector that treats left and right alike, as one trained on flipped images does.

        Args:
            low_m: root mean square of the length of each joint's bias over all directions: uniform from low_m ...
            high_m: ... to high_m.
        """
        mirror = skeleton.mirror
        harmonics = rng.standard_normal((skeleton.n_joints, 2, len(_MIRRORED)))
        harmonics += harmonics[mirror] * _MIRRORED * np.array([[-1.0], [1.0]])
        length_m = rng.uniform(low_m, high_m, skeleton.n_joints)
        length_m = (length_m + length_m[mirror]) / 2
        seen_from = _directions()
        across = np.stack(_across(seen_from), axis=-2).reshape(-1, 3)
        values = np.einsum("jak,dk->daj", harmonics, _harmonics(seen_from)).reshape(-1, skeleton.n_joints)
        fixed = np.linalg.lstsq(across, values, rcond=None)[0]
        rms = np.sqrt(((values - across @ fixed) ** 2).sum(axis=0) / len(seen_from))
        depth = rng.standard_normal((skeleton.n_joints, len(_MIRRORED)))
        depth += depth[mirror] * _MIRRORED
        depth /= np.sqrt(np.mean((_harmonics(seen_from) @ depth.T) ** 2, axis=0))[:, None]
        return ViewBias(harmonics * (length_m / rms)[:, None, None], (fixed * length_m / rms).T, depth)

    def seen_m(
        self, positions_m: Float[np.ndarray, "frame joint 3"], camera_m: Float[np.ndarray, " 3"], skeleton: Skeleton
    ) -> Float[np.ndarray, "frame joint 3"]:
        """Where a camera at a position sees the joints (world frame, z up, metres): the truth plus the bias.

        Raises:
            ValueError: the skeleton has no hips or shoulders, which tell where the body faces.
        """
        axes, seen_from = body_axes(positions_m, skeleton), _seen_from(positions_m, camera_m, skeleton)
        right, up = _across(seen_from)
        bias_m = np.einsum("jak,tk->tja", self.harmonics_m, _harmonics(seen_from))
        bias_m = bias_m[..., :1] * right[:, None] + bias_m[..., 1:] * up[:, None]
        fixed_m = _without_part_along(self.fixed_m, seen_from)
        return positions_m + np.einsum("tij,tpi->tpj", axes, bias_m - fixed_m)

    def relative_depth(
        self, positions_m: Float[np.ndarray, "frame joint 3"], camera_m: Float[np.ndarray, " 3"], skeleton: Skeleton
    ) -> Float[np.ndarray, "frame joint"]:
        """How much too far along the ray per-view 3D has the joints, in standard deviations of each joint."""
        return _harmonics(_seen_from(positions_m, camera_m, skeleton)) @ self.depth.T


def _seen_from(
    positions_m: Float[np.ndarray, "frame joint 3"], camera_m: Float[np.ndarray, " 3"], skeleton: Skeleton
) -> Float[np.ndarray, "frame 3"]:
    """Unit vectors to the camera in the frame of the body."""
    to_camera_m = camera_m - positions_m[:, list(skeleton.root)].mean(axis=1)
    in_body = np.einsum("tij,tj->ti", body_axes(positions_m, skeleton), to_camera_m)
    return in_body / np.linalg.norm(in_body, axis=-1, keepdims=True)


def body_axes(positions_m: Float[np.ndarray, "frame joint 3"], skeleton: Skeleton) -> Float[np.ndarray, "frame 3 3"]:
    """Rows: forward (horizontal), left (horizontal) and up of a body, world frame with z up."""
    pairs = [(skeleton.index(f"left_{part}"), skeleton.index(f"right_{part}")) for part in ("hip", "shoulder")]
    left = np.sum([positions_m[:, a] - positions_m[:, b] for a, b in pairs], axis=0) * np.array([1.0, 1.0, 0.0])
    left = left / np.maximum(np.linalg.norm(left, axis=-1, keepdims=True), _FROM_EDGE)
    up = np.broadcast_to([0.0, 0.0, 1.0], left.shape)
    return np.stack([np.cross(left, up), left, up], axis=1)


def _directions() -> Float[np.ndarray, "direction 3"]:
    azimuth, elevation = (grid.ravel() for grid in np.meshgrid(_AZIMUTHS, _ELEVATIONS))
    level = np.cos(elevation)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=-1)


def _across(seen_from: Float[np.ndarray, "direction 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Horizontal to the right of the camera's view, and upwards: both across the ray. Unit vectors."""
    right = np.cross(np.array([0.0, 0.0, 1.0]), seen_from)
    right = right / np.maximum(np.linalg.norm(right, axis=-1, keepdims=True), _FROM_EDGE)
    return right, np.cross(seen_from, right)


def _without_part_along(
    offset_m: Float[np.ndarray, "joint 3"], seen_from: Float[np.ndarray, "frame 3"]
) -> Float[np.ndarray, "frame joint 3"]:
    """What a camera sees of an offset."""
    along_m = np.einsum("jk,tk->tj", offset_m, seen_from)
    return offset_m - along_m[..., None] * seen_from[:, None]


def _harmonics(seen_from: Float[np.ndarray, "direction 3"]) -> Float[np.ndarray, "direction 9"]:
    """Real spherical harmonics up to degree 2, of unit mean square over the sphere."""
    x, y, z = seen_from.T
    first = np.sqrt(3.0) * np.stack([x, y, z])
    second = np.sqrt(15.0) * np.stack([x * y, y * z, z * x, (x**2 - y**2) / 2])
    return np.concatenate([np.ones((1, len(x))), first, second, np.sqrt(5.0) / 2 * (3 * z**2 - 1)[None]]).T
