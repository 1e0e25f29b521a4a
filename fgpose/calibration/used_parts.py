"""The part of a recording that a calibration uses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from jaxtyping import Float, Int

from fgpose.calibration.adjustment.scores import Stretch
from fgpose.calibration.adjustment.unknowns import OFFSET, ROTATION, TRANSLATION
from fgpose.config import Config
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate_robust
from fgpose.observations import Observations
from fgpose.sampling import fair_limits, spread_evenly, usual_step_s

# A camera that is off by a degree moves its detections by 20 to 30 px: with the usual threshold it would never be
# an inlier, and could not be calibrated.
_INLIER_FACTOR = 2.5


class Ending(Enum):
    """How a calibration ended."""

    SETTLED = "settled"
    """The last round changed nothing, and its optimisers have converged."""
    ROUNDS = "rounds"
    """The last of calibration.max_rounds rounds still changed the cameras."""
    MOTION = "motion"
    """The smoother of the motion was stopped: solver.max_iterations."""
    ADJUSTMENT = "adjustment"
    """The bundle adjustment was stopped: what the cameras saw hardly determines them."""

    @staticmethod
    def of(*, smoothed: bool, settled: bool, adjusted: bool) -> Ending:
        """The first reason: from a motion that has not converged nothing else does."""
        if not smoothed:
            return Ending.MOTION
        if not settled:
            return Ending.ROUNDS
        return Ending.SETTLED if adjusted else Ending.ADJUSTMENT

    @property
    def converged(self) -> bool:
        return self is Ending.SETTLED


@dataclass(frozen=True, eq=False)
class Adjusted:
    """A rig, and the detections that it was adjusted to; those of several people one after the other."""

    rig: CameraRig
    undistorted_px: Float[np.ndarray, "frame camera joint 2"]
    """Of the frames that were used, where they would be if all cameras were synchronous."""
    confidence: Float[np.ndarray, "frame camera joint"]
    ending: Ending
    shift_sigma_m: float
    """See RigRefinement; 0 if the poses of the cameras were held."""
    covariance: Float[np.ndarray, "camera 11 camera 11"]
    """Of small changes of each camera (unknowns.N_OF_CAMERA) in its own frame, by the errors that its detections have;
    zero for what was held."""

    @property
    def rotation_sigma_deg(self) -> Float[np.ndarray, " camera"]:
        """About each axis, root mean square."""
        return np.rad2deg(self._sigma(ROTATION))

    @property
    def translation_sigma_m(self) -> Float[np.ndarray, " camera"]:
        """Of each coordinate, root mean square."""
        return self._sigma(TRANSLATION)

    @property
    def offset_sigma_s(self) -> Float[np.ndarray, " camera"]:
        """Of the time offsets."""
        return self._sigma(slice(OFFSET, OFFSET + 1))

    def _sigma(self, rows: slice) -> Float[np.ndarray, " camera"]:
        return np.sqrt(np.mean(np.einsum("cici->ci", self.covariance)[:, rows], axis=1))


def seen_by_two(people: Sequence[Observations]) -> list[Observations]:
    """Those of whom two cameras see a joint at a time; everybody if there is nobody."""
    known = [own for own in people if (own.seen.sum(axis=1) >= 2).any()]
    return known or list(people)


def best_seen_of_each(people: Sequence[Observations], duration_s: float) -> list[Observations]:
    """Of each person the part in which they are seen best, all together of this duration."""
    wanted_s = [float(own.frame_time_s[-1] - own.frame_time_s[0]) for own in people]
    return [best_seen(own, limit_s) for own, limit_s in zip(people, fair_limits(wanted_s, duration_s), strict=True)]


def best_seen(observations: Observations, duration_s: float) -> Observations:
    """The part of this duration in which two cameras see the most joints; the middle if all parts are equal."""
    time_s = observations.frame_time_s
    by_two = (observations.seen.sum(axis=1) >= 2).sum(axis=1)
    counted = np.concatenate([[0], np.cumsum(by_two)])
    ends = np.searchsorted(time_s, time_s + duration_s, side="right")
    scores = counted[ends] - counted[:-1]
    off_middle_s = np.abs(time_s + time_s[ends - 1] - time_s[0] - time_s[-1])
    first = int(np.lexsort((off_middle_s, -scores))[0])
    return observations.frames(slice(first, int(ends[first])))


def frames_of_use(observations: Observations, at_most: int) -> Int[np.ndarray, " sample"]:
    """Frames, spread evenly, in which two cameras see a joint; of all frames if there are none."""
    useful = np.flatnonzero((observations.seen.sum(axis=1) >= 2).any(axis=1))
    useful = useful if useful.size else np.arange(observations.n_frames)
    return useful[spread_evenly(len(useful), at_most)]


def frames_of_each(people: Sequence[Observations], at_most: int) -> list[Int[np.ndarray, " sample"]]:
    """The frames of use of each person, all together so many at most."""
    wanted = [len(frames_of_use(own, own.n_frames)) for own in people]
    return [frames_of_use(own, int(limit)) for own, limit in zip(people, fair_limits(wanted, at_most), strict=True)]


def stretches(people: Sequence[Observations], frames: Sequence[Int[np.ndarray, " _"]]) -> list[Stretch]:
    """Of the frames of each person that are used."""
    pairs = zip(people, frames, strict=True)
    return [Stretch(len(used), usual_step_s(own.frame_time_s[used])) for own, used in pairs]


def agreed_joints_m(
    undistorted_px: Float[np.ndarray, "frame camera joint 2"],
    confidence: Float[np.ndarray, "frame camera joint"],
    rig: CameraRig,
    config: Config,
) -> Float[np.ndarray, "frame joint 3"]:
    """Joints triangulated from the views that agree, roughly; NaN where fewer than two do.

    Raises:
        ValueError: there is none.
    """
    threshold_px = _INLIER_FACTOR * rig.in_own_px(config.fusion.inlier_px)
    joints_m = triangulate_robust(undistorted_px, confidence, rig, threshold_px).positions_m
    if not np.isfinite(joints_m).all(axis=-1).any():
        raise ValueError("the calibration cannot be refined: no joint is seen by two cameras that agree")
    return joints_m
