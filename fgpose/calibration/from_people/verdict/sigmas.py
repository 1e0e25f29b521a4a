"""How sure the cameras are: what the adjustment says, corrected by how much two halves of the recording disagree, and
the whole with both.

The marginals of a bundle adjustment take the errors of detections for independent noise. They are biased depending on
the view, so the marginals are far too small (13 times on a recording with known cameras). Two halves of a recording
disagree by what the errors really do, but for what a walker does in both. The whole is about in the middle of its
halves; where it is not, as when a camera was moved in between, it is off by that too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.assessment.rig_alignment import Similarity
from fgpose.calibration.from_people.calibrated import CameraSigmas
from fgpose.calibration.from_people.verdict.alignment import about_centroid, aligned
from fgpose.geometry.camera import CameraRig

# What all cameras together say of the inflation counts as so many numbers beside a camera's own disagreement, which has
# three, of its rotation or its position.
_COMMON_FREEDOM, _OWN_FREEDOM = 6.0, 3.0
# Of variances that no halves check. Calibrations of one recording of 1.7 s from two networks (balance_blazepose and
# balance_openpose) differ by 1.5 to 1.8 standard deviations of the difference.
_UNCHECKED = 1.7**2


@dataclass(frozen=True, eq=False)
class RigEstimate:
    """A rig from an adjustment, in any gauge."""

    rig: CameraRig
    covariance: Float[np.ndarray, "camera 6 camera 6"]
    """Of the errors of each camera in its own frame: rotation vector (radians), then translation (unit of the rig)."""
    focal_sigma: Float[np.ndarray, " camera"]
    """Standard deviation of the focal length, as a share of it; zero where it was given."""
    offset_sigma_s: Float[np.ndarray, " camera"]
    """Standard deviation of the start, relative to the first camera; zero where it was given."""

    @staticmethod
    def of(rig: CameraRig, covariance: Float[np.ndarray, "camera k camera k"], focal: int, offset: int) -> RigEstimate:
        """From the joint covariance of all unknowns of the cameras, in whatever gauge.

        Args:
            rig: from an adjustment.
            covariance: the first six unknowns are those of the pose, as above.
            focal: which one is the logarithm of the focal length.
            offset: which one is the time offset, seconds.
        """
        sigmas = np.sqrt(np.einsum("cici->ci", covariance))
        return RigEstimate(rig, covariance[:, :6, :, :6], sigmas[:, focal], sigmas[:, offset])

    def moved(self, similarity: Similarity) -> RigEstimate:
        """In another gauge and unit."""
        units = np.repeat([1.0, similarity.scale], 3)
        covariance = units[:, None, None] * self.covariance * units
        return RigEstimate(similarity.rig(self.rig), covariance, self.focal_sigma, self.offset_sigma_s)

    def aligned(self, onto: CameraRig) -> RigEstimate:
        """In the gauge of another rig of the same cameras."""
        return self.moved(aligned(self.rig, onto)[0])

    def variances(self) -> Variances:
        """Of each camera, about the centroid of the rig."""
        covariance = about_centroid(self.covariance, self.rig)
        of_errors = np.einsum("cici->ci", covariance).reshape(-1, 2, 3).sum(axis=-1)
        return Variances(of_errors[:, 0], of_errors[:, 1], self.focal_sigma**2, self.offset_sigma_s**2)


@dataclass(frozen=True, eq=False)
class Variances:
    """Squares of the errors of each camera, or what is expected of them; rotation and position: sums over the axes."""

    rotation_rad2: Float[np.ndarray, " camera"]
    position_m2: Float[np.ndarray, " camera"]
    focal2: Float[np.ndarray, " camera"]
    """Shares of the focal length, squared."""
    offset_s2: Float[np.ndarray, " camera"]

    def plus(self, other: Variances) -> Variances:
        return Variances(**{name: own + getattr(other, name) for name, own in vars(self).items()})

    def times(self, factor: float | Float[np.ndarray, " camera"]) -> Variances:
        return Variances(**{name: factor * own for name, own in vars(self).items()})

    def inflated(self, expected: Variances, observed: Variances) -> Variances:
        """By the ratio of what was observed to what was expected; never made smaller."""
        poses = (expected.rotation_rad2, observed.rotation_rad2), (expected.position_m2, observed.position_m2)
        ratios = [_ratios(*pose) for pose in poses]
        known = np.concatenate([ratio[np.isfinite(ratio)] for ratio in ratios])
        # The variance of Student's distribution: with two cameras the ratio rests on five numbers.
        freedom = 6 * len(self.focal2) - 7
        common = float(known.mean()) * freedom / max(freedom - 2, 1) if known.size else 1.0
        return Variances(
            self.rotation_rad2 * _growth(ratios[0], common, _OWN_FREEDOM),
            self.position_m2 * _growth(ratios[1], common, _OWN_FREEDOM),
            self.focal2 * _own_growth(expected.focal2, observed.focal2),
            self.offset_s2 * _own_growth(expected.offset_s2, observed.offset_s2),
        )


def disagreement(first: CameraRig, second: CameraRig) -> Variances:
    """Squared differences of two rigs of the same cameras after the similarity that makes them smallest; in the unit of
    the second one."""
    _, errors = aligned(first, second)
    square = np.sum(errors.reshape(-1, 2, 3) ** 2, axis=-1)
    focal = np.log(first.focal_px / second.focal_px)
    offsets_s = first.time_offsets_s - second.time_offsets_s
    return Variances(square[:, 0], square[:, 1], focal**2, (offsets_s - offsets_s[0]) ** 2)


def beside_halves(whole: RigEstimate, halves: tuple[CameraRig, CameraRig]) -> Variances:
    """Squared distances of the poses and focal lengths of a rig from the middle of those of the halves of its
    recording, in its unit.

    Both halves see the walker from the same sides, and errors that depend on these set the focal lengths of both alike,
    but not as those of the whole, which weighs the sides otherwise. One number of a camera may be small by chance: all
    focal lengths that are unknown have the mean.
    """
    middle = np.mean([aligned(half, whole.rig)[1] for half in halves], axis=0)
    square, nothing = np.sum(middle.reshape(-1, 2, 3) ** 2, axis=-1), np.zeros(whole.rig.n_cameras)
    focal = np.mean([np.log(half.focal_px / whole.rig.focal_px) for half in halves], axis=0) ** 2
    unknown = whole.focal_sigma > 0
    common = np.mean(focal, where=unknown) if unknown.any() else 0.0
    return Variances(square[:, 0], square[:, 1], np.where(unknown, common, 0.0), nothing)


def camera_sigmas(
    whole: RigEstimate,
    halves: tuple[RigEstimate, RigEstimate] | None,
    scale: float,
    vertical_deg: float,
    floor_m: float,
    of_lenses: RigEstimate | None = None,
    unchecked: Bool[np.ndarray, " camera"] | None = None,
    walker_m: float = 0.0,
) -> CameraSigmas:
    """Standard deviations of the cameras about the centroid of the rig.

    Args:
        whole: from the whole recording, in metres.
        halves: from its halves, in any gauge; None: the recording is too short to be halved, and all are inflated by
            what has been seen of such recordings.
        scale: standard deviation of the scale, as a share.
        vertical_deg: standard deviation of the vertical.
        floor_m: of the floor below the walker.
        of_lenses: the whole, with the errors that come of focal lengths that were given; None: there are none.
        unchecked: cameras whose halves share their errors, so that they do not check each other; None: none.
        walker_m: how high the walker is against the cameras, by what the adjustment says.
    """
    variances = whole.variances()
    if halves is None:
        variances = variances.times(_UNCHECKED)
    else:
        first, second = (half.aligned(whole.rig) for half in halves)
        expected = first.variances().plus(second.variances())
        variances = variances.inflated(expected, disagreement(first.rig, second.rig))
        variances = variances.plus(beside_halves(whole, (first.rig, second.rig)))
        if unchecked is not None:
            variances = variances.times(np.where(unchecked, _UNCHECKED, 1.0))
    if of_lenses is not None:
        variances = variances.plus(of_lenses.variances())
    # The walker is off as the cameras are, who are off by more than the adjustment says.
    growth = np.sqrt(np.mean(variances.position_m2) / max(float(np.mean(whole.variances().position_m2)), 1e-12))
    return CameraSigmas(
        position_m=np.sqrt(variances.position_m2),
        direction_deg=np.rad2deg(np.sqrt(variances.rotation_rad2)),
        focal=np.sqrt(variances.focal2),
        offset_s=np.sqrt(variances.offset_s2),
        scale=scale,
        vertical_deg=vertical_deg,
        floor_m=float(np.hypot(floor_m, growth * walker_m)),
    )


def _own_growth(
    expected: Float[np.ndarray, " camera"], observed: Float[np.ndarray, " camera"]
) -> Float[np.ndarray, " camera"]:
    ratios = _ratios(expected, observed)
    known = ratios[np.isfinite(ratios)]
    return _growth(ratios, float(known.mean()) if known.size else 1.0, 1.0)


def _ratios(
    expected: Float[np.ndarray, " camera"], observed: Float[np.ndarray, " camera"]
) -> Float[np.ndarray, " camera"]:
    """Of observed to expected squares; NaN where nothing is expected, as of a focal length that was given."""
    return np.divide(observed, expected, out=np.full_like(observed, np.nan), where=expected > 0)


def _growth(ratios: Float[np.ndarray, " camera"], common: float, own_freedom: float) -> Float[np.ndarray, " camera"]:
    """Of each variance, by what all cameras say and by its own ratio."""
    own = np.where(np.isfinite(ratios), ratios, common)
    return np.maximum((_COMMON_FREEDOM * common + own_freedom * own) / (_COMMON_FREEDOM + own_freedom), 1.0)
