"""How far people are from each camera, as its per-view 3D says: one further measurement of each detection.

The joints of one view share the error of their distance. So together they tell as much about who it is as one of them.
Across the rays per-view 3D says what the detection says already.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fgpose.association.likelihood import probability_of
from fgpose.association.matching import Matches
from fgpose.association.pose_filter import SIGMA_M, Expected, RayResidual
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.view_depth import RELATIVE_SIGMA, ViewDepth
from fgpose.people_observations import NOBODY, Detections


@dataclass(frozen=True, eq=False)
class Distances:
    """Of the joints of detections, or of what is matched to people, from their camera; NaN where it is not told."""

    distance_m: Float[np.ndarray, "camera detection joint"]
    variance_m2: Float[np.ndarray, "camera detection joint"]
    """Of a distance around the true one."""

    @staticmethod
    def of(images: Sequence[Detections], cameras: CameraRig) -> Distances | None:
        """Of an image of each of these cameras; None where none has per-view 3D."""
        if all(image.points3d_m is None for image in images):
            return None
        distance_m, variance_m2 = [], []
        for camera, image in zip(cameras.cameras, images, strict=True):
            points3d_m = image.points3d_m
            if points3d_m is None:
                points3d_m = np.full((*image.confidence.shape, 3), np.nan)
            depth = ViewDepth.of(points3d_m, image.covariance3d_m2, camera.position_m)
            sigma_m = np.where(np.isnan(depth.sigma_m), RELATIVE_SIGMA * depth.distance_m, depth.sigma_m)
            distance_m.append(depth.distance_m)
            variance_m2.append(sigma_m**2 + SIGMA_M**2)
        return Distances(padded(distance_m, np.nan), padded(variance_m2, np.nan))

    @staticmethod
    def together(of_cameras: Sequence[tuple[Distances | None, int]], n_joints: int) -> Distances | None:
        """From those of one camera each, and how many detections it has."""
        if all(distances is None for distances, _ in of_cameras):
            return None
        own = [
            np.full((2, n, n_joints), np.nan)
            if distances is None
            else np.stack([distances.distance_m[0], distances.variance_m2[0]])
            for distances, n in of_cameras
        ]
        return Distances(*(padded([each[n] for each in own], np.nan) for n in range(2)))

    def __getitem__(self, cameras: slice) -> Distances:
        return Distances(self.distance_m[cameras], self.variance_m2[cameras])

    def matched(self, matches: Matches) -> Distances:
        """Of the joints that are matched to each person, in place of those of each detection."""
        return Distances(matches.of(self.distance_m, np.nan), matches.of(self.variance_m2, np.nan))

    def chosen(self, detection: Int[np.ndarray, "camera person"]) -> Distances:
        """Of the detection of each person, or NOBODY."""
        camera, own = np.arange(len(detection))[:, None], np.maximum(detection, 0)
        nothing = (detection == NOBODY)[..., None]
        return Distances(
            *(np.where(nothing, np.nan, each[camera, own]) for each in (self.distance_m, self.variance_m2))
        )

    def log_ratio(self, expected: Expected) -> Float[np.ndarray, "camera person detection"]:
        """Of every detection against every person; see log_ratio_of."""
        distance_m = expected.distance_m[:, :, None]
        variance_m2 = self.variance_m2[:, None] + expected.distance_variance_m2[:, :, None]
        return log_ratio_of(self.distance_m[:, None] - distance_m, variance_m2, distance_m)

    def against(self, expected: Expected) -> RayResidual:
        """Of what is matched to each person: a measurement of their joints, by how probable it is that it is right."""
        residual_m = self.distance_m - expected.distance_m
        log_ratio = log_ratio_of(residual_m, self.variance_m2 + expected.distance_variance_m2, expected.distance_m)
        return RayResidual(residual_m, probability_of(log_ratio)[..., None] / self.variance_m2)


def log_ratio_of(
    residual_m: Float[np.ndarray, "*shape joint"],
    variance_m2: Float[np.ndarray, "*#shape joint"],
    distance_m: Float[np.ndarray, "*#shape joint"],
) -> Float[np.ndarray, "*shape"]:
    """Log of the density of the distance of a detection where somebody is expected, over that of anybody; NaN: unknown.

    Anybody may be anywhere on the ray, from the camera to twice as far as the person.

    Args:
        residual_m: of the joints of a detection, whose errors are one and the same.
        variance_m2: of each residual.
        distance_m: that is expected.
    """
    known = np.isfinite(residual_m) & np.isfinite(variance_m2)
    information = np.where(known, 1.0 / np.where(known, variance_m2, 1.0), 0.0)
    total, n_known = information.sum(axis=-1), known.sum(axis=-1)
    is_known = n_known > 0
    total = np.where(is_known, total, 1.0)
    mean_m = np.where(known, residual_m, 0.0) * information
    mean_m, expected_m = (
        np.sum(each, axis=-1) / total for each in (mean_m, np.where(known, distance_m, 0.0) * information)
    )
    precision = total / np.maximum(n_known, 1)
    density = np.sqrt(precision / (2 * np.pi)) * 2 * np.where(is_known, expected_m, 1.0)
    return np.where(is_known, np.log(density) - 0.5 * mean_m**2 * precision, np.nan)


def padded(of_cameras: Sequence[np.ndarray], fill: float) -> np.ndarray:
    """(C, P, ...) from arrays (P, ...) of each camera, in which detections may be differently many."""
    array = np.full((len(of_cameras), max(map(len, of_cameras)), *of_cameras[0].shape[1:]), fill)
    for own, values in zip(array, of_cameras, strict=True):
        own[: len(values)] = values
    return array
