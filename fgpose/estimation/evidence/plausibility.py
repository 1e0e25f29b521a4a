"""Whether what is detected in a frame makes a body, and what of it is too far away to be of that body: a detector that
fails gives pixels of anything."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.estimation.evidence.presence import MIN_JOINTS
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.field_of_view import clipped
from fgpose.geometry.vectors import norm
from fgpose.observations import Observations
from fgpose.skeleton import Skeleton

# Median distance of the joints from their middle: 0.3 to 0.7 m, so 300 "metres" in millimetres. A few wrong
# triangulations do not change the median of some joints.
_LARGEST_BODY_M, _MILLIMETRES_M = 1.5, 30.0
_LONGEST_BONE_M = 0.75  # no bone of a person is longer
_REACH_M = 2.0  # no joint of somebody 2.3 m tall is farther from the median of all
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
        (_, size_m), n_known = _of_middle(positions_m), np.isfinite(positions_m).all(axis=-1).sum(axis=1)
        bones_m = skeleton.bone_lengths(positions_m)
        n_long, n_bones = (bones_m > _LONGEST_BONE_M).sum(axis=1), np.isfinite(bones_m).sum(axis=1)
        n_seen = (n_views >= 2).sum(axis=1)
        implausible = outside | (size_m > np.where(n_known < MIN_JOINTS, _MILLIMETRES_M, _LARGEST_BODY_M))
        implausible |= (n_bones >= MIN_JOINTS) & (2 * n_long > n_bones)
        implausible |= (n_seen >= MIN_JOINTS) & (n_known < _LEAST_AGREEMENT * n_seen)
        large = (size_m > _MILLIMETRES_M) & (n_known >= min(MIN_JOINTS, skeleton.n_joints))
        return Bodies(size_m, large, implausible, (n_known > 1) | implausible)

    @staticmethod
    def of_all(parts: Sequence[Bodies]) -> Bodies:
        """Of parts that follow each other."""
        return Bodies(*(np.concatenate([getattr(part, each.name) for part in parts]) for each in fields(Bodies)))

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


def middles_m(positions_m: Float[np.ndarray, "frame joint 3"]) -> Float[np.ndarray, "frame 3"]:
    """Of the bodies: the median of the joints. NaN where fewer than MIN_JOINTS are known, or half of a body's size is
    unlike anybody's.

    Args:
        positions_m: triangulated joints, some of them wrong; NaN where one is not known. Of whole bodies those of
            neither face nor hands, or these are the middle.
    """
    middle_m, size_m = _of_middle(positions_m)
    n_known = np.isfinite(positions_m).all(axis=-1).sum(axis=1)
    is_body = (n_known >= MIN_JOINTS) & (size_m < _LARGEST_BODY_M / 2)
    return np.where(is_body[:, None], middle_m, np.nan)


def _of_middle(
    positions_m: Float[np.ndarray, "frame joint 3"],
) -> tuple[Float[np.ndarray, "frame 3"], Float[np.ndarray, " frame"]]:
    """The middle of the joints of each frame, and their median distance from it; NaN where fewer than two are known."""
    middle_m = known_medians(positions_m)
    return middle_m, known_medians(norm(positions_m - middle_m[:, None])[..., None])[:, 0]


def known_medians(values: Float[np.ndarray, "set joint value"]) -> Float[np.ndarray, "set value"]:
    """Over the joints; NaN where fewer than two are known. numpy.nanmedian takes ten times as long."""
    known = np.asarray(np.isfinite(values).all(axis=-1))
    ordered, n_known = np.sort(np.where(known[..., None], values, np.inf), axis=1), known.sum(axis=1)
    below, above = ordered[np.arange(len(values)), [(n_known - 1) // 2, n_known // 2]]
    return np.where(n_known[:, None] > 1, (below + above) / 2, np.nan)


def beyond_reach(
    undistorted_px: Float[np.ndarray, "frame camera joint 2"], middle_m: Float[np.ndarray, "frame 3"], rig: CameraRig
) -> Bool[np.ndarray, "frame camera joint"]:
    """The detections whose rays pass a body farther away than its joints are: they are of something else.

    Args:
        undistorted_px: NaN where there is none.
        middle_m: of the bodies; NaN where there is none.
        rig: the cameras.
    """
    centre_px, focal_px = rig.K[:, None, :2, 2], np.diagonal(rig.K, axis1=1, axis2=2)[:, None, :2]
    normalized = (undistorted_px - centre_px) / focal_px
    of_cameras = rig.camera_T_world[:, :3]
    to_middle_m = np.einsum("cab,tb->tca", of_cameras[..., :3], middle_m) + of_cameras[..., 3]
    to_middle_m = to_middle_m[:, :, None]
    along = np.vecdot(to_middle_m[..., :2], normalized) + to_middle_m[..., 2]
    squared_m2 = np.vecdot(to_middle_m, to_middle_m) - np.maximum(along, 0.0) ** 2 / (
        1 + np.vecdot(normalized, normalized)
    )
    return np.asarray(squared_m2 > _REACH_M**2)


def off_body(
    points_m: Float[np.ndarray, "*shape 3"], middle_m: Float[np.ndarray, "frame 3"]
) -> Bool[np.ndarray, "*shape"]:
    """What is farther from the middle of a body than any of its joints."""
    middle_m = middle_m.reshape(len(middle_m), *(points_m.ndim - 2) * (1,), 3)
    return np.asarray(norm(points_m - middle_m) > _REACH_M)


def far_outside_images(
    points2d_px: Float[np.ndarray, "frame camera joint 2"], rig: CameraRig
) -> Bool[np.ndarray, "frame camera joint"]:
    """The detections that lie outside their image by more than its size."""
    size_px = np.array([camera.size_px for camera in rig.cameras])[:, None]
    return np.asarray(((points2d_px < -size_px) | (points2d_px > 2 * size_px)).any(axis=-1))


def clipped_to_images(observations: Observations, rig: CameraRig) -> Bool[np.ndarray, "frame camera joint"]:
    """The detections that are clipped to the image of their camera."""
    return clipped(observations.points2d_px, np.array([camera.size_px for camera in rig.cameras])[:, None])


def without_clipped(observations: Observations, rig: CameraRig) -> Observations:
    """Without those detections."""
    return observations.without(clipped_to_images(observations, rig))


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
