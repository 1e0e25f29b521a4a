"""Results: the estimated pose over time, with uncertainty, residuals and convergence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, overload

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.config import Config
from fgpose.sampling import TimeRange, forward, numbers_of_all, one_after_another
from fgpose.shown import Motion, Shown, by_names
from fgpose.skeleton import BoneLengths, Skeleton
from fgpose.skeletons import named_skeleton

BETWEEN_RECORDINGS_M = 0.01
"""Standard deviation of what differs between the lengths of one person in two recordings, beside what they state: in
another pose, before another camera, a detector puts joints elsewhere."""
_UNSTATED_M = 0.01  # of a length in a file of an older version


class Status(IntEnum):
    """How a joint's position in one frame came about."""

    UNOBSERVABLE = 0
    """Nothing determines it: the position is NaN."""
    PREDICTED = 1
    """Fewer than two cameras see it in this frame: it is predicted from other joints and frames by bones and motion."""
    OBSERVED = 2
    """At least two cameras see it in this frame."""


def joint_status(active: Bool[np.ndarray, "*frames joint"], observed: Bool[np.ndarray, "*frames joint"]) -> np.ndarray:
    """Status of every joint and frame, of the same shape."""
    # As Python's numbers they would take eight bytes each.
    status = np.where(active & observed, np.int8(Status.OBSERVED), np.int8(Status.PREDICTED))
    return np.where(active, status, np.int8(Status.UNOBSERVABLE))


@dataclass(frozen=True)
class Convergence:
    """How the optimiser ended; see worst for a recording solved in parts."""

    converged: bool
    iterations: int
    initial_error: float
    """Half the sum of squared whitened (robust) residuals at the initial guess, and at the result."""
    final_error: float

    @staticmethod
    def worst(parts: Sequence[Convergence]) -> Convergence:
        """Of several problems: converged if all are, the most iterations, the sums of the errors."""
        return Convergence(
            converged=all(part.converged for part in parts),
            iterations=max((part.iterations for part in parts), default=0),
            initial_error=sum((part.initial_error for part in parts), 0.0),
            final_error=sum((part.final_error for part in parts), 0.0),
        )


@dataclass(frozen=True)
class OtherBone:
    """The bone that shows most clearly that lengths known before, given or learned, are not those that are seen."""

    name: str
    """Of skeleton.length_names."""
    known_m: float
    seen_m: float
    sigmas: float
    """How far these are apart, in standard deviations."""

    def __str__(self) -> str:
        known, seen = f"{1000 * self.known_m:.0f} mm as known before", f"{1000 * self.seen_m:.0f} mm as seen"
        return f"{self.name} is {known} and {seen}, {self.sigmas:.1f} standard deviations apart"


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(Motion):
    """The joints of one person over time. What cannot be estimated is NaN, with its status.

    Raises:
        ValueError: the arrays' shapes disagree.
    """

    skeleton: Skeleton
    """When it is made, also the name of one that comes with fgpose."""
    time_s: np.ndarray
    """(T,)"""
    positions_m: np.ndarray
    """(T, J, 3) in the world frame."""
    status: np.ndarray
    """(T, J) values of Status."""
    covariance_m2: np.ndarray | None = None
    """(T, J, 3, 3) marginal covariance of each position, about the joint as the detector sees it from all sides: a
    network's own idea of a hip, which all views share, is not in it, nor are errors of the whole rig. The
    smoother gives it, residuals and visibility in single precision."""
    residual_px: np.ndarray | None = None
    """(T, C, J) reprojection error of each detection, undistorted pixels; NaN where there is none."""
    camera_names: tuple[str, ...] = ()
    bone_lengths_m: np.ndarray | None = None
    """(L,) estimated lengths, one per skeleton.length_names; NaN: not estimated."""
    convergence: Convergence | None = None
    config: Config | None = None
    """The configuration that made this result."""
    visibility: np.ndarray | None = None
    """(T, C, J) probability that each detection is of its joint and not hallucinated, 0 if it was left out; NaN: there
    is none. Right near 0 and 1; between, it is a weight, which may be off by 0.4 as a probability."""
    implausible_frames: tuple[int, ...] = ()
    """Frames whose detections make no body (joints tens of metres apart) and were left out."""
    bone_length_sigma_m: np.ndarray | None = None
    """(L,) their standard deviations; that neighbouring frames share their errors is in them."""
    other_bone: OtherBone | None = None
    """Why bone lengths that were given, or learned online, were not used any more. Not kept in files."""
    frame_numbers: np.ndarray | None = None
    """(T,) of its frames in the recording, from 0, increasing; None: not known."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "skeleton", named_skeleton(self.skeleton))
        n_frames, n_joints = np.shape(self.time_s)[0], self.skeleton.n_joints
        shapes = {
            "positions_m": (n_frames, n_joints, 3),
            "status": (n_frames, n_joints),
            "covariance_m2": (n_frames, n_joints, 3, 3),
            **dict.fromkeys(("residual_px", "visibility"), (n_frames, len(self.camera_names), n_joints)),
            **dict.fromkeys(("bone_lengths_m", "bone_length_sigma_m"), (self.skeleton.n_lengths,)),
            "frame_numbers": (n_frames,),
        }
        for name, shape in shapes.items():
            if (array := getattr(self, name)) is not None:
                if array.shape != shape:
                    raise ValueError(f"{name} must be {shape}, got {array.shape}")
                array.setflags(write=False)

    @staticmethod
    def from_estimates(
        estimates: Sequence[Estimate], camera_names: tuple[str, ...] = (), config: Config | None = None
    ) -> Trajectory:
        """Estimates of the online estimator as one trajectory; of several estimates of one frame the last counts.

        Args:
            estimates: in the order of time; covariances, residuals and visibility are kept if all have them.
            camera_names: those of the rig; without them there are no residuals and no visibility.
            config: of the estimator.

        Raises:
            ValueError: there is no estimate, or their skeletons, joints or cameras differ.
        """
        frames = list({estimate.frame: estimate for estimate in estimates}.values())
        if not frames:
            raise ValueError("a trajectory needs at least one estimate")

        def stacked(name: str) -> np.ndarray | None:
            arrays = [getattr(estimate, name) for estimate in frames]
            return None if any(array is None for array in arrays) else np.stack(arrays)

        lengths = next((each.bone_lengths for each in reversed(frames) if each.bone_lengths is not None), None)
        return Trajectory(
            skeleton=frames[0].skeleton,
            time_s=np.array([estimate.time_s for estimate in frames]),
            positions_m=np.stack([estimate.positions_m for estimate in frames]),
            status=np.stack([estimate.status for estimate in frames]),
            covariance_m2=stacked("covariance_m2"),
            residual_px=stacked("residual_px") if camera_names else None,
            visibility=stacked("visibility") if camera_names else None,
            camera_names=camera_names,
            config=config,
            implausible_frames=tuple(t for t, estimate in enumerate(frames) if estimate.is_implausible),
            bone_lengths_m=None if lengths is None else lengths.lengths_m,
            bone_length_sigma_m=None if lengths is None else lengths.sigma_m,
            other_bone=next((each.other_bone for each in frames if each.other_bone is not None), None),
        )

    @staticmethod
    def concatenate(parts: Sequence[Trajectory]) -> Trajectory:
        """Trajectories one after the other as one. What only some of them have (covariances, residuals, bone lengths
        that differ, the configuration) is left out, and numbers of frames that do not go on.

        Raises:
            ValueError: there is none, their skeletons or cameras differ, or one does not begin after the one before.
        """
        if not parts:
            raise ValueError("there is no trajectory to be concatenated")
        first = parts[0]
        for name in ("skeleton", "camera_names"):
            for number, part in enumerate(parts):
                if getattr(part, name) != getattr(first, name):
                    raise ValueError(f"trajectories 0 and {number} have another {name}: they cannot be concatenated")
        time_s = one_after_another([part.time_s for part in parts])

        def joined(name: str) -> Any:  # an array, or None
            arrays = [getattr(part, name) for part in parts]
            return None if any(array is None for array in arrays) else np.concatenate(arrays)

        begins = np.cumsum([0, *(part.n_frames for part in parts)]).tolist()
        ends = [part.convergence for part in parts if part.convergence is not None]
        known_m = [part.bone_lengths_m for part in parts if part.bone_lengths_m is not None]
        alike = len(known_m) == len(parts) and all(np.array_equal(each, known_m[0], equal_nan=True) for each in known_m)
        return replace(
            first,
            time_s=time_s,
            **{name: joined(name) for name in ("positions_m", "status", "covariance_m2", "residual_px", "visibility")},
            bone_lengths_m=first.bone_lengths_m if alike else None,
            bone_length_sigma_m=first.bone_length_sigma_m if alike else None,
            convergence=Convergence.worst(ends) if len(ends) == len(parts) else None,
            config=first.config if all(part.config == first.config for part in parts) else None,
            frame_numbers=numbers_of_all([part.frame_numbers for part in parts]),
            implausible_frames=tuple(
                begin + frame for begin, part in zip(begins, parts, strict=False) for frame in part.implausible_frames
            ),
        )

    @overload
    def __getitem__(self, wanted: str) -> Float[np.ndarray, "frame 3"]: ...

    @overload
    def __getitem__(self, wanted: list[str] | tuple[str, ...]) -> Float[np.ndarray, "frame joint 3"]: ...

    @overload
    def __getitem__(self, wanted: slice) -> Trajectory: ...

    def __getitem__(self, wanted: str | list[str] | tuple[str, ...] | slice) -> np.ndarray | Trajectory:
        """Positions of a joint by name, (T, 3), or of several, (T, joints, 3), metres; or some of the frames, as
        trajectory[100:200]. Raises ValueError for an unknown name or a negative step, TypeError for a number."""
        if isinstance(wanted, slice):
            return self.frames(wanted)
        if isinstance(wanted, str):
            return self.positions_m[:, self.skeleton.index(wanted)]
        return self.positions_m[:, [self.skeleton.index(joint) for joint in by_names(wanted)]]

    def crop(self, begin_s: float, end_s: float) -> Trajectory:
        """The frames from one time to another, seconds, both included. Raises ValueError if there is none."""
        return self.frames(TimeRange(begin_s, end_s).of(self.time_s))

    def frames(self, frames: slice | Bool[np.ndarray, " frame"]) -> Trajectory:
        """Some of them, as a trajectory whose implausible_frames count from 0. ValueError: the step is negative."""
        number = {frame: n for n, frame in enumerate(np.arange(self.n_frames)[forward(frames)].tolist())}
        names = "time_s", "positions_m", "status", "covariance_m2", "residual_px", "visibility", "frame_numbers"
        return replace(
            self,
            implausible_frames=tuple(number[frame] for frame in self.implausible_frames if frame in number),
            **{name: None if (array := getattr(self, name)) is None else array[frames] for name in names},
        )

    def in_frames(self, time_s: Float[np.ndarray, " all_frames"], frames: Int[np.ndarray, " frame"]) -> Trajectory:
        """The same as part of more frames, in the others of which nothing is known.

        Args:
            time_s: of all frames.
            frames: which of them these frames are.
        """

        def spread(array: np.ndarray | None, fill: float | Status = np.nan) -> np.ndarray | None:
            if array is None:
                return None
            whole = np.full((len(time_s), *array.shape[1:]), fill, dtype=array.dtype)
            whole[frames] = array
            return whole

        return replace(
            self,
            time_s=time_s,
            positions_m=spread(self.positions_m),
            status=spread(self.status, Status.UNOBSERVABLE),
            frame_numbers=None,
            implausible_frames=tuple(int(frames[frame]) for frame in self.implausible_frames),
            **{name: spread(getattr(self, name)) for name in ("covariance_m2", "residual_px", "visibility")},
        )

    def turned(self, rotation: Float[np.ndarray, "3 3"]) -> Trajectory:
        """The same motion in a world that is turned: every position times this rotation."""
        if (rotation == np.eye(3)).all():
            return self
        covariance_m2 = None if self.covariance_m2 is None else rotation @ self.covariance_m2 @ rotation.T
        return replace(self, positions_m=self.positions_m @ rotation.T, covariance_m2=covariance_m2)

    @property
    def n_frames(self) -> int:
        return len(self.time_s)

    @property
    def observed(self) -> Bool[np.ndarray, "frame joint"]:
        return self.status == Status.OBSERVED

    @property
    def absent(self) -> Bool[np.ndarray, " frame"]:
        """The frames in which nobody is there: nothing is known of any joint."""
        return np.asarray((self.status == Status.UNOBSERVABLE).all(axis=1))

    @property
    def bones(self) -> BoneLengths | None:
        """What it tells of the same person's bones in another recording (see fgpose.smooth); None: nothing."""
        lengths_m, sigma_m = self.bone_lengths_m, self.bone_length_sigma_m
        if lengths_m is None or not np.isfinite(lengths_m).any():
            return None
        own_m = np.full_like(lengths_m, _UNSTATED_M) if sigma_m is None else np.nan_to_num(sigma_m, nan=_UNSTATED_M)
        return BoneLengths(lengths_m, np.hypot(own_m, BETWEEN_RECORDINGS_M))

    def status_share(self, status: Status) -> float:
        """Share of all joints and frames that have this status, in [0, 1]."""
        return float(np.mean(self.status == status))


@dataclass(frozen=True, eq=False, repr=False)
class Estimate(Shown):
    """The joints of one person at one time, as the online estimator gives them."""

    skeleton: Skeleton
    frame: int
    """Number of the frame, counted from 0 in the order of the updates."""
    time_s: float
    positions_m: Float[np.ndarray, "joint 3"]
    status: np.ndarray
    """(J,) values of Status."""
    covariance_m2: Float[np.ndarray, "joint 3 3"] | None = None
    residual_px: Float[np.ndarray, "camera joint"] | None = None
    smoothed: Estimate | None = None
    """The estimate of the newest frame that is one lag old, from all frames since. None until there is one."""
    visibility: Float[np.ndarray, "camera joint"] | None = None
    """As in Trajectory."""
    is_implausible: bool = False
    """Whether the detections that came last make no body (joints tens of metres apart) and were left out."""
    n_repairs: int = 0
    """How often GTSAM has failed so far, and the window was eliminated anew (Estimator.repairs)."""
    bone_lengths: BoneLengths | None = None
    """As far as they have been learned, with symmetry.form "shared_length"; None of an estimate that is one lag old."""
    other_bone: OtherBone | None = None
    """Why the lengths that were given (Estimator.know), or learned so far, are not used any more: somebody else is
    there, or limbs were guessed. The lengths were wrong until then, or are now."""
    velocity_mps: Float[np.ndarray, " 3"] | None = None
    """Of the body as a whole, the median over its joints; None without a motion model, of nobody, and one lag later."""
    newly_smoothed: tuple[Estimate, ...] = ()
    """Of all frames that this update made one lag old, the oldest first: each once. Where intervals are uneven an
    update has none or several. The last one is smoothed."""

    def __getitem__(self, joint: str) -> Float[np.ndarray, " 3"]:
        """Position of a joint by name, metres. Raises ValueError for an unknown name."""
        return self.positions_m[self.skeleton.index(joint)]

    def __post_init__(self) -> None:
        # The estimator goes on from these very arrays.
        for array in (self.positions_m, self.status, self.covariance_m2, self.residual_px, self.visibility):
            if array is not None:
                array.setflags(write=False)
