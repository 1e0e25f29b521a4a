"""A monocular network that always answers, as SAM 3D Body does: a body, where it is, and its projection as 2D."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import Camera


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
    centre_m = in_camera_m.mean(axis=1)
    relative_m = in_camera_m - centre_m[:, None]
    translation_m = centre_m * np.array([1.0, 1.0, focal_ratio])
    assumed_m = relative_m + translation_m[:, None]
    focal_px = focal_ratio * np.diag(camera.K)[:2]
    points2d_px = focal_px * assumed_m[..., :2] / assumed_m[..., 2:] + camera.K[:2, 2]
    return NetworkAnswers(relative_m, translation_m, points2d_px, float(focal_px[0]))
