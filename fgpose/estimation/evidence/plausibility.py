"""Whether what is detected in a frame makes a body: a detector that fails gives pixels of anything."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.estimation.evidence.presence import MIN_JOINTS
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton

# Median distance of the joints from their middle: 0.3 to 0.7 m, so 300 "metres" in millimetres. A few wrong
# triangulations do not change the median of some joints.
_LARGEST_BODY_M, _MILLIMETRES_M = 1.5, 30.0
_LONGEST_BONE_M = 0.75  # no bone of a person is longer
# Where two cameras agree on fewer of the joints that two detect, they do not see the same body.
_LEAST_AGREEMENT = 0.25
# Where more frames make no body, it is not a detector that fails now and then.
_MANY_IMPLAUSIBLE = 0.25
# Of the first frames of a stream, so many that make no body are left out.
_MOST_IMPLAUSIBLE = 10


@dataclass(frozen=True, eq=False)
class Bodies:
    """Whether what is detected in each frame makes a body."""

    size_m: Float[np.ndarray, " frame"]
    """Median distance of the joints from their middle; NaN where fewer than two are known."""
    large: Bool[np.ndarray, " frame"]
    """Where the joints are as far apart as if metres were millimetres. Two may be a hallucination that meets another by
    chance."""
    implausible: Bool[np.ndarray, " frame"]
    """Where most joints are metres from their middle, most bones longer than anybody's, most detections far outside
    their images, or no two cameras agree on most joints."""
    known: Bool[np.ndarray, " frame"]
    """Where there is anything to be judged."""

    @staticmethod
    def of(
        positions_m: Float[np.ndarray, "frame joint 3"],
        n_views: Int[np.ndarray, "frame joint"],
        outside: Bool[np.ndarray, " frame"],
        skeleton: Skeleton,
    ) -> Bodies:
        """Of triangulated joints, NaN where no two cameras agree.

        Args:
            positions_m: of the joints.
            n_views: how many cameras detect each.
            outside: frames in which most detections lie far outside their images.
            skeleton: the joints.
        """
        size_m, n_known = _sizes_m(positions_m), np.isfinite(positions_m).all(axis=-1).sum(axis=1)
        bones_m = skeleton.bone_lengths(positions_m)
        n_long, n_bones = (bones_m > _LONGEST_BONE_M).sum(axis=1), np.isfinite(bones_m).sum(axis=1)
        n_seen = (n_views >= 2).sum(axis=1)
        implausible = outside | (size_m > np.where(n_known < MIN_JOINTS, _MILLIMETRES_M, _LARGEST_BODY_M))
        implausible |= (n_bones >= MIN_JOINTS) & (2 * n_long > n_bones)
        implausible |= (n_seen >= MIN_JOINTS) & (n_known < _LEAST_AGREEMENT * n_seen)
        large = (size_m > _MILLIMETRES_M) & (n_known >= min(MIN_JOINTS, skeleton.n_joints))
        return Bodies(size_m, large, implausible, (n_known > 1) | implausible)

    @property
    def are_mostly_implausible(self) -> bool:
        return bool(np.count_nonzero(self.implausible) > _MANY_IMPLAUSIBLE * np.count_nonzero(self.known))

    def refuse_millimetres(self) -> None:
        """Raise ValueError where so many bodies are so large that the lengths of the rig are millimetres."""
        n_large, n_known = np.count_nonzero(self.large), np.count_nonzero(self.known)
        if n_large > _MANY_IMPLAUSIBLE * n_known:
            size_m = float(np.median(self.size_m[self.large]))
            raise ValueError(
                f"the joints are {size_m:.0f} m apart in {n_large} of {n_known} frames: the calibration looks like "
                "millimetres; divide its lengths by 1000"
            )


def _sizes_m(positions_m: Float[np.ndarray, "frame joint 3"]) -> Float[np.ndarray, " frame"]:
    """Median distance of the joints of each frame from their middle; where that is a body, only roughly."""
    known = np.asarray(np.isfinite(positions_m).all(axis=-1))
    n_known = known.sum(axis=1)
    some_m, of_all = np.where(known[..., None], positions_m, 0.0), np.maximum(n_known, 1)[:, None]
    apart_m = np.linalg.norm(some_m - (some_m.sum(axis=1) / of_all)[:, None], axis=-1)
    size_m = np.where(n_known > 1, np.where(known, apart_m, 0.0).sum(axis=1) / of_all[:, 0], np.nan)
    large = size_m > _LARGEST_BODY_M / 2
    if large.any():  # medians of all would take ten times as long
        own_m = positions_m[large]
        apart_m = np.linalg.norm(own_m - np.nanmedian(own_m, axis=1, keepdims=True), axis=-1)
        size_m[large] = np.nanmedian(apart_m, axis=1)
    return size_m


def far_outside_images(
    points2d_px: Float[np.ndarray, "frame camera joint 2"], rig: CameraRig
) -> Bool[np.ndarray, "frame camera joint"]:
    """The detections that lie outside their image by more than its size."""
    size_px = np.array([camera.size_px for camera in rig.cameras])[:, None]
    return np.asarray(((points2d_px < -size_px) | (points2d_px > 2 * size_px)).any(axis=-1))


class RunningPlausibility:
    """Counts the frames of a stream that make no body."""

    def __init__(self) -> None:
        self._n_plausible = 0
        self.n_implausible = 0

    @property
    def may_leave_out(self) -> bool:
        """Whether few make no body so far. Where many do not, it is the calibration or the detector, and not hidden."""
        n_judged = self._n_plausible + self.n_implausible
        return self.n_implausible < max(_MOST_IMPLAUSIBLE, _MANY_IMPLAUSIBLE * n_judged)

    def count(self, frame: Bodies) -> None:
        """Take a frame. Raises ValueError where none made a body yet, and the lengths of the rig are millimetres."""
        if not frame.implausible[0]:
            self._n_plausible += bool(frame.known[0])
            return
        if not self._n_plausible and self.n_implausible + 1 >= _MOST_IMPLAUSIBLE:
            frame.refuse_millimetres()
        self.n_implausible += 1
