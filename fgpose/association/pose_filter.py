"""Where the joints of a person are expected: a Kalman filter for every joint, fed image by image.

A joint moves with the body, and around it with a velocity that is forgotten (an Ornstein-Uhlenbeck process), so that a
joint that is not seen goes on with the body. An image may be older than the filter's time: it measures where the joint
was then.

The estimator of a person (fgpose.Estimator) is more accurate. This one costs a hundredth and takes single images of any
time, and to tell people apart it is enough.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from fgpose.geometry.camera import CameraRig

SIGMA_M = 0.04
"""Standard deviation of a detection along each axis of the image, metres at the joint: twice what BlazePose and
OpenPose have, for errors of the calibration and of time, and for errors that stay."""

# Limbs swing at 1 to 2 m/s and turn round within a third of a second.
_SWING_MPS, _SWING_S = 1.0, 0.3
# People who walk change their velocity within a step or two.
_BODY_MPS2 = 2.0
# However long a joint was not seen, it is not farther from the body than the body reaches.
_REACH_M = 0.4
# A new person walks in any direction, or not.
_FIRST_MPS = 1.0
_AT_CAMERA_M = 1e-6  # keeps rays finite
_BACKWARDS = np.array([1.0, 1.0, 1.0, -1.0, -1.0, -1.0])


@dataclass(frozen=True, eq=False)
class PoseFilters:
    """The joints of K people at one time each, world frame."""

    time_s: Float[np.ndarray, " person"]
    mean: Float[np.ndarray, "person joint 6"]
    """Position, metres, and velocity, m/s."""
    covariance: Float[np.ndarray, "person joint 6 6"]
    """Of one joint; those of different joints are taken for independent."""

    @staticmethod
    def at(
        time_s: float, positions_m: Float[np.ndarray, "joint 3"], covariance_m2: Float[np.ndarray, "joint 3 3"]
    ) -> PoseFilters:
        """One new person."""
        n_joints = len(positions_m)
        covariance = np.zeros((1, n_joints, 6, 6))
        covariance[0, :, :3, :3], covariance[0, :, 3:, 3:] = covariance_m2, _FIRST_MPS**2 * np.eye(3)
        return PoseFilters(
            np.array([time_s]), np.concatenate([positions_m, np.zeros_like(positions_m)], axis=-1)[None], covariance
        )

    @staticmethod
    def stacked(filters: list[PoseFilters]) -> PoseFilters:
        """Several, one at least, as one."""
        arrays = zip(*((each.time_s, each.mean, each.covariance) for each in filters), strict=True)
        return PoseFilters(*(np.concatenate(array) for array in arrays))

    def __len__(self) -> int:
        return len(self.mean)

    def __getitem__(self, people: slice | np.ndarray) -> PoseFilters:
        return PoseFilters(self.time_s[people], self.mean[people], self.covariance[people])

    @property
    def positions_m(self) -> Float[np.ndarray, "person joint 3"]:
        return self.mean[..., :3]

    @cached_property
    def middle_m(self) -> Float[np.ndarray, "person 3"]:
        """Median of the joints of each."""
        return np.median(self.positions_m, axis=1)

    def exchanged(self, mirror: Int[np.ndarray, " joint"]) -> PoseFilters:
        """With left and right exchanged; mirror: the joint on the other side of each."""
        return PoseFilters(self.time_s, self.mean[:, mirror], self.covariance[:, mirror])

    @property
    def reversed(self) -> PoseFilters:
        """In a time that runs backwards."""
        return PoseFilters(-self.time_s, self.mean * _BACKWARDS, self.covariance * np.outer(_BACKWARDS, _BACKWARDS))

    def predicted(self, time_s: float) -> PoseFilters:
        """At a later time; what is at a later time already stays."""
        step_s = np.maximum(time_s - self.time_s, 0.0)[:, None, None]
        keep = np.exp(-step_s / _SWING_S)
        carried_s = _SWING_S * (1.0 - keep)
        body_mps = self._body_velocity_mps()
        swing_mps = self.mean[..., 3:] - body_mps
        mean = np.concatenate(
            [self.positions_m + body_mps * step_s + swing_mps * carried_s, body_mps + swing_mps * keep], axis=-1
        )
        transition = np.zeros((len(self), 1, 6, 6))
        transition[..., :3, :3] = np.eye(3)
        transition[..., :3, 3:] = carried_s[..., None] * np.eye(3)
        transition[..., 3:, 3:] = keep[..., None] * np.eye(3)
        covariance = transition @ self.covariance @ transition.swapaxes(-1, -2) + _process_noise(step_s)
        return PoseFilters(np.maximum(self.time_s, time_s), mean, covariance)._within_reach()

    def _body_velocity_mps(self) -> Float[np.ndarray, "person 1 3"]:
        """Mean over the joints, each by how well its velocity is known."""
        information = 1.0 / np.trace(self.covariance[..., 3:, 3:], axis1=-2, axis2=-1)
        total = information.sum(axis=1)[:, None, None]
        return np.sum(self.mean[..., 3:] * information[..., None], axis=1, keepdims=True) / total

    def _within_reach(self) -> PoseFilters:
        """No joint is less certain than that it belongs to the body."""
        variance_m2 = np.trace(self.covariance[..., :3, :3], axis1=-2, axis2=-1) / 3
        largest_m2 = np.median(variance_m2, axis=1, keepdims=True) + _REACH_M**2
        shrink = np.sqrt(np.minimum(1.0, largest_m2 / variance_m2))[..., None, None]
        scale = np.concatenate(
            [np.broadcast_to(shrink, (*variance_m2.shape, 3, 1)), np.ones((*variance_m2.shape, 3, 1))], axis=-2
        )
        return replace(self, covariance=self.covariance * scale * scale.swapaxes(-1, -2))

    def seen_by(self, cameras: CameraRig, times_s: Float[np.ndarray, " camera"]) -> Expected:
        """What cameras are expected to detect in an image of each.

        Args:
            cameras: those that have an image.
            times_s: of their images.
        """
        ago_s = (times_s[:, None] - self.time_s)[..., None]
        positions_m = self.positions_m + self.mean[..., 3:] * ago_s[..., None]
        covariance_m2 = self._position_covariance_m2(ago_s[..., None, None])
        pixels, jacobian, depth_m = cameras.linearized(positions_m)
        sigma_px = SIGMA_M * cameras.focal_px[:, None, None] / depth_m
        innovation_px2 = jacobian @ covariance_m2 @ jacobian.swapaxes(-1, -2)
        innovation_px2 = innovation_px2 + (sigma_px**2)[..., None, None] * np.eye(2)
        return Expected(
            pixels, jacobian, innovation_px2, sigma_px, ago_s, cameras, positions_m, np.asarray(covariance_m2)
        )

    def _position_covariance_m2(self, ago_s: Float[np.ndarray, "camera person 1 1 1"]) -> np.ndarray:
        of_position, both = self.covariance[..., :3, :3], self.covariance[..., :3, 3:]
        if not ago_s.any():
            return of_position
        return of_position + ago_s * (both + both.swapaxes(-1, -2)) + ago_s**2 * self.covariance[..., 3:, 3:]

    def updated(
        self,
        residual_px: Float[np.ndarray, "camera person joint 2"],
        expected: Expected,
        weight: Float[np.ndarray, "camera person joint"],
        distance: RayResidual | None = None,
    ) -> PoseFilters:
        """After the detections of one image of each camera.

        Args:
            residual_px: detected less expected; NaN where there is none.
            expected: see seen_by.
            weight: probability that a detection is of the joint; its information counts so much.
            distance: the same along the rays, where there is per-view 3D.
        """
        used = np.asarray(np.isfinite(residual_px).all(axis=-1) & np.isfinite(expected.jacobian).all(axis=(-1, -2)))
        information = np.where(used, weight / expected.sigma_px**2, 0.0)[..., None]
        jacobian = np.where(used[..., None, None], expected.jacobian, 0.0)
        pull = jacobian.swapaxes(-1, -2) @ (np.where(used[..., None], residual_px, 0.0) * information)[..., None]
        square = jacobian.swapaxes(-1, -2) @ (jacobian * information[..., None])
        if distance is not None:
            told = used & np.isfinite(distance.residual_m)
            along = np.where(told, weight * distance.information, 0.0)[..., None]
            pull = pull + (expected.rays * along * np.where(told, distance.residual_m, 0.0)[..., None])[..., None]
            square = square + (expected.rays * along)[..., None] * expected.rays[..., None, :]
        ago_s = expected.ago_s[..., None, None]
        gained, towards = np.zeros_like(self.covariance), np.zeros((*self.mean.shape, 1))
        gained[..., :3, :3], towards[..., :3, :] = square.sum(axis=0), pull.sum(axis=0)
        if expected.ago_s.any():
            gained[..., 3:, :3] = gained[..., :3, 3:] = (ago_s * square).sum(axis=0)
            gained[..., 3:, 3:], towards[..., 3:, :] = (ago_s**2 * square).sum(axis=0), (ago_s * pull).sum(axis=0)
        covariance = np.linalg.inv(np.linalg.inv(self.covariance) + gained)
        return replace(self, mean=self.mean + (covariance @ towards)[..., 0], covariance=covariance)


@dataclass(frozen=True, eq=False)
class Expected:
    """What cameras should detect of K people; NaN behind a camera."""

    pixels: Float[np.ndarray, "camera person joint 2"]
    """Undistorted."""
    jacobian: Float[np.ndarray, "camera person joint 2 3"]
    """By the position, px/m."""
    covariance_px2: Float[np.ndarray, "camera person joint 2 2"]
    """Of a detection around it."""
    sigma_px: Float[np.ndarray, "camera person joint"]
    """Standard deviation of a detection around the true joint."""
    ago_s: Float[np.ndarray, "camera person 1"]
    """Time of the image less that of the filter."""
    cameras: CameraRig
    positions_m: Float[np.ndarray, "camera person joint 3"]
    """World frame, at the times of the images."""
    position_covariance_m2: Float[np.ndarray, "... person joint 3 3"]

    @cached_property
    def _from_camera_m(self) -> Float[np.ndarray, "camera person joint 3"]:
        return self.positions_m - self.cameras.positions_m[:, None, None]

    @cached_property
    def distance_m(self) -> Float[np.ndarray, "camera person joint"]:
        """From the camera."""
        return np.linalg.norm(self._from_camera_m, axis=-1)

    @cached_property
    def rays(self) -> Float[np.ndarray, "camera person joint 3"]:
        """Unit vectors from the camera, world frame."""
        return self._from_camera_m / np.maximum(self.distance_m, _AT_CAMERA_M)[..., None]

    @cached_property
    def distance_variance_m2(self) -> Float[np.ndarray, "camera person joint"]:
        """Of the distance, from the covariance of the position."""
        return np.einsum("...i,...ik,...k->...", self.rays, self.position_covariance_m2, self.rays)


@dataclass(frozen=True, eq=False)
class RayResidual:
    """How much farther than expected cameras say that the joints of K people are."""

    residual_m: Float[np.ndarray, "camera person joint"]
    """NaN where it is not told."""
    information: Float[np.ndarray, "camera person joint"]
    """1/m^2."""


def _process_noise(step_s: Float[np.ndarray, "person 1 1"]) -> Float[np.ndarray, "person 1 6 6"]:
    """Of the swing, and of a body that changes its velocity."""
    keep = np.exp(-step_s / _SWING_S)
    swing_m = _SWING_MPS * _SWING_S
    # Integrals of the process (Gelb 1974, integrated first-order Markov).
    velocity = _SWING_MPS**2 * (1 - keep**2)
    both = _SWING_MPS * swing_m * (1 - keep) ** 2
    position = swing_m**2 * (2 * step_s / _SWING_S - 3 + 4 * keep - keep**2)
    density = _BODY_MPS2**2 * _SWING_S
    velocity, both, position = (
        velocity + density * step_s,
        both + density * step_s**2 / 2,
        position + density * step_s**3 / 3,
    )
    noise = np.zeros((len(step_s), 1, 6, 6))
    noise[..., :3, :3] = position[..., None] * np.eye(3)
    noise[..., :3, 3:] = noise[..., 3:, :3] = both[..., None] * np.eye(3)
    noise[..., 3:, 3:] = velocity[..., None] * np.eye(3)
    return noise
