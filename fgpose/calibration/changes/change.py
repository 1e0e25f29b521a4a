"""One change of a camera while a recording lasts; what several do to its clock and its pose, and to a rig."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import pairwise

import gtsam
import numpy as np
from jaxtyping import Bool, Float

from fgpose.geometry.camera import Camera, CameraRig

# More than the calibration finds from the images that the frames put together (calibration.offset_sigma_s).
_FAR_APART_S = 0.1
# Of a standard deviation. Of two cameras that are fitted in turns each step leaves up to nine tenths of what is wrong.
_SETTLED = 0.2


class Kind(StrEnum):
    """What changes."""

    OFFSET = "offset"
    """The clock, by the same all the time."""
    JUMP = "jump"
    """The clock, at a time: images were lost, and those after them numbered on."""
    RATE = "rate"
    """The clock, evenly: the frame rate is not what was said."""
    MOVED = "moved"
    """The pose, all the time."""
    BUMP = "bump"
    """The pose, at a time."""


@dataclass(frozen=True, eq=False)
class Change:
    """What is different of one camera."""

    kind: Kind
    camera: int
    at_s: float = -np.inf
    """By the time stamps of the camera: since when; -inf: all the time."""
    until_s: float = np.inf
    between_s: tuple[float, float] | None = None
    """Within which times at_s, or until_s, is, by the common clock; None where it changes at no time."""
    offset_s: float = 0.0
    """How much later its images were taken than the stamps say."""
    rate: float = 0.0
    """How much later per second of the stamps, from zero on."""
    rotation: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """Rotation vector by which the camera was turned, radians, in its own frame."""
    translation_m: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """By how much it was moved, in its own frame."""
    sigma: float = 0.0
    """Standard deviation: of offset_s, or of what the rate adds up to over the recording, seconds; of the rotation,
    radians."""
    translation_sigma_m: float = 0.0
    """Standard deviation of the translation, root of the sum over the axes."""
    reliability: float = 0.0
    """Standard deviations by which images that did not enter it agree better with it."""

    @property
    def is_of_clock(self) -> bool:
        return self.kind in (Kind.OFFSET, Kind.JUMP, Kind.RATE)

    @property
    def rotation_deg(self) -> float:
        return float(np.rad2deg(np.linalg.norm(self.rotation)))

    def holds(self, stamp_s: Float[np.ndarray, " time"]) -> Bool[np.ndarray, " time"]:
        return (stamp_s >= self.at_s) & (stamp_s < self.until_s)

    def later_s(self, stamp_s: Float[np.ndarray, " time"]) -> Float[np.ndarray, " time"]:
        """How much later images with these stamps were taken."""
        return np.where(self.holds(stamp_s), self.offset_s + self.rate * stamp_s, 0.0)

    def is_like(self, other: Change, stamp_s: Float[np.ndarray, " time"]) -> bool:
        """Whether another one says the same at these times, to a small part of what is known."""
        if (self.kind, self.camera) != (other.kind, other.camera):
            return False
        later_s = float(np.abs(self.later_s(stamp_s) - other.later_s(stamp_s)).max())
        turned, moved_m = self.rotation - other.rotation, self.translation_m - other.translation_m
        near = max(later_s, float(np.linalg.norm(turned))) <= _SETTLED * self.sigma
        near = near and float(np.linalg.norm(moved_m)) <= _SETTLED * self.translation_sigma_m
        return near and np.array_equal(self.holds(stamp_s), other.holds(stamp_s))

    def moved_pose(self, world_T_camera: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
        moved = np.array(world_T_camera)
        moved[:3, 3] += moved[:3, :3] @ self.translation_m
        moved[:3, :3] = moved[:3, :3] @ gtsam.Rot3.Expmap(self.rotation).matrix()
        return moved


def later_s(changes: Sequence[Change], camera: int, stamp_s: Float[np.ndarray, " time"]) -> Float[np.ndarray, " time"]:
    """How much later than their stamps say images of a camera were taken, with these changes."""
    own = [each.later_s(stamp_s) for each in changes if each.camera == camera and each.is_of_clock]
    return np.sum(own, axis=0) if own else np.zeros_like(stamp_s)


def pieces(
    changes: Sequence[Change], camera: int, given: Camera
) -> list[tuple[float, float, Float[np.ndarray, "4 4"]]]:
    """Since when, until when (by the stamps of the camera) and where a camera was, one pose after the other."""
    own = [each for each in changes if each.camera == camera and not each.is_of_clock]
    times_s = sorted({-np.inf, np.inf, *(time_s for each in own for time_s in (each.at_s, each.until_s))})
    found = []
    for since_s, until_s in pairwise(times_s):
        pose = given.world_T_camera
        for each in own:
            if each.at_s <= since_s and until_s <= each.until_s:
                pose = each.moved_pose(pose)
        found.append((since_s, until_s, pose))
    return found


def with_changes(rig: CameraRig, changes: Sequence[Change], *, poses: bool, clocks: bool) -> CameraRig:
    """What changes in time: with poses the bumps, with clocks jumps and rates; and of the cameras that they concern
    what was different all the time. The others stay as they are: a constant fault is for the calibration to find,
    unless a clock is so late that its images have to be put together with others first.

    Args:
        rig: with constant clocks and poses.
    """
    kept: list[Change] = []
    for wanted, in_time in ((poses, (Kind.BUMP,)), (clocks, (Kind.JUMP, Kind.RATE))):
        of_clock = Kind.JUMP in in_time
        concerned = {each.camera for each in changes if each.kind in in_time or (of_clock and _is_far_apart(each))}
        kept += [each for each in changes if wanted and each.camera in concerned and each.is_of_clock == of_clock]
    return CameraRig(tuple(_changed(camera, c, kept) for c, camera in enumerate(rig.cameras)))


def _is_far_apart(change: Change) -> bool:
    return change.kind is Kind.OFFSET and abs(change.offset_s) > _FAR_APART_S


def _changed(camera: Camera, c: int, changes: Sequence[Change]) -> Camera:
    own = [each for each in changes if each.camera == c]
    of_clock = [each for each in own if each.is_of_clock]
    first, *later = pieces(own, c, camera)
    return replace(
        camera,
        world_T_camera=first[2],
        moves=tuple((since_s, pose) for since_s, _, pose in later),
        time_offset_s=camera.time_offset_s + sum(each.offset_s for each in of_clock if not np.isfinite(each.at_s)),
        clock_drift=sum((each.rate for each in of_clock), 0.0),
        clock_jumps=tuple(sorted((each.at_s, each.offset_s) for each in of_clock if np.isfinite(each.at_s))),
    )
