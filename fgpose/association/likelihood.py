"""How probable it is that a detection is of a person who is followed, against that it is of nobody known."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.association.pose_filter import SIGMA_M, Expected
from fgpose.geometry.camera import CameraRig

# So many joints of a detection belong to another person, or to nothing, though the others are right.
_WRONG_SHARE = 0.1
# The joints of one image share their errors (timing, calibration, what the filter expects): together they tell as much
# as so many independent ones.
_INDEPENDENT_JOINTS = 4.0
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
    return np.asarray(mean * np.minimum(n_known, _INDEPENDENT_JOINTS))


def probability_of(log_ratio: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """That a measurement is of somebody, where so many of their detection's are not; 0 where it is unknown."""
    odds = np.exp(np.clip(log_ratio, -50.0, 50.0)) * ((1 - _WRONG_SHARE) / _WRONG_SHARE)
    return np.nan_to_num(odds / (1 + odds))


@dataclass(frozen=True, eq=False)
class Likelihood:
    """At most P detections in an image of each camera against K people; NaN where there is none."""

    residual_px: Float[np.ndarray, "camera person detection joint 2"]
    """Detected less expected, undistorted pixels."""
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
        return Likelihood(residual_px, log_ratio, near_px[:, :, None] ** 2 / image_px2)

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
    ) -> tuple[Likelihood, Bool[np.ndarray, "camera person detection"]]:
        """With left and right exchanged where that is far more probable, and where.

        Args:
            expected, undistorted_px, cameras: as this likelihood was made of.
            mirror: the joint on the other side of each.
        """
        exchanged = Likelihood.of(expected, undistorted_px[:, :, mirror], cameras)
        if self.distance_log_ratio is not None:
            exchanged = replace(exchanged, distance_log_ratio=self.distance_log_ratio)
        mirrored = exchanged.score > np.maximum(self.score, 0.0) + _MIRRORED_LOG_RATIO
        better = Likelihood(
            np.where(mirrored[..., None, None], exchanged.residual_px, self.residual_px),
            np.where(mirrored[..., None], exchanged.log_ratio, self.log_ratio),
            self.near_share,
            self.distance_log_ratio,
        )
        return better, mirrored
