"""Poses of a person from motion capture, put on a body of another size and on another way through the room."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic.motion import turned

Motion = tuple[np.ndarray, float]
"""Positions (frame, joint, 3) of skeleton h36m_17 in metres, floor at z = 0, and frames per second."""

ANKLE_M = 0.09  # height of the ankle of somebody who stands
_MIN_CYCLE_S, _MAX_CYCLE_S = 0.8, 1.6
_CROSSFADE = 0.2  # share of a gait cycle over which its end goes over into its beginning
_YAW_SIGMA_S = 0.25  # slower than the turning of the pelvis at each step, faster than a bend of the way
_GROUND_SIGMA_S = 0.3


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses without size or place: x is forward, y left, z up."""

    direction: Float[np.ndarray, "frame bone 3"]
    """Unit vectors along the bones, from the joint nearer to the root."""
    root: Float[np.ndarray, "frame 3"]
    """Around the mean way, and above the floor; in leg lengths."""

    def of_frames(self, frames: slice | Int[np.ndarray, " frame"]) -> Poses:
        return Poses(self.direction[frames], self.root[frames])

    def leaning(self, by: Float[np.ndarray, "frame bone 3"]) -> Poses:
        """With small vectors added to the directions: radians."""
        direction = self.direction + by
        return Poses(direction / np.linalg.norm(direction, axis=-1, keepdims=True), self.root)

    def blend(self, other: Poses, share: Float[np.ndarray, " frame"]) -> Poses:
        """On the way to other poses; a share beyond 1 exaggerates them."""
        root = self.root + share[:, None] * (other.root - self.root)
        return Poses(self.direction, root).leaning(share[:, None, None] * (other.direction - self.direction))


@dataclass(frozen=True, eq=False)
class Gait:
    """One cycle of walking, to be repeated."""

    cycle: Poses
    stride: float
    """Way of one cycle in leg lengths."""
    cycle_s: float

    def at(self, phase: Float[np.ndarray, " frame"]) -> Poses:
        """At phases in cycles."""
        return _sampled(self.cycle, (phase % 1.0) * len(self.cycle.root), periodic=True)

    @property
    def standing(self) -> Poses:
        """One frame: the mean of the cycle."""
        direction = self.cycle.direction.mean(axis=0, keepdims=True)
        root = self.cycle.root.mean(axis=0, keepdims=True)
        return Poses(direction / np.linalg.norm(direction, axis=-1, keepdims=True), root)


@dataclass(frozen=True, eq=False)
class Work:
    """What somebody does on the spot, to be played forwards and backwards."""

    poses: Poses
    fps: float

    def at(self, time_s: Float[np.ndarray, " frame"]) -> Poses:
        """Every pass lasts as long as the recording and eases in and out, so that nothing jolts when it turns back."""
        last = len(self.poses.root) - 1
        passes = time_s * self.fps / max(last, 1)
        there_and_back = 1.0 - np.abs(passes % 2.0 - 1.0)
        turn = min(0.25, self.fps / max(last, 1) / 2)  # half a second, or a quarter of a pass
        return _sampled(self.poses, last * _eased(there_and_back, turn), periodic=False)


def gait_of(motion: Motion, skeleton: Skeleton) -> Gait:
    """The cycle of a recorded walk that closes best.

    Raises:
        ValueError: the recording is shorter than a cycle of 0.8 s and what blends it.
    """
    positions_m, fps = motion
    poses, yaw = _poses_of(motion, skeleton)
    start, n = _cycle(poses, fps)
    # What comes before the cycle leads into it: the end of the cycle goes over into that.
    fade = round(n * _CROSSFADE)
    share = np.concatenate([np.zeros(n - fade), np.arange(fade) / fade])
    before = np.maximum(np.arange(start - n, start), 0)
    closed = poses.of_frames(slice(start, start + n)).blend(poses.of_frames(before), share)
    steps_m = np.diff(positions_m[start : start + n + 1, skeleton.index("pelvis"), :2], axis=0)
    forward_m = np.sum(steps_m * _unit(yaw[start : start + n]), axis=-1)
    aside_m = np.sum(steps_m * _unit(yaw[start : start + n] + np.pi / 2), axis=-1)
    leg_m = _leg_m(positions_m, skeleton)
    sway = np.stack([_around_progress(forward_m), _around_progress(aside_m)], axis=-1) / leg_m
    root = np.concatenate([sway, closed.root[:, 2:]], axis=-1)
    return Gait(Poses(closed.direction, root), float(forward_m.sum()) / leg_m, n / fps)


def work_of(motion: Motion, skeleton: Skeleton) -> Work:
    """A recording of somebody who stays about where he is; his first frame faces forward."""
    positions_m, fps = motion
    poses, yaw = _poses_of(motion, skeleton)
    forward = turned(poses.direction, (yaw - yaw[0])[:, None])
    ground_m = positions_m[:, skeleton.index("pelvis"), :2]
    away_m = ground_m - (ground_m.min(axis=0) + ground_m.max(axis=0)) / 2
    away_m = np.concatenate([away_m, np.zeros((len(away_m), 1))], axis=-1)
    root = turned(away_m, np.full(len(away_m), -yaw[0])) / _leg_m(positions_m, skeleton)
    root[:, 2] = poses.root[:, 2]
    return Work(Poses(forward, root), fps)


def positions_of(
    poses: Poses,
    bone_lengths_m: Float[np.ndarray, " bone"],
    ground_m: Float[np.ndarray, "frame 2"],
    heading_rad: Float[np.ndarray, " frame"],
    skeleton: Skeleton,
) -> Float[np.ndarray, "frame joint 3"]:
    """The joints of a body in these poses on a way over the floor, world frame, metres. Bones are rigid."""
    leg_m = leg_length_m(bone_lengths_m, skeleton)
    positions_m = np.zeros((len(ground_m), skeleton.n_joints, 3))
    root = skeleton.index("pelvis")
    positions_m[:, root] = turned(leg_m * poses.root, heading_rad)
    positions_m[:, root, :2] += ground_m
    direction = turned(poses.direction, heading_rad[:, None])
    for number, (a, b) in enumerate(skeleton.bones):
        positions_m[:, b] = positions_m[:, a] + bone_lengths_m[number] * direction[:, number]
    return positions_m


def _poses_of(motion: Motion, skeleton: Skeleton) -> tuple[Poses, Float[np.ndarray, " frame"]]:
    """Poses in the frame of the heading, and the heading in radians; of the root, only the height."""
    from scipy.ndimage import gaussian_filter1d

    positions_m, fps = motion
    to_left_m = positions_m[:, skeleton.index("left_hip")] - positions_m[:, skeleton.index("right_hip")]
    yaw = np.unwrap(np.arctan2(-to_left_m[:, 0], to_left_m[:, 1]))
    yaw = gaussian_filter1d(yaw, _YAW_SIGMA_S * fps, mode="nearest")
    start, end = skeleton.bone_ends
    bone_m = positions_m[:, end] - positions_m[:, start]
    direction = turned(bone_m / np.linalg.norm(bone_m, axis=-1, keepdims=True), -yaw[:, None])
    ankles = [skeleton.index("left_ankle"), skeleton.index("right_ankle")]
    floor_m = gaussian_filter1d(positions_m[:, ankles, 2].min(axis=1), _GROUND_SIGMA_S * fps, mode="nearest") - ANKLE_M
    root = np.zeros((len(positions_m), 3))
    root[:, 2] = (positions_m[:, skeleton.index("pelvis"), 2] - floor_m) / _leg_m(positions_m, skeleton)
    return Poses(direction, root), yaw


def _cycle(poses: Poses, fps: float) -> tuple[int, int]:
    """First frame and length of the cycle after which the motion goes on as it began."""
    lengths = range(round(_MIN_CYCLE_S * fps), round(_MAX_CYCLE_S * fps) + 1)
    gaps = [(*_best_start(poses, n), n) for n in lengths if len(poses.root) > n * (1 + _CROSSFADE) + 1]
    if not gaps:
        shortest_s = _MIN_CYCLE_S * (1 + _CROSSFADE)
        raise ValueError(f"a recorded walk must be longer than {shortest_s:.2f} s, got {len(poses.root) / fps:.2f} s")
    _, start, n = min(gaps)
    return start, n


def _best_start(poses: Poses, n: int) -> tuple[float, int]:
    """How far apart poses n frames apart are at least, and where; early frames are kept for the cross-fade."""
    gap = np.sum((poses.direction[n:] - poses.direction[:-n]) ** 2, axis=(1, 2))
    gap = gap[:-1] + gap[1:]  # of two frames: the motion has to go on as well
    first = round(n * _CROSSFADE)
    start = first + int(np.argmin(gap[first:]))
    return float(gap[start]), start


def _around_progress(steps_m: Float[np.ndarray, " frame"]) -> Float[np.ndarray, " frame"]:
    """Where the steps of a cycle lead, around even progress."""
    at_m = np.cumsum(steps_m) - steps_m - np.arange(len(steps_m)) * steps_m.mean()
    return at_m - at_m.mean()


def _leg_m(positions_m: Float[np.ndarray, "frame joint 3"], skeleton: Skeleton) -> float:
    return leg_length_m(skeleton.bone_lengths(positions_m[:1])[0], skeleton)


def leg_length_m(bone_lengths_m: Float[np.ndarray, " bone"], skeleton: Skeleton) -> float:
    """Hip above the floor of somebody who stands straight."""
    chain = [skeleton.index(f"left_{joint}") for joint in ("hip", "knee", "ankle")]
    return sum(float(bone_lengths_m[skeleton.bones.index(bone)]) for bone in pairwise(chain)) + ANKLE_M


def above_legs(skeleton: Skeleton) -> Float[np.ndarray, "bone 1"]:
    """1 for bones of trunk, head and arms, 0 for those that end in a leg."""
    ends = [skeleton.joints[end] for _, end in skeleton.bones]
    return np.array([[0.0 if end.endswith(("hip", "knee", "ankle")) else 1.0] for end in ends])


def _sampled(poses: Poses, at_frame: Float[np.ndarray, " new_frame"], *, periodic: bool) -> Poses:
    """Between frames; linear interpolation of 50 Hz is off by a millimetre at 20 m/s^2, so a spline is used."""
    from scipy.interpolate import CubicSpline

    flat = np.concatenate([poses.direction.reshape(len(poses.root), -1), poses.root], axis=1)
    flat = np.concatenate([flat, flat[:1]]) if periodic else flat
    values = CubicSpline(np.arange(len(flat)), flat, bc_type="periodic" if periodic else "not-a-knot")(at_frame)
    direction = values[:, :-3].reshape(len(at_frame), -1, 3)
    return Poses(direction / np.linalg.norm(direction, axis=-1, keepdims=True), values[:, -3:])


def _eased(share: Float[np.ndarray, " frame"], turn: float) -> Float[np.ndarray, " frame"]:
    """From 0 to 1 with even progress in the middle and rest at both ends, each end taking a share turn."""
    scale = 1.0 / (1.0 - turn)
    into = scale * share**2 / (2 * turn)
    out_of = 1.0 - scale * (1.0 - share) ** 2 / (2 * turn)
    return np.select([share < turn, share > 1.0 - turn], [into, out_of], scale * (share - turn / 2))


def _unit(yaw: Float[np.ndarray, " frame"]) -> Float[np.ndarray, "frame 2"]:
    return np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
