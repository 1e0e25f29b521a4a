"""RTMW3D: 2D joints and their depth relative to the hips (Jiang et al. 2024, "RTMW"), and from them absolute joints.

The network says where a joint is in the image, and by how many metres it lies behind the hips; it does not give the
depth of the hips. mmpose puts them at the mean depth of its training set, which is no measurement. But the depths are
metric and the rays known, so every bone whose length is known gives that distance: the nearer the person, the larger
the bone in the image. fgpose does not know the lengths of this person's bones either. It assumes a standing height,
which the user may set, and the proportions of adults; the distance is then as wrong as the height is, in per cent, and
the covariance says so. The other networks hide such an assumption in their weights.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from fgpose.geometry.camera import Camera
from fgpose.geometry.per_view.absolute_pose import AbsolutePose, absolute_pose
from fgpose.io.skeletons import load_skeleton
from fgpose.kinematics.proportions import FOREARM, SHANK, THIGH, TRUNK, UPPER_ARM
from fgpose.monocular.network import Image, People
from fgpose.monocular.networks.devices import Device
from fgpose.monocular.networks.rtmpose import SimccNetwork, SimccPose
from fgpose.monocular.networks.topdown import Boxes, PersonDetector, TopDown, TopDownTracker
from fgpose.monocular.networks.yolox import person_detector
from fgpose.skeleton import LIMBS, Skeleton
from fgpose_factors.robust_statistics import CAUCHY_SCALE

_N_KEYPOINTS = 133  # of COCO-WholeBody
_N_BODY = 17  # COCO-WholeBody begins with the joints of COCO; feet, face and hands follow
_DEPTH_RANGE_M = 2.1744869  # z_range of mmpose's configuration of RTMW3D: depth of the last bin

HEIGHT_M = 1.70
"""Standing height that is assumed unless the user says better."""
_SHARE_OF_HEIGHT = dict(zip(LIMBS, (UPPER_ARM, FOREARM, THIGH, SHANK), strict=True))
# The shares differ by about 5 % from person to person, and as much between the joint definitions of data sets.
_LENGTH_SIGMA = 0.10
# Difference of depth of two joints; RTMW3D's mean error on H3WB is 57 mm over the three axes.
_DEPTH_SIGMA_M = 0.06
_MIN_CONFIDENCE = 0.3  # mmpose draws joints from here on
_MIN_BONES = 3  # of two that disagree, nothing tells which is wrong
_ITERATIONS = 20  # bounds the time; the weights change less each time


class RTMW3D:
    """A Network; of its 133 keypoints it gives the 17 of coco_17.

    Raises:
        OSError: there is no such file.
        ValueError: a file has other inputs or outputs, or another number of keypoints; the message names it. The height
            is not that of a person.
    """

    def __init__(
        self,
        landmarks: Path,
        detector: Path | PersonDetector,
        *,
        height_m: float | None = HEIGHT_M,
        threads: int = 1,
        device: Device = "auto",
        max_people: int = 4,
        detect_every_frame: bool = True,
    ) -> None:
        """
        Args:
            landmarks: an ONNX file: [1, 3, 384, 288] (or any other size) -> three outputs in the order x [1, 133, 576],
                y [1, 133, 768], z [1, 133, 576].
            detector: an ONNX file of YOLOX, or a detector of your own.
            height_m: standing height of the people, or None for 2D joints only. A person of another height h comes out
                at height_m / h times their distance.
            threads: how many threads one run may use.
            device: where the networks run.
            max_people: how many people are looked at in an image, the most confident first.
            detect_every_frame: False follows the joints from image to image, see TopDownTracker.
        """
        if height_m is not None and not 0.5 <= height_m <= 2.5:
            raise ValueError(f"the height of a person is 0.5 to 2.5 m, got {height_m:g}")
        self._simcc = SimccNetwork(landmarks, ("simcc_x", "simcc_y", "simcc_z"), threads, device)
        if self._simcc.n_keypoints != _N_KEYPOINTS:
            count = self._simcc.n_keypoints
            raise ValueError(f"{landmarks} gives {count} keypoints; RTMW3D gives {_N_KEYPOINTS} (whole body)")
        self.skeleton = load_skeleton("coco_17")
        self._height_m = height_m
        self._top_down = TopDown(person_detector(detector, threads, device), max_people, detect_every_frame)
        height = "2D" if height_m is None else f"{height_m:g} m"
        self.name = f"rtmw3d {self._simcc.name} {height}, {self._top_down.name}"

    def tracker(self, camera: Camera) -> TopDownTracker:
        """For the images of one camera, whose size and intrinsics are those of the images."""

        def people(image: Image, boxes: Boxes) -> People:
            poses = [self._absolute(pose, camera) for pose in self._simcc.poses(image, boxes)]
            return People.stacked(boxes, *zip(*poses, strict=True))

        return TopDownTracker(self._top_down, people, camera, self.skeleton.n_joints)

    def _absolute(self, pose: SimccPose, camera: Camera) -> tuple[np.ndarray, np.ndarray, AbsolutePose]:
        """points2d_px, confidence and absolute pose of a person."""
        points2d_px, confidence = pose.points2d_px[:_N_BODY], pose.confidence[:_N_BODY]
        if self._height_m is None:
            return points2d_px, confidence, AbsolutePose.missing(_N_BODY, "")
        behind_root_m = _DEPTH_RANGE_M * pose.depth[:_N_BODY]
        u = (camera.undistort(points2d_px) - camera.K[:2, 2]) / np.diag(camera.K)[:2]
        root_m, sigma_m = root_depth(u, behind_root_m, confidence, self.skeleton, self._height_m)
        if not np.isfinite(root_m):
            few = f"few bones: fewer than {_MIN_BONES} are seen at an angle that tells the distance"
            return points2d_px, confidence, AbsolutePose.missing(_N_BODY, few)
        rays = np.concatenate([u, np.ones((_N_BODY, 1))], axis=1)
        absolute = absolute_pose(
            rays * (root_m + behind_root_m)[:, None] - (0.0, 0.0, root_m),
            points2d_px,
            confidence,
            camera,
            self.skeleton,
        )
        # absolute_pose counts the unknown height of the person, but not that the bones disagree about the distance.
        bones_m2 = sigma_m**2 * rays[:, :, None] * rays[:, None]
        return points2d_px, confidence, replace(absolute, covariance_m2=absolute.covariance_m2 + bones_m2)


def root_depth(
    u: Float[np.ndarray, "joint 2"],
    behind_root_m: Float[np.ndarray, " joint"],
    confidence: Float[np.ndarray, " joint"],
    skeleton: Skeleton,
    height_m: float,
) -> tuple[float, float]:
    """Depth of the root at which the bones have the lengths of a person of this height, and its standard deviation.

    With joints at u (Z + z), a bone has the length L where |(u_a - u_b) Z + u_a z_a - u_b z_b|^2 + (z_a - z_b)^2 = L^2:
    each gives one Z, and those that disagree with the others count little. On three captured walks (CMU) at 4.5 m, the
    height known, z wrong by 45 mm and u by 4 px, the error is 0.11 to 0.15 m (SD), with a mean of up to 0.15 m of its
    own for each subject and pose. The unknown height adds to this and is not included.

    Args:
        u: undistorted image points at depth one.
        behind_root_m: depth of each joint less that of the root.
        confidence: in [0, 1].
        skeleton: its limbs and the sides of its trunk are used.
        height_m: standing height of the person.

    Returns:
        NaN twice when fewer than three of the bones are seen at an angle that tells the distance.
    """
    bones, lengths_m = _bones(skeleton, height_m)
    a, b = bones.T
    z_a, z_b = behind_root_m[a], behind_root_m[b]
    along, offset_m, rise_m = u[a] - u[b], u[a] * z_a[:, None] - u[b] * z_b[:, None], z_a - z_b
    square, half = np.sum(along**2, axis=1), np.sum(along * offset_m, axis=1)
    discriminant = half**2 - square * (np.sum(offset_m**2, axis=1) + rise_m**2 - lengths_m**2)
    seen = (np.minimum(confidence[a], confidence[b]) >= _MIN_CONFIDENCE) & (discriminant > 0) & (square > 0)
    if seen.sum() < _MIN_BONES:
        return np.nan, np.nan
    # The derivative of the equation by Z; by L it is 2 L, by a difference of depth 2 rise_m.
    slope = np.sqrt(discriminant[seen])
    depths_m = (slope - half[seen]) / square[seen]
    sigmas_m = np.hypot(_LENGTH_SIGMA * lengths_m[seen] ** 2, _DEPTH_SIGMA_M * rise_m[seen]) / slope
    return _robust_mean(depths_m, sigmas_m)


def _bones(skeleton: Skeleton, height_m: float) -> tuple[Int[np.ndarray, "bone 2"], Float[np.ndarray, " bone"]]:
    """The limbs and the sides of the trunk, and their lengths in metres."""
    shares = [_SHARE_OF_HEIGHT[limb] for limb in LIMBS]
    sides = [(bone, share) for pair, share in zip(skeleton.limb_pairs, shares, strict=True) for bone in pair]
    for side in ("left", "right"):
        sides.append(((skeleton.index(f"{side}_hip"), skeleton.index(f"{side}_shoulder")), TRUNK))
    return np.array([bone for bone, _ in sides]), height_m * np.array([share for _, share in sides])


def _robust_mean(values: Float[np.ndarray, " n"], sigmas: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Weighted mean with Cauchy weights, and its standard deviation: from the sigmas or the scatter, the larger one."""
    mean, weights = float(np.median(values)), sigmas**-2
    for _ in range(_ITERATIONS):
        weights = sigmas**-2 / (1 + ((values - mean) / (CAUCHY_SCALE * sigmas)) ** 2)
        mean = float(weights @ values / weights.sum())
    chi2 = weights @ (values - mean) ** 2 / (len(values) - 1)
    return mean, float(np.sqrt(max(1.0, chi2) / weights.sum()))
