"""BVH, the motion file of Biovision that Blender and other animation programs read."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from fgpose.geometry.up_axis import WorldUp, y_up
from fgpose.io.atomic import write_text
from fgpose.io.trajectories.markers import constant_rate_hz, in_whole_frames, warn_of_uneven_times
from fgpose.kinematics.poses import SegmentPoses, segment_poses
from fgpose.trajectory import Trajectory

_NAMES = {"pelvis": "Hips", "thorax": "Spine", "head": "Neck"}
_OF_A_SIDE = {"thigh": "UpLeg", "shank": "Leg", "foot": "Foot", "upper_arm": "Arm", "forearm": "ForeArm"}
_MOSTLY_GAPS = 65535  # frames of a recording that is mostly gaps: those of days are closed
_Y_UP_R_Z_UP = y_up(np.eye(3), "z").T


@dataclass(frozen=True, eq=False)
class _Body:
    """Segments that hang on each other at constant offsets, in metres and in the axes of the parent."""

    poses: SegmentPoses
    offset_m: Float[np.ndarray, "segment 3"]
    end_m: Float[np.ndarray, "segment 3"]

    def children(self, index: int) -> list[int]:
        return [child for child in range(len(self.offset_m)) if self.poses.parent(child) == index]


def write_bvh(trajectory: Trajectory, path: Path, world_up: WorldUp = "z") -> None:
    """Write a body in metres with y up: bones have their median lengths, the root moves, all else turns.

    At zero rotation the body stands upright with hanging arms and faces +x. The axes of every joint are those of its
    segment (x forward, y up, z to the right), and rotations are in the order Z, X, Y. The format has no gaps:
    where rotations are unknown, or frames missing, they are held, and the root is interpolated. Segments that are never
    known are left out.

    Args:
        trajectory: of one person.
        path: the file.
        world_up: what is up in its world.

    Warns:
        UserWarning: the true times differ noticeably from those of a constant rate, which is all that a BVH file holds.

    Raises:
        ValueError: the skeleton lacks hips or shoulders, pelvis and trunk are known in no frame, or the times do not
            increase.
        OSError: the file cannot be written.
    """
    rate_hz = constant_rate_hz(trajectory.time_s)
    whole = in_whole_frames(trajectory, rate_hz, max(2 * trajectory.n_frames, _MOSTLY_GAPS))
    body, times_s = _body(_known_segments(segment_poses(whole, world_up), path)), whole.time_s
    warn_of_uneven_times(times_s, rate_hz, path, "BVH")
    lines = ["HIERARCHY", *_joint(body, 0, 0), "MOTION", f"Frames: {len(times_s)}"]
    lines.append(f"Frame Time: {1.0 / rate_hz:.10g}")
    channels = _channels(body)
    lines += [" ".join(f"{value:.6f}" for value in row) for row in channels.tolist()]
    write_text(path, "\n".join(lines) + "\n")


def _known_segments(poses: SegmentPoses, path: Path) -> SegmentPoses:
    known = np.asarray(np.isfinite(poses.world_R_segment).all(axis=(-2, -1)).any(axis=0))
    if not known[0]:
        raise ValueError(f"{path}: hips and shoulders are known in no frame: there is no body to be written")
    keep: list[int] = []
    for index in range(len(poses.segments)):
        parent = poses.parent(index)
        if known[index] and (parent is None or parent in keep):
            keep.append(index)
    return poses.subset(keep)


def _body(poses: SegmentPoses) -> _Body:
    def median_in(index: int, vectors_m: Float[np.ndarray, "frame 3"]) -> Float[np.ndarray, " 3"]:
        inside_m = np.einsum("tji,tj->ti", poses.world_R_segment[:, index], vectors_m)
        known_m = inside_m[np.isfinite(inside_m).all(axis=1)]
        return np.median(known_m, axis=0) if len(known_m) else np.zeros(3)

    offset_m = np.zeros((len(poses.segments), 3))
    for index in range(len(offset_m)):
        parent = poses.parent(index)
        if parent is not None:
            offset_m[index] = median_in(parent, poses.origin_m[:, index] - poses.origin_m[:, parent])
    ends_m = [median_in(index, poses.end_m[:, index] - poses.origin_m[:, index]) for index in range(len(offset_m))]
    return _Body(poses, offset_m, np.array(ends_m))


def _name(segment: str) -> str:
    side, _, part = segment.partition("_")
    return _NAMES.get(segment) or side.capitalize() + _OF_A_SIDE[part]


def _joint(body: _Body, index: int, depth: int) -> Iterator[str]:
    indent = "  " * depth
    yield f"{indent}{'JOINT' if depth else 'ROOT'} {_name(body.poses.segments[index].name)}"
    yield indent + "{"
    yield f"{indent}  OFFSET {_numbers(body.offset_m[index])}"
    position = "" if depth else "Xposition Yposition Zposition "
    yield f"{indent}  CHANNELS {3 if depth else 6} {position}Zrotation Xrotation Yrotation"
    children = body.children(index)
    for child in children:
        yield from _joint(body, child, depth + 1)
    if not children:
        yield f"{indent}  End Site"
        yield f"{indent}  {{"
        yield f"{indent}    OFFSET {_numbers(body.end_m[index])}"
        yield f"{indent}  }}"
    yield indent + "}"


def _numbers(vector: Float[np.ndarray, " 3"]) -> str:
    return " ".join(f"{value:.6f}" for value in vector)


def _channels(body: _Body) -> Float[np.ndarray, "frame channel"]:
    """Position of the root, and the rotations of the joints in the order in which the hierarchy names them."""
    from scipy.spatial.transform import Rotation

    poses = body.poses
    world_R_segment = _Y_UP_R_Z_UP @ _held(poses.world_R_segment)
    columns = [y_up(_interpolated(poses.origin_m[:, 0], np.asarray(poses.time_s)), "z")]
    order = _depth_first(body, 0)
    for index in order:
        parent, turned = poses.parent(index), world_R_segment[:, index]
        if parent is not None:
            turned = world_R_segment[:, parent].swapaxes(-1, -2) @ turned
        columns.append(Rotation.from_matrix(turned).as_euler("ZXY", degrees=True))
    return np.concatenate(columns, axis=1)


def _depth_first(body: _Body, index: int) -> list[int]:
    return [index, *(each for child in body.children(index) for each in _depth_first(body, child))]


def _held(rotations: Float[np.ndarray, "frame segment 3 3"]) -> Float[np.ndarray, "frame segment 3 3"]:
    """The last known rotation where there is none, before the first one that."""
    known = np.asarray(np.isfinite(rotations).all(axis=(-2, -1)))
    last = np.maximum.accumulate(np.where(known, np.arange(len(known))[:, None], -1), axis=0)
    source = np.where(last < 0, known.argmax(axis=0), last)
    return rotations[source, np.arange(known.shape[1])]


def _interpolated(positions_m: Float[np.ndarray, "frame 3"], time_s: np.ndarray) -> Float[np.ndarray, "frame 3"]:
    known = np.isfinite(positions_m).all(axis=1)
    return np.stack([np.interp(time_s, time_s[known], axis_m) for axis_m in positions_m[known].T], axis=1)
