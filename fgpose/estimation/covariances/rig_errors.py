"""Whether a camera is not where the calibration has it, from what the views contradict each other by, and what that
does to the joints.

A camera that was turned shifts all joints alike, in all frames: an error that nothing averages out, and of which three
cameras may contradict only a small part. In parity space (detection_errors) the residuals of all
joints and frames are r = G d + e, with G the derivative of the projections by the pose of one camera. For each camera
the evidence that it alone has moved by d ~ N(0, s^2) is compared with that of none (MacKay 1992, Bayesian
interpolation). The poses are not corrected by it, so what enters the covariance of the joints is the second moment of d
over all hypotheses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.estimation.covariances.detection_errors import IN_LINE, invertible
from fgpose.geometry.camera import CameraRig
from fgpose_factors.robust_statistics import medians

# How far a camera that has moved may have moved, at the joints; and how probable it is that it has, beforehand.
_MOVED_M, _PROBABILITY = (0.03, 0.1, 0.3), 0.01
MOVE_MEMORY_S = 5.0
"""A camera may be moved at any time: its pose is judged by the frames of so long. In less, people stand where the
views contradict each other too little."""
SURELY_M = 0.005
"""A camera that has moved farther, over all hypotheses, has moved: calibrations are seldom worse."""


@dataclass(frozen=True, eq=False)
class JointMoves:
    """How joints follow the poses of the cameras, which are six numbers each: rotations and translations, in metres at
    the joints."""

    jacobian: Float[np.ndarray, "frame camera joint 2 3"]
    """Of the projections by the joints; zero where a detection does not count."""
    by_pose: Float[np.ndarray, "frame camera joint 2 6"]
    """The same by the pose of their camera."""
    covariance: Float[np.ndarray, "frame joint 3 3"]
    """Of the joints, by the detections alone."""
    moved: Float[np.ndarray, "frame joint camera 3 6"]
    """By how much the joints follow."""

    @staticmethod
    def of(
        jacobian: Float[np.ndarray, "frame camera joint 2 3"],
        known: Bool[np.ndarray, "frame camera joint"],
        positions_m: Float[np.ndarray, "frame joint 3"],
        rig: CameraRig,
    ) -> JointMoves:
        """Of the known detections, where there are two of a joint.

        Args:
            jacobian: of the projections, in standard deviations.
            known: which detections count.
            positions_m: the pose.
            rig: the cameras.
        """
        known = known & (known.sum(axis=1, keepdims=True) >= 2)
        jacobian = np.where(known[..., None, None], jacobian, 0.0)
        by_pose = jacobian @ _by_pose(rig.camera_T_world, positions_m)
        covariance = np.linalg.inv(invertible(np.einsum("tcjia,tcjib->tjab", jacobian, jacobian)))
        moved = -covariance[:, None] @ (jacobian.swapaxes(-1, -2) @ by_pose)
        return JointMoves(jacobian, by_pose, covariance, moved.swapaxes(1, 2))

    def covariance_m2(
        self, moments: Float[np.ndarray, "camera 6 6"], frames: slice
    ) -> Float[np.ndarray, "frame joint 3 3"]:
        """Of the joints in some of the frames, about the poses that the cameras have in the rig.

        Args:
            moments: second moments of the moves of the cameras.
            frames: which frames.
        """
        moved = self.moved[frames]
        return np.sum(moved @ moments @ moved.swapaxes(-1, -2), axis=2)


@dataclass(frozen=True, eq=False)
class CameraMoves:
    """What detections tell of the poses of the cameras."""

    information: Float[np.ndarray, "frame camera 6 6"]
    """On the six numbers of each, in parity space."""
    gradient: Float[np.ndarray, "frame camera 6"]
    """By the numbers, of half the sum of the squared residuals."""

    @staticmethod
    def of(residual: Float[np.ndarray, "frame camera joint 2"], joints: JointMoves) -> CameraMoves:
        """Residuals of the projections less the detections, in standard deviations."""
        jacobian, by_pose = joints.jacobian, joints.by_pose
        pull = np.einsum("tcjia,tcji->tja", jacobian, residual)
        explained = np.einsum("tcjia,tja->tcji", jacobian, (joints.covariance @ pull[..., None])[..., 0])
        on_joint = jacobian.swapaxes(-1, -2) @ by_pose
        own = np.einsum("tcjin,tcjim->tcnm", by_pose, by_pose)
        shared = np.einsum("tcjan,tjcam->tcnm", on_joint, joints.moved)
        return CameraMoves(own + shared, np.einsum("tcjin,tcji->tcn", by_pose, residual - explained))

    def sums(self, frames: slice) -> MoveSums:
        """Over some of the frames."""
        return MoveSums(self.information[frames].sum(axis=0), self.gradient[frames].sum(axis=0))


@dataclass(frozen=True, eq=False)
class MoveSums:
    """What some frames tell of the poses of the cameras."""

    information: Float[np.ndarray, "camera 6 6"]
    gradient: Float[np.ndarray, "camera 6"]

    def plus(self, earlier: MoveSums, keep: float) -> MoveSums:
        """With earlier ones, which count less by this factor."""
        return MoveSums(self.information + keep * earlier.information, self.gradient + keep * earlier.gradient)

    def most_likely(self) -> tuple[int, Float[np.ndarray, " 6"]]:
        """The camera whose move explains the most of the residuals, and the move."""
        trace = np.trace(self.information, axis1=-2, axis2=-1)[:, None, None]
        ridge = (IN_LINE * trace + 1.0 / _MOVED_M[-1] ** 2) * np.eye(6)
        moves = np.linalg.solve(self.information + ridge, -self.gradient[..., None])[..., 0]
        camera = int(np.argmin(np.einsum("cn,cn->c", moves, self.gradient)))
        return camera, moves[camera]

    def moments(self, independent: float) -> Float[np.ndarray, "camera 6 6"]:
        """Second moments of the moves of all cameras, over the hypotheses that one or none has moved.

        Args:
            independent: how much of an independent measurement each detection is.
        """
        information, gradient = independent * self.information, independent * self.gradient
        evidences, moments = [], []
        for scale_m in _MOVED_M:
            total = information + np.eye(6) / scale_m**2
            covariance = np.linalg.inv(total)
            moves = -np.einsum("cnm,cm->cn", covariance, gradient)
            determinant = np.linalg.slogdet(scale_m**2 * total)[1]
            evidences.append(-np.einsum("cn,cn->c", moves, gradient) / 2 - determinant / 2)
            moments.append(covariance + moves[:, :, None] * moves[:, None])
        odds = np.stack(evidences) + np.log(_PROBABILITY / len(_MOVED_M))
        most = max(float(odds.max()), 0.0)
        probability = np.exp(odds - most) / (np.exp(-most) + np.exp(odds - most).sum())
        return np.einsum("sc,scnm->cnm", probability, np.stack(moments))


def without_move(
    residual: Float[np.ndarray, "frame camera joint 2"],
    jacobian: Float[np.ndarray, "frame camera joint 2 3"],
    positions_m: Float[np.ndarray, "frame joint 3"],
    moved: tuple[int, Float[np.ndarray, " 6"]],
    rig: CameraRig,
) -> Float[np.ndarray, "frame camera joint 2"]:
    """The residuals as they would be if this camera had not moved; see MoveSums.most_likely."""
    camera, move = moved
    without, poses = residual.copy(), rig.camera_T_world[camera : camera + 1]
    moved_m = _by_pose(poses, positions_m)[:, 0] @ move
    without[:, camera] += np.einsum("tjia,tja->tji", jacobian[:, camera], moved_m)
    return without


def _by_pose(
    camera_T_world: Float[np.ndarray, "camera 4 4"], positions_m: Float[np.ndarray, "frame joint 3"]
) -> Float[np.ndarray, "frame camera joint 3 6"]:
    """How joints move, in the world, if each camera stays and they do what its pose should have done; of those that are
    not known, as if they were at the origin."""
    positions_m = np.where(np.isnan(positions_m), 0.0, positions_m)  # np.nan_to_num takes four times as long
    R, t_m = camera_T_world[:, :3, :3], camera_T_world[:, None, :3, 3]
    in_camera_m = positions_m[:, None] @ R.swapaxes(1, 2) + t_m
    distance_m = np.maximum(medians(in_camera_m[..., 2].swapaxes(0, 1).reshape(len(R), -1)), 1.0)
    by_number = np.zeros((*in_camera_m.shape, 6))
    x, y, z = (in_camera_m / distance_m[:, None, None]).transpose(3, 0, 1, 2)
    by_number[..., 0, 1], by_number[..., 0, 2] = z, -y
    by_number[..., 1, 0], by_number[..., 1, 2] = -z, x
    by_number[..., 2, 0], by_number[..., 2, 1] = y, -x
    by_number[..., 3:] = np.eye(3)
    return R.swapaxes(1, 2)[:, None] @ by_number
