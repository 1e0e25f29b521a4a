"""How sure a calibration with boards is, from the covariance of the adjustment."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fgpose.calibration.board.adjusting import AdjustedBoards
from fgpose.calibration.board.lens import N_OF_LENS, image_of, numbers_of
from fgpose.calibration.board.problem import CLOCK, LENS, N_OF_CAMERA, POSE, cross_matrix
from fgpose.calibration.from_people.verdict.alignment import onto_centroid
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.shown import Shown

_GRID = 9  # points along each side of the image


@dataclass(frozen=True, eq=False, repr=False)
class BoardSigmas(Shown):
    """Standard deviations of the cameras, about the centroid of the rig, from the errors of the corners and how far
    moments disagree. What is wrong with the board at all moments alike, its scale first, is not in them."""

    position_m: Float[np.ndarray, " camera"]
    """Of the place, root of the sum over the axes."""
    direction_deg: Float[np.ndarray, " camera"]
    """Of the rotation, root of the sum over the axes."""
    focal: Float[np.ndarray, " camera"]
    """Of the focal length, as a share of it; zero where it was given."""
    border_px: Float[np.ndarray, " camera"]
    """Of what the lens does to a pixel, where on the border of the image that is known worst; zero where it was given.
    What a turn of the camera does is not counted."""
    start_s: Float[np.ndarray, " camera"]
    """Of when it began after the first camera; zero where all have one clock."""
    disagreement: float = 1.0
    """How many times as large all of these are as the noise of the corners alone would make them, see BoardProblem."""

    def times(self, factor: float) -> BoardSigmas:
        """All of them larger."""
        return BoardSigmas(**{name: factor * own for name, own in vars(self).items()})

    def with_moves(
        self, moved_m: Float[np.ndarray, " camera"], turned_deg: Float[np.ndarray, " camera"]
    ) -> BoardSigmas:
        """With errors of the poses that come of something else."""
        position_m, direction_deg = np.hypot(self.position_m, moved_m), np.hypot(self.direction_deg, turned_deg)
        return replace(self, position_m=position_m, direction_deg=direction_deg)


def board_sigmas(adjusted: AdjustedBoards, rig: CameraRig) -> BoardSigmas:
    """Infinite where the views do not determine the cameras."""
    n_cameras = rig.n_cameras
    try:
        covariance = about_centroid(adjusted.problem.covariance(adjusted.bundle), rig)
    except np.linalg.LinAlgError:
        unknown = np.full(n_cameras, np.inf)
        return BoardSigmas(unknown, unknown, unknown, unknown, unknown)
    disagreement = max(adjusted.problem.disagreement(adjusted.bundle), 1.0)
    covariance *= disagreement**2
    variances = np.einsum("cici->ci", covariance)
    of_lens = [covariance[c, LENS, c, LENS] for c in range(n_cameras)]
    return BoardSigmas(
        position_m=np.sqrt(variances[:, 3:6].sum(axis=1)),
        direction_deg=np.rad2deg(np.sqrt(variances[:, :3].sum(axis=1))),
        focal=np.sqrt(variances[:, LENS.start : LENS.start + 2].mean(axis=1)),
        border_px=np.array([_border_px(camera, own) for camera, own in zip(rig.cameras, of_lens, strict=True)]),
        start_s=np.sqrt(variances[:, CLOCK]),
        disagreement=disagreement,
    )


def about_centroid(
    covariance: Float[np.ndarray, "camera 19 camera 19"], rig: CameraRig
) -> Float[np.ndarray, "camera 19 camera 19"]:
    """Of what no motion of the whole rig explains; lenses as they are. Zero for the pose of a single camera."""
    n_cameras = rig.n_cameras
    projection = np.eye(n_cameras * N_OF_CAMERA).reshape(n_cameras, N_OF_CAMERA, n_cameras, N_OF_CAMERA)
    of_poses = onto_centroid(rig, with_scale=False) if n_cameras > 1 else np.zeros((6, 6))
    projection[:, POSE, :, POSE] = of_poses.reshape(n_cameras, 6, n_cameras, 6)
    flat = projection.reshape(n_cameras * N_OF_CAMERA, -1)
    return (flat @ covariance.reshape(flat.shape) @ flat.T).reshape(covariance.shape)


def _border_px(camera: Camera, covariance: Float[np.ndarray, "12 12"]) -> float:
    """See BoardSigmas."""
    rays = rays_of(camera)
    _, _, by_lens = image_of(rays, numbers_of(camera), camera.lens)
    by_lens = beyond_turns(camera, rays, by_lens.reshape(-1, N_OF_LENS))
    variance = np.einsum("nk,kl,nl->n", by_lens, covariance, by_lens).reshape(-1, 2).sum(axis=1)
    return float(np.sqrt(max(variance.max(initial=0.0), 0.0)))


def rays_of(camera: Camera) -> Float[np.ndarray, "point 3"]:
    """Where pixels all over the image look, in the frame of the camera, as far as the lens tells."""
    width, height = camera.size_px
    x, y = np.meshgrid(np.linspace(0, width - 1, _GRID), np.linspace(0, height - 1, _GRID))
    undistorted_px = camera.undistort(np.stack([x.ravel(), y.ravel()], axis=1))
    known_px = undistorted_px[np.isfinite(undistorted_px).all(axis=1)]
    return np.concatenate([(known_px - camera.K[:2, 2]) / np.diag(camera.K)[:2], np.ones((len(known_px), 1))], axis=1)


def beyond_turns(
    camera: Camera, rays: Float[np.ndarray, "point 3"], moves_px: Float[np.ndarray, "coordinate column"]
) -> Float[np.ndarray, "coordinate column"]:
    """What no small turn of the camera explains of moves of the pixels that rays meet."""
    _, by_ray, _ = image_of(rays, numbers_of(camera), camera.lens)
    by_turn = (by_ray @ cross_matrix(rays)).reshape(-1, 3)
    return moves_px - by_turn @ np.linalg.lstsq(by_turn, moves_px, rcond=None)[0]
