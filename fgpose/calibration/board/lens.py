"""Lenses as the adjustment changes them: OpenCV's models, their free numbers, and what changes of them do to pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import Camera
from fgpose.geometry.lens import LensModel

N_OF_LENS = 9
"""fx, fy, cx, cy (pixels), then k1, k2, p1, p2, k3 of the pinhole model or k1 to k4 of fisheye."""
_N_COEFFICIENTS = {"pinhole": 5, "fisheye": 4}


@dataclass(frozen=True)
class LensKind:
    """Which numbers of a lens are free; the other coefficients are zero."""

    model: LensModel = "pinhole"
    n_distortion: int = 5
    """The first so many coefficients: 0, 1, 2, 4 or 5 of pinhole, 4 of fisheye."""
    centre: bool = True
    """Whether the principal point is free, or the middle of the image."""
    square: bool = True
    """Whether both axes of the image have one focal length."""
    held: bool = False
    """Nothing is free: the lens is as given."""

    @property
    def columns(self) -> Float[np.ndarray, "9 free"]:
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
        names = ["k1", "k2", "k3", "k4"] if self.model == "fisheye" else ["k1", "k2", "p1", "p2", "k3"]
        told = " ".join(names[: self.n_distortion]) or "no distortion"
        return f"{self.model}, {told}" + ("" if self.square else ", two focal lengths")


def moved_lens(lens: Float[np.ndarray, " 9"], change: Float[np.ndarray, " 9"]) -> Float[np.ndarray, " 9"]:
    """After a change as of LensKind.columns."""
    focal_px = np.sqrt(lens[0] * lens[1])
    moved = lens + change
    moved[:2], moved[2:4] = lens[:2] * np.exp(change[:2]), lens[2:4] + focal_px * change[2:4]
    return moved


def image_of(
    points_m: Float[np.ndarray, "point 3"], lens: Float[np.ndarray, " 9"], model: LensModel
) -> tuple[Float[np.ndarray, "point 2"], Float[np.ndarray, "point 2 3"], Float[np.ndarray, "point 2 9"]]:
    """Pixels of points in the frame of the camera, and their Jacobians by the points and by changes of the lens."""
    import cv2

    K, coefficients = matrix_of(lens), lens[4 : 4 + _N_COEFFICIENTS[model]]
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


def matrix_of(lens: Float[np.ndarray, " 9"]) -> Float[np.ndarray, "3 3"]:
    """K."""
    return np.array([[lens[0], 0.0, lens[2]], [0.0, lens[1], lens[3]], [0.0, 0.0, 1.0]])


def numbers_of(camera: Camera) -> Float[np.ndarray, " 9"]:
    """Of a camera that is known. Raises ValueError if its lens has more coefficients than are known here."""
    n = _N_COEFFICIENTS[camera.lens]
    if camera.distortion[n:].any():
        raise ValueError(f"camera {camera.name}: a lens with {camera.distortion.size} coefficients cannot be held")
    K, numbers = camera.K, np.zeros(N_OF_LENS)
    numbers[:4] = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    numbers[4 : 4 + len(camera.distortion[:n])] = camera.distortion[:n]
    return numbers


def camera_of(
    name: str,
    size_px: Sequence[int],
    lens: Float[np.ndarray, " 9"],
    kind: LensKind,
    world_T_camera: Float[np.ndarray, "4 4"],
) -> Camera:
    """The camera with these numbers."""
    n = 4 if kind.model == "fisheye" else 0 if not lens[4:].any() else 4 if not lens[8] else 5
    return Camera(name, (size_px[0], size_px[1]), matrix_of(lens), world_T_camera, lens[4 : 4 + n], kind.model)
