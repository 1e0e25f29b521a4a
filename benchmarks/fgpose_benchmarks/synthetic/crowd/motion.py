"""True motion of several people in one room: they walk past each other, work, go out and come back."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from fgpose.io.skeletons import load_skeleton
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic.body_motion import (
    Gait,
    Motion,
    Poses,
    Work,
    above_legs,
    gait_of,
    leg_length_m,
    positions_of,
    work_of,
)
from fgpose_benchmarks.synthetic.crowd.bodies import Furniture
from fgpose_benchmarks.synthetic.crowd.routes import CrowdPlan, Route, crossing_frames, draw_habits, plan_route
from fgpose_benchmarks.synthetic.crowd.sitting import Seat, seated
from fgpose_benchmarks.synthetic.snapping import stretches

MIN_DISTANCE_M = 0.45
"""Between any two pelvises, over the floor."""
_RESTARTS = 10
_MIN_SIZE, _MAX_SIZE = 0.88, 1.1
_PROPORTION_SIGMA = 0.03  # of each length, mirrored bones alike
_SMOOTH_S = 0.15
_HEADING_SIGMA_S = 0.25
_VIGOUR_SIGMA = 0.08  # some take longer steps than others
_POSTURE_SIGMA = 0.05  # constant lean of each bone of trunk and arms, radians
_SWAY = 0.03  # SD of the slow wavering of trunk and arms, radians
_SWAY_SIGMA_S = 0.5
_WORK_BLEND_S = 0.8
_SIT_BLEND_S = 1.2  # half of the time from standing to sitting; begins slowly enough to turn round before
_GESTURES = 0.4  # share of the work in the arms and trunk of somebody who sits


@dataclass(frozen=True)
class MotionEvent:
    kind: Literal["enters", "leaves", "returns", "crossing", "sits", "rises"]
    """sits: is at a seat and turns round to sit down. rises: has got up and goes on."""
    frame: int
    people: tuple[int, ...]
    """One, or the two who pass each other."""


@dataclass(frozen=True, eq=False)
class CrowdMotion:
    """The true motion of several people, who need not be there all the time.

    Raises:
        ValueError: the truth has another shape, a person is there in part, or the frame rate is not positive.
    """

    skeleton: Skeleton
    truth_m: np.ndarray
    """(N, T, J, 3) persons, frames and joints; world frame, metres, floor at z = 0; NaN while a person is not there."""
    fps: float
    events: tuple[MotionEvent, ...] = ()
    """In the order of their frames."""
    furniture: tuple[Furniture, ...] = ()

    def __post_init__(self) -> None:
        shape, n_joints = self.truth_m.shape, self.skeleton.n_joints
        if len(shape) != 4 or shape[2:] != (n_joints, 3) or 0 in shape:
            raise ValueError(f"truth_m must be (people, frames, {n_joints}, 3), got {shape}")
        numbers = np.isfinite(self.truth_m).reshape(*shape[:2], -1)
        in_part = np.argwhere(numbers.any(axis=-1) & ~numbers.all(axis=-1))
        if len(in_part):
            raise ValueError(f"person {in_part[0][0]}, frame {in_part[0][1]}: some numbers are finite, some are not")
        if not 0 < self.fps < np.inf:
            raise ValueError(f"the frame rate must be a positive number, got {self.fps:g}")

    @property
    def n_people(self) -> int:
        return len(self.truth_m)

    @property
    def is_there(self) -> Bool[np.ndarray, "person frame"]:
        return np.asarray(np.isfinite(self.truth_m).all(axis=(2, 3)))


def crowd_motion(
    n_people: int,
    n_frames: int,
    fps: float,
    gaits: Sequence[Motion],
    works: Sequence[Motion],
    seed: int,
    plan: CrowdPlan | None = None,
    furniture: Sequence[Furniture] = (),
    seats: Sequence[Seat] = (),
) -> CrowdMotion:
    """People of different sizes (skeleton h36m_17) who walk, work, come and go in a room around the world's origin.

    A person has one gait, and does the same work at every stop where he works; the clips are given out in turn.

    Args:
        gaits: recorded walks on an even floor, of which one cycle is repeated.
        works: recordings of people who stay on the spot.
        furniture: nobody walks through it, and it hides joints.
        seats: those who do not go out in between sit down on them, as many as there are seats: they make for them
            at once, and get up after about three quarters of the time. They are furniture too.

    Raises:
        ValueError: there is no person, no frame or no clip, a walk is too short, the people find no way around each
            other, or a seat is too high or too low for somebody.
    """
    if n_people < 1 or n_frames < 2 or not fps > 0 or not gaits or not works:
        raise ValueError("a crowd needs a person, two frames, a positive frame rate, a gait and a work")
    skeleton, plan = load_skeleton("h36m_17"), plan or CrowdPlan()
    rng = np.random.default_rng(seed)
    habits = draw_habits(rng, n_people, n_frames / fps, plan, seats)
    cycles, clips = [gait_of(clip, skeleton) for clip in gaits], [work_of(clip, skeleton) for clip in works]
    subject_m = skeleton.bone_lengths(np.asarray(gaits[0][0], dtype=float)[:1])[0]
    truth_m = np.full((n_people, n_frames, skeleton.n_joints, 3), np.nan)
    sittings: list[MotionEvent] = []
    for person, habit in enumerate(habits):
        gait, work = cycles[person % len(cycles)], clips[person % len(clips)]
        performer = _Performer.drawn(rng, skeleton, subject_m, gait, work, fps)
        others_m = truth_m[:person, :, skeleton.index("pelvis"), :2]
        for _ in range(_RESTARTS):
            route = plan_route(rng, others_m, fps, plan, furniture, habit, seats)
            truth_m[person] = performer.walks(route, rng)
            if _keeps_distance(truth_m[person, :, skeleton.index("pelvis"), :2], others_m):
                break
        else:
            raise ValueError(f"person {person} comes nearer to another than {MIN_DISTANCE_M:g} m whichever way he goes")
        sittings += _sittings(person, route.sits)
    events = [*_events(truth_m[:, :, skeleton.index("pelvis"), :2], fps, plan), *sittings]
    events.sort(key=lambda event: (event.frame, event.people))
    return CrowdMotion(skeleton, truth_m, fps, tuple(events), (*furniture, *(seat.box for seat in seats)))


def motion_on(route: Route, fps: float, gait: Motion, work: Motion, seed: int) -> CrowdMotion:
    """One person (skeleton h36m_17) of a size of his own on a way that is given; clips as of crowd_motion.

    Raises:
        ValueError: the walk is too short.
    """
    skeleton, rng = load_skeleton("h36m_17"), np.random.default_rng(seed)
    subject_m = skeleton.bone_lengths(np.asarray(gait[0], dtype=float)[:1])[0]
    cycle, clip = gait_of(gait, skeleton), work_of(work, skeleton)
    performer = _Performer.drawn(rng, skeleton, subject_m, cycle, clip, fps)
    return CrowdMotion(skeleton, performer.walks(route, rng)[None], fps)


@dataclass(frozen=True, eq=False)
class _Performer:
    skeleton: Skeleton
    bone_lengths_m: Float[np.ndarray, " bone"]
    gait: Gait
    work: Work
    fps: float
    vigour: float
    """Length of the steps relative to the recorded walk."""
    posture: Float[np.ndarray, "bone 3"]

    @staticmethod
    def drawn(
        rng: np.random.Generator,
        skeleton: Skeleton,
        subject_m: Float[np.ndarray, " bone"],
        gait: Gait,
        work: Work,
        fps: float,
    ) -> _Performer:
        """Of a size, with proportions and habits of his own; lengths are those of the recorded subject."""
        bone_lengths_m = _body_m(rng, subject_m, skeleton)
        vigour = 1.0 + _VIGOUR_SIGMA * float(np.clip(rng.standard_normal(), -2.0, 2.0))
        posture = _POSTURE_SIGMA * rng.standard_normal((len(skeleton.bones), 3)) * above_legs(skeleton)
        return _Performer(skeleton, bone_lengths_m, gait, work, fps, vigour, posture)

    def walks(self, route: Route, rng: np.random.Generator) -> Float[np.ndarray, "frame joint 3"]:
        """All joints on a route; NaN where it is NaN."""
        there = np.asarray(np.isfinite(route.ground_m).all(axis=-1))
        positions_m = np.full((len(there), self.skeleton.n_joints, 3), np.nan)
        for start, end in stretches(there):
            positions_m[start:end] = self._walks(route.of_frames(slice(start, end)), start, rng)
        return positions_m

    def _walks(self, route: Route, start: int, rng: np.random.Generator) -> Float[np.ndarray, "frame joint 3"]:
        """On a part of a route, from the start on."""
        ground_m, work, sits = route.ground_m, route.work, self._eased(route.sits, _SIT_BLEND_S)
        n, leg_m = len(ground_m), leg_length_m(self.bone_lengths_m, self.skeleton)
        velocity_mps = _gradient(ground_m) * self.fps
        speed_mps = self._smooth(np.linalg.norm(velocity_mps, axis=-1), _SMOOTH_S)
        # Slower people take shorter and fewer steps: both as the square root of the speed.
        natural_mps = self.gait.stride * leg_m / self.gait.cycle_s
        vigour = self._smooth(np.clip(self.vigour * np.sqrt(speed_mps / natural_mps), 0.0, 1.2), _SMOOTH_S)
        steps = speed_mps / np.maximum(vigour, 0.05) / (self.gait.stride * leg_m * self.fps)
        poses = _repeated(self.gait.standing, n).blend(self.gait.at(rng.random() + np.cumsum(steps)), vigour)
        since_s = np.where(work >= 0, start + np.arange(n) - work, 0) / self.fps
        poses = poses.blend(self.work.at(since_s), self._eased(work >= 0, _WORK_BLEND_S) * (1 - (1 - _GESTURES) * sits))
        poses = poses.leaning(self.posture + self._sway(rng, n))
        if route.seat is not None:
            poses = seated(poses, sits, route.seat.hips_m, self.bone_lengths_m, self.skeleton)
        return positions_of(poses, self.bone_lengths_m, ground_m, self._heading(velocity_mps, route), self.skeleton)

    def _eased(self, does: Bool[np.ndarray, " frame"], blend_s: float) -> Float[np.ndarray, " frame"]:
        """Share of what somebody does in the pose: it goes up and down within the time, over twice blend_s."""
        from scipy.ndimage import binary_erosion, gaussian_filter1d

        sigma = blend_s / 3 * self.fps
        width = 2 * int(3 * sigma + 0.5) + 1
        inner = binary_erosion(does, np.ones(width), border_value=1)
        return gaussian_filter1d(inner.astype(float), sigma, truncate=3.0, mode="nearest")

    def _heading(self, velocity_mps: Float[np.ndarray, "frame 2"], route: Route) -> Float[np.ndarray, " frame"]:
        """Where the person faces, radians: where he walks or sits; who stands turns in time for his next walk."""
        known = (np.linalg.norm(velocity_mps, axis=-1) > 0.1) | route.sits
        if not known.any():
            return np.zeros(len(velocity_mps))
        frames = np.flatnonzero(known)
        last = frames[np.maximum(np.searchsorted(frames, np.arange(len(known)), side="right") - 1, 0)]
        yaw = np.arctan2(velocity_mps[:, 1], velocity_mps[:, 0])
        yaw = (yaw if route.seat is None else np.where(route.sits, route.seat.facing_rad, yaw))[last]
        return self._smooth(np.unwrap(yaw), _HEADING_SIGMA_S)

    def _sway(self, rng: np.random.Generator, n: int) -> Float[np.ndarray, "frame bone 3"]:
        """Of trunk and arms, not of the legs: feet stay where they are."""
        draws = self._smooth(rng.standard_normal((n, len(self.skeleton.bones), 3)), _SWAY_SIGMA_S)
        # SD of white noise after the filter: 1 / sqrt(2 sqrt(pi) sigma).
        draws *= _SWAY * np.sqrt(2 * np.sqrt(np.pi) * _SWAY_SIGMA_S * self.fps)
        return draws * above_legs(self.skeleton)

    def _smooth(self, values: np.ndarray, sigma_s: float) -> np.ndarray:
        from scipy.ndimage import gaussian_filter1d

        return gaussian_filter1d(values, sigma_s * self.fps, axis=0, mode="nearest")


def _repeated(poses: Poses, n: int) -> Poses:
    return Poses(np.repeat(poses.direction, n, axis=0), np.repeat(poses.root, n, axis=0))


def _gradient(ground_m: Float[np.ndarray, "frame 2"]) -> Float[np.ndarray, "frame 2"]:
    return np.gradient(ground_m, axis=0) if len(ground_m) > 1 else np.zeros_like(ground_m)


def _body_m(
    rng: np.random.Generator, subject_m: Float[np.ndarray, " bone"], skeleton: Skeleton
) -> Float[np.ndarray, " bone"]:
    """Bone lengths of a body of its own: size and, a little, proportions; mirrored bones are equally long."""
    of_length = 1.0 + _PROPORTION_SIGMA * np.clip(rng.standard_normal(skeleton.n_lengths), -2.0, 2.0)
    number = np.array(skeleton.length_of_bone)
    _, first = np.unique(number, return_index=True)
    return rng.uniform(_MIN_SIZE, _MAX_SIZE) * (of_length * subject_m[first])[number]


def _keeps_distance(own_m: Float[np.ndarray, "frame 2"], others_m: Float[np.ndarray, "person frame 2"]) -> bool:
    return not (np.linalg.norm(others_m - own_m, axis=-1) < MIN_DISTANCE_M).any()


def _sittings(person: int, sits: Bool[np.ndarray, " frame"]) -> Iterator[MotionEvent]:
    for start, end in stretches(sits):
        yield MotionEvent("sits", start, (person,))
        if end < len(sits):
            yield MotionEvent("rises", end, (person,))


def _events(ground_m: Float[np.ndarray, "person frame 2"], fps: float, plan: CrowdPlan) -> list[MotionEvent]:
    events: list[MotionEvent] = []
    for person, there in enumerate(np.asarray(np.isfinite(ground_m).all(axis=-1))):
        for visit, (start, end) in enumerate(stretches(there)):
            if start > 0:
                events.append(MotionEvent("enters" if visit == 0 else "returns", start, (person,)))
            if end < len(there):
                events.append(MotionEvent("leaves", end, (person,)))
    for a, b in combinations(range(len(ground_m)), 2):
        frames = crossing_frames(ground_m[a], ground_m[b], fps, plan)
        events += [MotionEvent("crossing", frame, (a, b)) for frame in frames.tolist()]
    return events
