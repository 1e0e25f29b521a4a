"""Lenses as the adjustment changes them: OpenCV's models, their free numbers, and what changes of them do to pixels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import Camera
from fgpose.geometry.lens import LensModel

N_OF_LENS = 12
"""fx, fy, cx, cy (pixels), then k1, k2, p1, p2, k3 to k6 of the pinhole model or k1 to k4 of fisheye."""
N_COEFFICIENTS: Mapping[LensModel, int] = {"pinhole": 8, "fisheye": 4}
_NAMES: Mapping[LensModel, tuple[str, ...]] = {
    "pinhole": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "fisheye": ("k1", "k2", "k3", "k4"),
}
_SIZES = (0, 4, 5, 8)  # of the coefficients of a pinhole camera


@dataclass(frozen=True)
class LensKind:
    """Which numbers of a lens are free; the other coefficients are zero."""

    model: LensModel = "pinhole"
    n_distortion: int = 5
    """The first so many coefficients: 0, 1, 2, 4, 5 or 8 (the rational model) of pinhole, 4 of fisheye."""
    centre: bool = True
    """Whether the principal point is free, or the middle of the image."""
    square: bool = True
    """Whether both axes of the image have one focal length."""
    held: bool = False
    """Nothing is free: the lens is as given."""

    @property
    def columns(self) -> Float[np.ndarray, "12 free"]:
        """Changes of a lens by its free numbers: log of the focal length(s), principal point as a share of the focal
        length, coefficients."""
        rows = [] if self.held else [[0, 1]] if self.square else [[0], [1]]
        if not self.held:
            rows += [[2], [3]] if self.centre else []
            rows += [[4 + k] for k in range(self.n_distortion)]
        columns = np.zeros((N_OF_LENS, len(rows)))
        for free, changed in enumerate(rows):
            columns[changed, free] = 1.0
        return columns

    @property
    def text(self) -> str:
        """As "pinhole, k1 k2 p1 p2"."""
        told = " ".join(_NAMES[self.model][: self.n_distortion]) or "no distortion"
        return f"{self.model}, {told}" + ("" if self.square else ", two focal lengths")


def moved_lens(lens: Float[np.ndarray, " 12"], change: Float[np.ndarray, " 12"]) -> Float[np.ndarray, " 12"]:
    """After a change as of LensKind.columns."""
    focal_px = np.sqrt(lens[0] * lens[1])
    moved = lens + change
    moved[:2], moved[2:4] = lens[:2] * np.exp(change[:2]), lens[2:4] + focal_px * change[2:4]
    return moved


def image_of(
    points_m: Float[np.ndarray, "point 3"], lens: Float[np.ndarray, " 12"], model: LensModel
) -> tuple[Float[np.ndarray, "point 2"], Float[np.ndarray, "point 2 3"], Float[np.ndarray, "point 2 12"]]:
    """Pixels of points in the frame of the camera, and their Jacobians by the points and by changes of the lens."""
    import cv2

    K, coefficients = matrix_of(lens), lens[4 : 4 + N_COEFFICIENTS[model]]
    zero, n = np.zeros(3), len(points_m)
    if not n:
        return np.zeros((0, 2)), np.zeros((0, 2, 3)), np.zeros((0, 2, N_OF_LENS))
    by_lens = np.zeros((n, 2, N_OF_LENS))
    source = np.ascontiguousarray(points_m)[:, None]
    if model == "fisheye":
        image, jacobian = cv2.fisheye.projectPoints(source, zero, zero, K, coefficients)
        # Focal lengths, principal point, coefficients, rotation, translation, skew.
        jacobian = jacobian.reshape(n, 2, -1)
        by_lens[..., :8], by_point = jacobian[..., :8], jacobian[..., 11:14]
    else:
        image, jacobian = cv2.projectPoints(source, zero, zero, K, coefficients)
        # Rotation, translation, focal lengths, principal point, coefficients.
        jacobian = jacobian.reshape(n, 2, -1)
        by_point, by_lens[...] = jacobian[..., 3:6], jacobian[..., 6 : 6 + N_OF_LENS]
    by_lens[..., :2] *= lens[:2]
    by_lens[..., 2:4] *= np.sqrt(lens[0] * lens[1])
    return image.reshape(n, 2), by_point, by_lens


def matrix_of(lens: Float[np.ndarray, " 12"]) -> Float[np.ndarray, "3 3"]:
    """K."""
    return np.array([[lens[0], 0.0, lens[2]], [0.0, lens[1], lens[3]], [0.0, 0.0, 1.0]])


def numbers_of(camera: Camera) -> Float[np.ndarray, " 12"]:
    """Of a camera that is known."""
    K, numbers = camera.K, np.zeros(N_OF_LENS)
    numbers[:4] = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    numbers[4 : 4 + camera.distortion.size] = camera.distortion
    return numbers


def camera_of(
    name: str,
    size_px: Sequence[int],
    lens: Float[np.ndarray, " 12"],
    kind: LensKind,
    world_T_camera: Float[np.ndarray, "4 4"],
) -> Camera:
    """The camera with these numbers."""
    n_used = int(np.flatnonzero(lens[4:]).max(initial=-1)) + 1
    n = 4 if kind.model == "fisheye" else next(size for size in _SIZES if size >= n_used)
    return Camera(name, (size_px[0], size_px[1]), matrix_of(lens), world_T_camera, lens[4 : 4 + n], kind.model)
