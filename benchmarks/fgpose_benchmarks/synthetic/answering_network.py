"""A monocular network that always answers, as SAM 3D Body does: a body, where it is, and its projection as 2D."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.per_view.absolute_pose import UNSTATED_CONFIDENCE
from fgpose.io.keypoints.detections import ImageDetections, NetworkJoints, Provenance
from fgpose.io.keypoints.networks.placing import placed
from fgpose.observations import Observations
from fgpose.people_observations import NOTHING


@dataclass(frozen=True, eq=False)
class NetworkAnswers:
    """What the network gives for the images of one camera, each of one person."""

    relative_m: Float[np.ndarray, "frame joint 3"]
    """About the body, with the axes of the camera."""
    translation_m: Float[np.ndarray, "frame 3"]
    """To the frame of the camera, with the focal length that was assumed."""
    points2d_px: Float[np.ndarray, "frame joint 2"]
    """The projection of the sum of both with that focal length."""
    focal_px: float


def answers(points_m: Float[np.ndarray, "frame joint 3"], camera: Camera, focal_ratio: float = 1.0) -> NetworkAnswers:
    """The answers of a network that sees these joints.

    Its translation puts the body where it has its size in the image: with a focal length that is too long by a tenth,
    a tenth too far away.

    Args:
        points_m: of each image, with the errors of the network; world frame.
        camera: of the images, without lens distortion.
        focal_ratio: the focal length that the network assumes, over the true one.
    """
    in_camera_m = camera.to_camera_frame(points_m)
    centre_m = np.nanmean(in_camera_m, axis=1)
    relative_m = in_camera_m - centre_m[:, None]
    translation_m = centre_m * np.array([1.0, 1.0, focal_ratio])
    assumed_m = relative_m + translation_m[:, None]
    focal_px = focal_ratio * np.diag(camera.K)[:2]
    points2d_px = focal_px * assumed_m[..., :2] / assumed_m[..., 2:] + camera.K[:2, 2]
    return NetworkAnswers(relative_m, translation_m, points2d_px, float(focal_px[0]))


@dataclass(frozen=True)
class AnsweringNetwork:
    """What is wrong with such a network in a recording, beside the errors of its joints."""

    stature_sigma: float = 0.045
    """SD of how much taller it takes the person to be, relative: the same in all views, which put them farther away
    by as much."""
    focal_ratio: float = 1.0
    """The focal length that it assumes, over the true one."""


def as_read(observations: Observations, rig: CameraRig, network: AnsweringNetwork, seed: int) -> Observations:
    """What fgpose reads of the outputs of a network that sees a person as these observations say.

    It states no confidence, and its 2D joints are the projection of its 3D ones.

    Args:
        observations: with per-view 3D on the rays of the 2D joints, all hidden joints included.
        rig: the cameras, without lens distortion.
        network: what is wrong with it.
        seed: draws the stature.
    """
    assert observations.points3d_m is not None
    larger = 1.0 + network.stature_sigma * np.random.default_rng(seed).standard_normal()
    from_camera_m = observations.points3d_m - rig.positions_m[:, None]
    points_m = rig.positions_m[:, None] + larger * from_camera_m
    cameras = []
    for c, camera in enumerate(rig.cameras):
        found = answers(points_m[:, c], camera, network.focal_ratio)
        cameras.append({frame: _image(found, frame, camera) for frame in range(observations.n_frames)})
    images, _ = placed(cameras, rig, observations.skeleton, 1.0)
    of_camera = [[image for image in images if image.camera == camera.name] for camera in rig.cameras]
    arrays: dict[str, Any] = {
        name: np.stack([np.concatenate([getattr(image, name) for image in each]) for each in of_camera], axis=1)
        for name in NOTHING
    }
    return replace(observations, **arrays)


def _image(found: NetworkAnswers, frame: int, camera: Camera) -> ImageDetections:
    n_joints = found.relative_m.shape[1]
    seen = np.isfinite(found.points2d_px[frame]).all(axis=-1)
    return ImageDetections(
        source=Provenance(Path(f"{frame:06d}.pkl"), camera.name, frame),
        points2d_px=found.points2d_px[frame][None],
        confidence=np.where(seen, UNSTATED_CONFIDENCE, 0.0)[None],
        points3d=found.relative_m[frame][None],
        n_given=n_joints,
        of_network=NetworkJoints(
            "simulated",
            translation=found.translation_m[frame][None],
            focal_px=np.array([found.focal_px]),
            sigma_m=np.full((1, n_joints), np.nan),
        ),
    )
