"""How probable it is that a detection is of a person who is followed, against that it is of nobody known: by its place
in the image, and by the distance that per-view 3D tells.

The joints of one view share the error of their distance. So together they tell as much about who it is as one of them.
Across the rays per-view 3D says what the detection says already.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.association.pose_filter import SIGMA_M, Expected, RayResidual
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.per_view.view_depth import RELATIVE_SIGMA, ViewDepth
from fgpose.people_observations import Detections

# So many joints of a detection belong to another person, or to nothing, though the others are right.
_WRONG_SHARE = 0.1
# The joints of one image share their errors (timing, calibration, what the filter expects): together they tell as much
# as so many independent ones.
INDEPENDENT_JOINTS = 4.0
# A detection of which fewer joints fit is of somebody else; of which so many fit, of nobody else.
_MIN_FITTING, _NEARLY_ALL = 0.6, 0.8
# Joints that are taken wrongly are of the same body or of one next to it: somewhere in so much at each side.
_NEAR_M = 1.0
# One joint alone may be a false detection.
_MIN_JOINTS = 2
# Left and right are taken for exchanged where that is so many times as probable.
_MIRRORED_LOG_RATIO = np.log(1e3)


def score_of(log_ratio: Float[np.ndarray, "*shape joint"]) -> Float[np.ndarray, "*shape"]:
    """Log of the ratio of probabilities of a whole detection from those of its joints, of which some may be wrong; NaN:
    unknown."""
    known = np.isfinite(log_ratio)
    ratio = np.exp(np.minimum(np.where(known, log_ratio, 0.0), 50.0))
    joints = np.log((1 - _WRONG_SHARE) * ratio + _WRONG_SHARE)
    n_known = known.sum(axis=-1)
    mean = np.where(known, joints, 0.0).sum(axis=-1) / np.maximum(n_known, 1)
    return np.asarray(mean * np.minimum(n_known, INDEPENDENT_JOINTS))


def probability_of(log_ratio: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """That a measurement is of somebody, where so many of their detection's are not; 0 where it is unknown."""
    odds = np.exp(np.clip(log_ratio, -50.0, 50.0)) * ((1 - _WRONG_SHARE) / _WRONG_SHARE)
    return np.nan_to_num(odds / (1 + odds))


@dataclass(frozen=True, eq=False)
class Likelihood:
    """At most P detections in an image of each camera against K people; NaN where there is none."""

    log_ratio: Float[np.ndarray, "camera person detection joint"]
    """Density of the joint where this person is expected, over that of a joint anywhere in the image: those of somebody
    else may be anywhere."""
    near_share: Float[np.ndarray, "#camera #person 1 #joint"] = field(default_factory=lambda: np.ones((1, 1, 1, 1)))
    """Area in which the joints are that a detector takes wrongly for one of this person, over that of the image."""
    distance_log_ratio: Float[np.ndarray, "camera person detection"] | None = None
    """Density of the distance of a whole detection where this person is expected, over that of anybody; NaN: the camera
    does not tell it. None: no camera does."""

    @staticmethod
    def of(
        expected: Expected, undistorted_px: Float[np.ndarray, "camera detection joint 2"], cameras: CameraRig
    ) -> Likelihood:
        """Of all detections in an image of each of these cameras."""
        residual_px = undistorted_px[:, None] - expected.pixels[:, :, None]
        covariance_px2 = expected.covariance_px2[:, :, None]
        a, b, d = covariance_px2[..., 0, 0], covariance_px2[..., 0, 1], covariance_px2[..., 1, 1]
        determinant = a * d - b * b
        x, y = residual_px[..., 0], residual_px[..., 1]
        distance2 = (d * x * x - 2 * b * x * y + a * y * y) / determinant
        image_px2 = np.array([float(np.prod(camera.size_px)) for camera in cameras.cameras])[:, None, None, None]
        log_ratio = -0.5 * distance2 + np.log(image_px2 / (2 * np.pi * np.sqrt(determinant)))
        near_px = _NEAR_M / SIGMA_M * expected.sigma_px
        return Likelihood(log_ratio, near_px[:, :, None] ** 2 / image_px2)

    def with_camera(self, camera: int, other: Likelihood) -> Likelihood:
        """With the likelihood of the image of one camera in place of its own, by its number."""

        def changed(own: np.ndarray, new: np.ndarray) -> np.ndarray:
            own = own.copy()
            own[camera] = new[0]
            return own

        distance_log_ratio = None
        if self.distance_log_ratio is not None and other.distance_log_ratio is not None:
            distance_log_ratio = changed(self.distance_log_ratio, other.distance_log_ratio)
        log_ratio, near_share = changed(self.log_ratio, other.log_ratio), changed(self.near_share, other.near_share)
        return Likelihood(log_ratio, near_share, distance_log_ratio)

    @cached_property
    def probability(self) -> Float[np.ndarray, "camera person detection joint"]:
        """That a joint of the detection is that of the person, if the detection is; 0 where there is none."""
        log_ratio = self.log_ratio + np.log(self.near_share)
        return probability_of(log_ratio)

    @cached_property
    def score(self) -> Float[np.ndarray, "camera person detection"]:
        """Log of the ratio of probabilities of the whole detection; -inf where too little of it is known or fits."""
        n_known = np.isfinite(self.log_ratio).sum(axis=-1)
        enough = (n_known >= _MIN_JOINTS) & (self._n_fitting >= _MIN_FITTING * n_known)
        score = score_of(self.log_ratio)
        if self.distance_log_ratio is not None:
            score = score + score_of(self.distance_log_ratio[..., None])
        return np.where(enough, score, -np.inf)

    @cached_property
    def _n_fitting(self) -> Int[np.ndarray, "camera person detection"]:
        return np.asarray((self.probability > 0.5).sum(axis=-1))

    @cached_property
    def fits_pixels(self) -> Bool[np.ndarray, "camera person detection"]:
        """Whether nearly all of a detection is where the person is expected in the image."""
        known = np.isfinite(self.log_ratio).sum(axis=-1)
        return (self.score > 0) & (self._n_fitting >= _NEARLY_ALL * known)

    @cached_property
    def fits(self) -> Bool[np.ndarray, "camera person detection"]:
        """Whether it is also as far as the person, where that is known: nobody else is that near."""
        if self.distance_log_ratio is None:
            return self.fits_pixels
        elsewhere = np.isfinite(self.distance_log_ratio) & (probability_of(self.distance_log_ratio) < 0.5)
        return self.fits_pixels & ~elsewhere

    def mirrored_where_better(
        self, expected: Expected, undistorted_px: np.ndarray, cameras: CameraRig, mirror: Int[np.ndarray, " joint"]
    ) -> tuple[Likelihood, Int[np.ndarray, "camera person detection"]]:
        """With left and right exchanged where that is far more probable; and 1 there, -1 where it is far less probable,
        0 where it does not tell.

        Args:
            expected, undistorted_px, cameras: as this likelihood was made of.
            mirror: the joint on the other side of each.
        """
        exchanged = Likelihood.of(expected, undistorted_px[:, :, mirror], cameras)
        if self.distance_log_ratio is not None:
            exchanged = replace(exchanged, distance_log_ratio=self.distance_log_ratio)
        mirrored = exchanged.score > np.maximum(self.score, 0.0) + _MIRRORED_LOG_RATIO
        as_labelled = self.score > np.maximum(exchanged.score, 0.0) + _MIRRORED_LOG_RATIO
        log_ratio = np.where(mirrored[..., None], exchanged.log_ratio, self.log_ratio)
        return replace(self, log_ratio=log_ratio), mirrored.astype(int) - as_labelled


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

    def taken(self, values: Callable[[np.ndarray], np.ndarray]) -> Distances:
        """Of the joints of each person, in place of those of each detection."""
        return Distances(values(self.distance_m), values(self.variance_m2))

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
