"""What the cameras saw: the estimator's input, checked once when it is made."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.sampling import TimeRange, checked_times_s, forward, mean_times_s
from fgpose.shown import Shown
from fgpose.shown.unknown_names import check_names
from fgpose.skeleton import Skeleton
from fgpose.skeletons import named_skeleton

# The rigs of this field are rooms: a median view farther than this from the person is a unit mistake, not a hall.
_MAX_PLAUSIBLE_M = 100.0
# No image or room has as much, and sixth powers of it do not overflow.
_LARGEST = 1e30
_PER_DETECTION = ("points2d_px", "confidence", "points3d_m", "covariance3d_m2")


@dataclass(frozen=True, eq=False, repr=False)
class Observations(Shown):
    """Detected joints of one person in several cameras over time.

    Missing is NaN with confidence 0, always both. A camera may see nothing for a while, a joint may be seen by nobody.

    Raises:
        ValueError: shapes disagree, time does not increase, a number is infinite, a confidence lies outside [0, 1], a
            length is implausible (millimetres where metres are meant). The message names camera, joint and frame.
    """

    skeleton: Skeleton
    """When it is made, also the name of one that comes with fgpose."""
    time_s: np.ndarray
    """(T,) time of each frame, or (T, C) when every camera has its own clock (NaN: no image). Increasing, of
    each camera too; all count from about the same moment."""
    points2d_px: np.ndarray
    """(T, C, J, 2) pixels of the original, distorted image; as confidence, single precision stays single."""
    confidence: np.ndarray = field(default_factory=lambda: np.array(1.0))
    """(T, C, J) in [0, 1], or one number for every known point."""
    points3d_m: np.ndarray | None = None
    """(T, C, J, 3) absolute 3D joints as each view alone gives them, in the world frame, metres."""
    camera_names: tuple[str, ...] = ()
    """Names in the order of the camera axis; by default cam_0, cam_1, ..."""
    covariance3d_m2: np.ndarray | None = None
    """(T, C, J, 3, 3) covariance of points3d_m in the world frame; large along the ray, as one view is.
    Goes with them: None without."""
    remarks: tuple[str, ...] = field(default=(), repr=False)
    """What was changed or left out when they were read."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "skeleton", named_skeleton(self.skeleton))
        points2d_px = _own(self.points2d_px, np.float32)
        if points2d_px.ndim != 4 or points2d_px.shape[3] != 2:
            raise ValueError(f"points2d_px must be (frames, cameras, joints, 2), got {points2d_px.shape}")
        n_frames, n_cameras, n_joints, _ = points2d_px.shape
        if n_frames == 0 or n_cameras == 0:
            raise ValueError(f"a recording needs at least one frame and one camera, got {n_frames} and {n_cameras}")
        if n_joints != self.skeleton.n_joints:
            raise ValueError(
                f"points2d_px has {n_joints} joints, skeleton {self.skeleton.name} has {self.skeleton.n_joints}"
            )
        names = tuple(self.camera_names) or _default_names(n_cameras)
        if len(names) != n_cameras or len(set(names)) != n_cameras:
            raise ValueError(f"{n_cameras} different camera names are needed, got {', '.join(names)}")
        object.__setattr__(self, "camera_names", names)
        points3d_m = None if self.points3d_m is None else self._checked_points3d(self.points3d_m, points2d_px.shape[:3])
        covariance3d_m2 = None
        if points3d_m is not None and self.covariance3d_m2 is not None:
            covariance3d_m2 = self._checked_covariance(self.covariance3d_m2, points3d_m)
        confidence = self._checked_confidence(points2d_px)
        points2d_px = _with(points2d_px, (confidence == 0) & ~np.isnan(points2d_px).all(axis=-1), np.nan)
        self._refuse_infinite("points2d_px", points2d_px)
        self._store(
            points2d_px=points2d_px,
            confidence=confidence,
            points3d_m=points3d_m,
            covariance3d_m2=covariance3d_m2,
            time_s=checked_times_s(self.time_s, n_frames, names),
        )

    def _store(self, **values: Any) -> None:
        for name, value in values.items():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
            object.__setattr__(self, name, value)

    def _where(self, bad: np.ndarray) -> str:
        frame, camera, joint = np.argwhere(bad)[0][:3]
        return f"camera {self.camera_names[camera]}, joint {self.skeleton.joints[joint]}, frame {frame}"

    def _refuse_infinite(self, what: str, array: np.ndarray) -> None:
        infinite = np.asarray(is_infinite(array).any(axis=-1))
        if infinite.any():
            raise ValueError(f"{what} is infinite at {self._where(infinite)}")

    def _checked_confidence(self, points2d_px: np.ndarray) -> np.ndarray:
        known = ~np.isnan(points2d_px).any(axis=-1)
        confidence = _own(self.confidence, np.float32)
        if confidence.ndim == 0:
            confidence = np.full(known.shape, float(confidence))
        if confidence.shape != known.shape:
            raise ValueError(f"confidence must have the shape {known.shape} of the points, got {confidence.shape}")
        outside = known & ~((confidence >= 0) & (confidence <= 1))
        if outside.any():
            value, percent = confidence[outside][0], ": divide by 100?" if 10 < confidence[known].max() <= 100 else ""
            hint = ": give 0, or no pixels, for what was not detected" if np.isnan(value) else percent
            raise ValueError(f"confidence {value:g} is outside [0, 1] at {self._where(outside)}{hint}")
        return _with(confidence, ~known & (confidence != 0), 0.0)

    def _checked_points3d(self, given: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
        points3d_m = _own(given)
        if points3d_m.shape != (*shape, 3):
            raise ValueError(f"points3d_m must be {(*shape, 3)} as points2d_px is, got {points3d_m.shape}")
        self._refuse_infinite("points3d_m", points3d_m)
        unknown = np.isnan(points3d_m)
        points3d_m = _with(points3d_m, np.asarray(unknown.any(axis=-1) & ~unknown.all(axis=-1)), np.nan)
        refuse_millimetres(points3d_m)
        return points3d_m

    def _checked_covariance(self, given: np.ndarray, points3d_m: np.ndarray) -> np.ndarray:
        covariance_m2 = _own(given)
        if covariance_m2.shape != (*points3d_m.shape, 3):
            raise ValueError(f"covariance3d_m2 must be {(*points3d_m.shape, 3)}, got {covariance_m2.shape}")
        known = np.asarray(np.isfinite(points3d_m).all(axis=-1))
        covariance_m2 = _with(covariance_m2, ~known & ~np.isnan(covariance_m2).all(axis=(-1, -2)), np.nan)
        wrong = known & ~np.isfinite(covariance_m2).all(axis=(-1, -2))
        wrong |= known & ~positive_definite(covariance_m2)
        if wrong.any():
            raise ValueError(f"covariance3d_m2 is not positive definite at {self._where(wrong)}")
        return covariance_m2

    @property
    def n_frames(self) -> int:
        return self.points2d_px.shape[0]

    @property
    def n_cameras(self) -> int:
        return self.points2d_px.shape[1]

    @cached_property
    def frame_time_s(self) -> Float[np.ndarray, " frame"]:
        """One time per frame: the mean over the cameras where each has its own clock."""
        return self.time_s if self.time_s.ndim == 1 else mean_times_s(self.time_s)

    @cached_property
    def seen(self) -> Bool[np.ndarray, "frame camera joint"]:
        """Whether each camera detected each joint in each frame."""
        return np.asarray(np.isfinite(self.points2d_px).all(axis=-1))

    def frames(self, frames: slice | Bool[np.ndarray, " frame"] | Int[np.ndarray, " sample"]) -> Observations:
        """Some of the frames, as a recording of its own. Raises ValueError when there is none, or the step negative."""
        if not len(self.time_s[forward(frames)]):
            raise ValueError(f"no frame is left: {frames} of {self.n_frames} frames")
        return self._part(time_s=self.time_s[frames], **self.per_detection(lambda array: array[frames]))

    def __getitem__(self, frames: slice) -> Observations:
        """Some of the frames, as observations[100:200]. Raises TypeError for what is no slice, else as frames."""
        if not isinstance(frames, slice):
            raise TypeError(f"frames are taken as a slice, as observations[0:1]; got {frames!r:.40}")
        return self.frames(frames)

    def __len__(self) -> int:
        return self.n_frames

    def _part(self, **changed: Any) -> Observations:
        # Not replace(): what was checked as a whole is not checked again, frame by frame, in a live loop.
        part = object.__new__(Observations)
        part._store(**{each.name: getattr(self, each.name) for each in fields(self)} | changed)
        return part

    def crop(self, begin_s: float, end_s: float) -> Observations:
        """The frames from one time to another, seconds, both included. Raises ValueError if there is none."""
        return self.frames(TimeRange(begin_s, end_s).of(self.frame_time_s))

    def first_frames(self, n_frames: int) -> Observations:
        """The beginning. Raises ValueError when no frame is left."""
        return self.frames(slice(0, n_frames))

    def per_detection(self, change: Callable[[np.ndarray], np.ndarray]) -> dict[str, Any]:
        """The arrays whose axes begin with frame, camera, joint, each changed, by name; None where there is none."""
        arrays = {name: getattr(self, name) for name in _PER_DETECTION}
        return {name: None if array is None else change(array) for name, array in arrays.items()}

    def confident(self, least: float) -> Observations:
        """Without the detections of less confidence. Raises ValueError unless it lies in [0, 1]."""
        check_confidence(least)
        return self.without(self.confidence < least)

    def without(self, where: Bool[np.ndarray, "frame camera joint"]) -> Observations:
        """Without the detections there."""
        return self._part(**self.per_detection(lambda array: blanked(array, where))) if where.any() else self

    def of_joints(self, skeleton: Skeleton, joints: Sequence[int]) -> Observations:
        """Some of the joints, in this order, as the joints of another skeleton (Skeleton.of_joints)."""
        chosen = list(joints)
        return self._part(skeleton=skeleton, **self.per_detection(lambda array: array[:, :, chosen]))

    def subset(self, camera_names: tuple[str, ...] | list[str]) -> Observations:
        """Some of the cameras, in the order given. Raises ValueError for an unknown name."""
        check_names(camera_names, self.camera_names, "the keypoints have no camera", "they have")
        kept = [self.camera_names.index(name) for name in camera_names]
        if kept == list(range(self.n_cameras)):
            return self
        return replace(
            self,
            camera_names=tuple(camera_names),
            time_s=self._times_of(kept),
            **self.per_detection(lambda array: array[:, kept]),
        )

    def _times_of(self, cameras: list[int]) -> np.ndarray:
        """Of some cameras. A frame without an image of any keeps its time."""
        if self.time_s.ndim == 1:
            return self.time_s
        time_s = self.time_s[:, cameras]
        empty = np.isnan(time_s).all(axis=1)
        if empty.any():
            # As far from the time of the frame as in the frames around, or times could go back.
            frame_s, late_s = self.frame_time_s, mean_times_s(time_s) - self.frame_time_s
            late_s = np.interp(frame_s, frame_s[~empty], late_s[~empty]) if not empty.all() else np.zeros(len(frame_s))
            time_s[empty] = (frame_s + late_s)[empty, None]
        return time_s

    def with_cameras(self, camera_names: tuple[str, ...]) -> Observations:
        """The same frames for these cameras in this order; a camera that is not there saw nothing.

        Raises ValueError when a camera of the observations is not among them.
        """
        if self.camera_names == camera_names or self._is_unnamed(camera_names):
            return self
        missing = [name for name in self.camera_names if name not in camera_names]
        if missing:
            raise ValueError(f"the calibration lacks camera {', '.join(missing)}; it has {', '.join(camera_names)}")
        own = {name: index for index, name in enumerate(self.camera_names)}
        present = [index for index, name in enumerate(camera_names) if name in own]
        source = [own[camera_names[index]] for index in present]

        def spread(array: np.ndarray) -> np.ndarray:
            wide = np.full((array.shape[0], len(camera_names), *array.shape[2:]), np.nan)
            wide[:, present] = array[:, source]
            return wide

        return replace(
            self,
            camera_names=camera_names,
            time_s=self.time_s if self.time_s.ndim == 1 else spread(self.time_s),
            **self.per_detection(spread),
        )

    def __iter__(self) -> Iterator[Observations]:
        """Frame by frame, each a recording of one frame, as Estimator.update takes it."""
        return (self.frames(slice(frame, frame + 1)) for frame in range(self.n_frames))

    def _is_unnamed(self, rig_names: tuple[str, ...]) -> bool:
        # In a rig that has a cam_0 of its own, cam_0 is a name, not a place in the order.
        default = self.camera_names == _default_names(self.n_cameras)
        return default and self.n_cameras == len(rig_names) and not set(self.camera_names) & set(rig_names)

    def check_cameras(self, rig_names: tuple[str, ...]) -> None:
        """Raise ValueError unless the rig has exactly these cameras in this order; unnamed ones go by their order."""
        if not self._is_unnamed(rig_names):
            check_cameras(self.camera_names, rig_names)


def _own(values: np.ndarray, *kept: type[np.floating]) -> np.ndarray:
    """As numbers that nobody else changes: a copy, unless they are of other observations, which are shared. In double
    precision, or in one that is kept. Raises ValueError: they are complex."""
    if np.iscomplexobj(values):
        raise ValueError("coordinates and confidences are real numbers, got complex ones")
    if not isinstance(values, np.ndarray) or values.dtype not in (float, *kept):
        return np.array(values, dtype=float)
    owner = values if values.base is None or values.flags.writeable else values.base
    return values if isinstance(owner, np.ndarray) and not owner.flags.writeable else values.copy()


def _with(array: np.ndarray, where: np.ndarray, value: float) -> np.ndarray:
    """With this value in some places; changed itself if it is not shared."""
    if where.any():
        array = array if array.flags.writeable else array.copy()
        array[where] = value
    return array


def check_cameras(camera_names: tuple[str, ...], rig_names: tuple[str, ...]) -> None:
    """Raise ValueError unless the rig has exactly the cameras of the keypoints in their order."""
    if camera_names == rig_names:
        return
    missing = [name for name in camera_names if name not in rig_names]
    unused = [name for name in rig_names if name not in camera_names]
    if missing:
        raise ValueError(
            f"the calibration lacks camera {', '.join(missing)} of the keypoints; it has {', '.join(rig_names)}"
        )
    if unused:
        raise ValueError(
            f"camera {', '.join(unused)} of the calibration has no keypoints; leave it out with rig.subset(...)"
        )
    raise ValueError(
        f"the cameras of the keypoints ({', '.join(camera_names)}) and of the calibration ({', '.join(rig_names)}) "
        "come in a different order; use rig.subset(observations.camera_names)"
    )


def is_infinite(numbers: Float[np.ndarray, "*shape"]) -> Bool[np.ndarray, "*shape"]:
    """Whether each of these pixels or metres is infinite, or beyond 1e30, which is the same to those who compute with
    it; False for NaN."""
    return np.asarray((numbers > _LARGEST) | (numbers < -_LARGEST))


def positive_definite(matrices: Float[np.ndarray, "*shape 3 3"]) -> Bool[np.ndarray, "*shape"]:
    """Whether the leading minors are positive (Sylvester); False for NaN and what is infinite. Ten times as fast as
    eigenvalues."""
    matrices = np.where(is_infinite(matrices), np.nan, matrices)
    (a, b, c), (d, e, f), (g, h, i) = np.moveaxis(matrices, (-2, -1), (0, 1))
    of_two = a * e - b * d
    determinant = of_two * i - (a * f - c * d) * h + (b * f - c * e) * g
    return np.asarray((a > 0) & (of_two > 0) & (determinant > 0))


def refuse_millimetres(points3d_m: np.ndarray) -> None:
    """Raise ValueError if the coordinates are those of a hall of a hundred metres or more."""
    extent_m = np.nanmedian(np.abs(points3d_m)) if np.isfinite(points3d_m).any() else 0.0
    if extent_m > _MAX_PLAUSIBLE_M:
        raise ValueError(
            f"points3d_m has a median coordinate of {extent_m:.0f} m: these look like millimetres; divide by 1000"
        )


def _default_names(n_cameras: int) -> tuple[str, ...]:
    return tuple(f"cam_{camera}" for camera in range(n_cameras))


def check_confidence(least: float) -> None:
    """Raise ValueError unless this can be the least confidence of detections."""
    if not 0 <= least <= 1:
        raise ValueError(f"the least confidence must be between 0 and 1, got {least:g}")


def blanked(array: np.ndarray, where: np.ndarray) -> np.ndarray:
    """An array of detections, as Observations has them, without some of them."""
    blank = array.copy()
    blank[where] = np.nan if array.ndim > where.ndim else 0.0
    return blank
