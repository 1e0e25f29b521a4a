"""Which way is up, from how bodies stand; the cameras are the referee where it is not as usual.

A body is upright most of the time: the axis from its ankles to its head tells the vertical, but for its lean, which is
constant in the frame of the body and is estimated with it. Somebody who lies, or stands on the head, through a whole
recording tells another one. Cameras decide then: they stand level more often than not, so that the long sides of all
images are horizontal, and the vertical is the direction at right angles to all of them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import CameraRig
from fgpose.geometry.up_axis import UpAxis, WorldUp, nearest_axis, up_vector
from fgpose.kinematics.landmarks import landmarks, points_of
from fgpose.sampling import spread_evenly
from fgpose.trajectory import Trajectory

_MAX_FRAMES = 2000  # of each person; the median needs no more
# Walking, standing, lifting and sitting people are within this of the vertical on average, people who lie are not.
_UPRIGHT_DEG = 25.0
_LYING_DEG = 60.0
# A body in fewer frames than this tells nothing.
_LEAST_FRAMES = 3
# A body whose axis is farther than this from its median, in more than 40 % of the frames, tells nothing.
_SCATTER_DEG, _LEAST_SHARE = 45.0, 0.6
# Lean of a walker: 3 degrees (calibration/from_people/world/vertical.py); cameras on tripods are level to one or two.
# An axis is told from a tilt at the first where cameras take part, at the second where bodies alone do.
_LEVEL_DEG, _LEAN_DEG, _UNNOTICED_LEAN_DEG = 5.0, 20.0, 15.0
# Twice by how much cameras on tripods are off.
_DOUBTED_DEG = 8.0
# Bodies and cameras mean the same tilt where they differ by less than this share of it.
_SAME_TILT = 0.6
_LEAN_SIGMA = np.deg2rad(3.0)
# Two cameras that look at right angles have 0.7; less than 0.3 is less than 35 degrees between them.
_LEAST_HEADINGS, _MAX_ROLL = 0.3, np.deg2rad(4.0)


@dataclass(frozen=True)
class FoundUp:
    """Which way is up."""

    world_up: WorldUp
    reason: str = ""
    """Where it is not as usual, or may not be: why."""
    conclusion: str = ""
    """What follows from it, and what to do."""
    is_doubtful: bool = False
    """Whether cameras contradict it."""

    @property
    def remark(self) -> str:
        """Reason and conclusion: a sentence without its end."""
        return self.reason + self.conclusion


@dataclass(frozen=True)
class QuestionedUp:
    """That bodies and cameras contradict what is said to be up."""

    reason: str
    """A sentence without its end."""
    remedy: str
    angle_deg: float
    """Between what they say and what was given."""
    is_tilt: bool
    """Whether it is the same axis in a world that is tilted."""


def find_up(people: Iterable[Trajectory], rig: CameraRig | None = None, usual: UpAxis = "+z") -> FoundUp:
    """Which way is up in the world of people.

    Args:
        people: everybody in a recording.
        rig: the cameras in the same world, if they are known.
        usual: the axis that is up where nothing speaks against it.
    """
    level = None if rig is None else _level_up(rig)
    body = body_up(people)
    found = _found(body, rig, level, usual)
    if body is None or level is None or rig is None or rig.n_cameras < 3:
        return found
    return _doubted(found, body, level)


def question_up(
    given: WorldUp, people: Iterable[Trajectory], rig: CameraRig | None = None, option: str = "--world-up"
) -> QuestionedUp | None:
    """Whether bodies and cameras contradict what a user says is up; None: they do not.

    Args:
        given: what the user says.
        people: everybody in a recording, in the world that it is about.
        rig: the cameras in the same world, if they are known.
        option: with which the user said it.
    """
    found = find_up(people, rig, nearest_axis(given))
    angle_deg = _angle_deg(up_vector(found.world_up), up_vector(given))
    is_tilt = not isinstance(found.world_up, str) and angle_deg <= _UPRIGHT_DEG
    if not found.reason or angle_deg <= (_DOUBTED_DEG if is_tilt else _UPRIGHT_DEG):
        return None
    reason = f"{option} {given} was given, but {found.reason}"
    if is_tilt:
        remedy = f"Angles to the vertical, heights and TRC are off by it. Give {option} auto: it is turned level then."
    else:
        remedy = f"Give {option} {nearest_axis(found.world_up)}, or auto, unless the person lies."
    return QuestionedUp(reason, remedy, angle_deg, is_tilt)


def _found(
    body: Float[np.ndarray, " 3"] | None, rig: CameraRig | None, level: Float[np.ndarray, " 3"] | None, usual: UpAxis
) -> FoundUp:
    coarse = None if rig is None else _coarse_up(rig)
    expected = up_vector(usual)
    if body is None:
        surround = coarse if rig is not None and _surround(rig) else None
        return _by_cameras(surround if level is None else level, expected, usual)
    off_deg = _angle_deg(body, expected)
    if off_deg <= _UPRIGHT_DEG:
        return _perhaps_tilted(body, level, expected, usual)
    cameras_up = coarse if level is None else level
    if cameras_up is not None and _angle_deg(cameras_up, body) > _angle_deg(cameras_up, expected) + _LEAN_DEG:
        return FoundUp(usual, _lies(off_deg, usual) if off_deg > _LYING_DEG else "")
    if cameras_up is not None and _angle_deg(cameras_up, body) < _angle_deg(cameras_up, expected) - _LEAN_DEG:
        return _agreed(body, cameras_up, usual)
    return _by_body_alone(body, off_deg, usual)


def _doubted(found: FoundUp, body: Float[np.ndarray, " 3"], level: Float[np.ndarray, " 3"]) -> FoundUp:
    """Three cameras or more that are level to another vertical than the one that is taken, around a body that is not
    upright along it: of cameras that are not level it would be a coincidence."""
    up = up_vector(found.world_up)
    away_deg = _angle_deg(level, up)
    if not _DOUBTED_DEG < away_deg < _SCATTER_DEG or _angle_deg(body, up) < _LEVEL_DEG:
        return found
    doubt = (
        f"all cameras stand level to a vertical that is {away_deg:.0f} degrees from the one that is taken to be up, "
        "and the body leans: if they are level, angles to the vertical, heights and TRC are off by as much"
    )
    if found.reason:
        return replace(found, conclusion=f"{found.conclusion}; {doubt}", is_doubtful=True)
    return FoundUp(found.world_up, doubt, is_doubtful=True)


def body_up(people: Iterable[Trajectory]) -> Float[np.ndarray, " 3"] | None:
    """The direction in which bodies stand, of length 1; None where it changes, or where ankles and head (hips and
    shoulders, where the skeleton lacks them) are hardly ever known."""
    parts = [_axes(each) for each in people]
    axis, left = (np.concatenate([np.zeros((0, 3)), *(part[n] for part in parts)]) for n in (0, 1))
    if len(axis) < _LEAST_FRAMES:
        return None
    up = geometric_median(axis)
    length = float(np.linalg.norm(up))
    if length == 0.0 or np.mean(axis @ up > length * np.cos(np.deg2rad(_SCATTER_DEG))) < _LEAST_SHARE:
        return None
    return _without_lean(axis, left, up / length)


def geometric_median(vectors: Float[np.ndarray, "some 3"]) -> Float[np.ndarray, " 3"]:
    """The point with the least sum of distances (Weiszfeld), which holds if less than half of the vectors are off."""
    middle = np.median(vectors, axis=0)
    for _ in range(50):  # converges linearly, to 1e-6 here
        weights = 1 / np.maximum(np.linalg.norm(vectors - middle, axis=1), 1e-6)
        middle = weights @ vectors / weights.sum()
    return middle


def _axes(trajectory: Trajectory) -> tuple[Float[np.ndarray, "known 3"], Float[np.ndarray, "known 3"]]:
    """Unit vectors along the body, upwards, and to its left, of the frames in which both are known."""
    joints = landmarks(trajectory.skeleton)
    lower = next((part for part in ("ankle", "hip") if {f"left_{part}", f"right_{part}"} <= joints.keys()), None)
    if lower is None or not {"left_shoulder", "right_shoulder"} <= joints.keys():
        return np.zeros((0, 3)), np.zeros((0, 3))
    points = points_of(trajectory.positions_m[spread_evenly(trajectory.n_frames, _MAX_FRAMES)], joints)
    shoulders_m = (points["left_shoulder"] + points["right_shoulder"]) / 2
    axis_m = points.get("head", shoulders_m) - (points[f"left_{lower}"] + points[f"right_{lower}"]) / 2
    left_m = points["left_shoulder"] - points["right_shoulder"]
    length_m, width_m = (np.linalg.norm(each, axis=-1, keepdims=True) for each in (axis_m, left_m))
    known = (length_m[:, 0] > 0) & (width_m[:, 0] > 0)
    return axis_m[known] / length_m[known], left_m[known] / width_m[known]


def _without_lean(
    axis: Float[np.ndarray, "known 3"], left: Float[np.ndarray, "known 3"], up: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, " 3"]:
    """The vertical such that the axis is it plus a lean, forwards and to the side, that is constant in the body."""
    upright = np.asarray(axis @ up > np.cos(np.deg2rad(_UPRIGHT_DEG)))
    axis, left = axis[upright], left[upright]
    if not len(axis):
        return up
    first = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    first /= np.linalg.norm(first)
    plane = np.stack([first, np.cross(up, first)])
    sideways = left @ plane.T
    sideways /= np.maximum(np.linalg.norm(sideways, axis=1, keepdims=True), 1e-9)
    rows = np.zeros((len(axis), 2, 4))
    rows[:, :, :2] = np.eye(2)
    rows[:, :, 2] = np.stack([sideways[:, 1], -sideways[:, 0]], axis=1)  # forwards: left x up
    rows[:, :, 3] = sideways
    # A frame is off by as much as a lean is, and a walk has some tens of steps that are off for themselves.
    prior = np.diag([0.0, 0.0, len(axis) / 30, len(axis) / 30])
    normal = np.einsum("nia,nib->ab", rows, rows) + prior
    tilt = np.linalg.solve(normal, np.einsum("nia,ni->a", rows, axis @ plane.T))
    turned = up + tilt[:2] @ plane
    return turned / np.linalg.norm(turned)


def _coarse_up(rig: CameraRig) -> Float[np.ndarray, " 3"] | None:
    """The mean of the cameras' upward directions; None where they differ too much, as of cameras on their side."""
    up = -np.mean([camera.world_T_camera[:3, 1] for camera in rig.cameras], axis=0)
    length = float(np.linalg.norm(up))
    return up / length if length > _LEAST_HEADINGS else None


def _level_up(rig: CameraRig) -> Float[np.ndarray, " 3"] | None:
    """The direction at right angles to the horizontal axes of all images; None where cameras look the same way or are
    not level."""
    coarse = _coarse_up(rig)
    if rig.n_cameras < 2 or coarse is None:
        return None
    across = np.stack([camera.world_T_camera[:3, 0] for camera in rig.cameras])
    _, spread, directions = np.linalg.svd(across / np.sqrt(rig.n_cameras), full_matrices=True)
    spread = np.append(spread, 0.0)[:3]
    up = directions[2] * np.sign(directions[2] @ coarse)
    if spread[1] < _LEAST_HEADINGS or spread[2] > _MAX_ROLL or up @ coarse < _LEAST_HEADINGS:
        return None
    return up


def _surround(rig: CameraRig) -> bool:
    """Whether cameras look in different directions; those that all look down from a ceiling, say, do not."""
    forward = np.mean([camera.world_T_camera[:3, 2] for camera in rig.cameras], axis=0)
    return float(np.linalg.norm(forward)) < 1 - _LEAST_HEADINGS


def _by_cameras(level: Float[np.ndarray, " 3"] | None, expected: Float[np.ndarray, " 3"], usual: UpAxis) -> FoundUp:
    if level is None or _angle_deg(level, expected) <= _SCATTER_DEG:
        return FoundUp(usual)
    axis = nearest_axis(_direction(level))
    if _angle_deg(level, up_vector(axis)) > _UPRIGHT_DEG:
        return FoundUp(usual)
    reason, conclusion = f"the cameras stand upright along {axis} of the world", f", so {axis} is taken to be up"
    return FoundUp(axis, reason, f"{conclusion}, not {usual}")


def _perhaps_tilted(
    body: Float[np.ndarray, " 3"],
    level: Float[np.ndarray, " 3"] | None,
    expected: Float[np.ndarray, " 3"],
    usual: UpAxis,
) -> FoundUp:
    """Where the body is nearly as usual, both have to tell a tilt."""
    if level is None or _angle_deg(level, expected) <= _LEVEL_DEG:
        return FoundUp(usual)
    if _angle_deg(body, level) > min(_angle_deg(body, expected) - _LEVEL_DEG, 2 * _LEVEL_DEG):
        return FoundUp(usual)
    return _tilted(body, level)


def _agreed(body: Float[np.ndarray, " 3"], cameras_up: Float[np.ndarray, " 3"], usual: UpAxis) -> FoundUp:
    """Where bodies and cameras say that another axis is up, or a direction between axes, if both mean the same one."""
    axis = nearest_axis(_direction(body + cameras_up))
    offs_deg = [_angle_deg(each, up_vector(axis)) for each in (body, cameras_up)]
    if min(offs_deg) > _LEVEL_DEG and _angle_deg(body, cameras_up) < min(_SAME_TILT * min(offs_deg), 2 * _LEVEL_DEG):
        return _tilted(body, cameras_up)
    conclusion = f", so {axis} is taken to be up"
    if offs_deg[0] > _UNNOTICED_LEAN_DEG:
        conclusion += f"; it leans by {offs_deg[0]:.0f} degrees: if the person does not, the world is tilted"
    return FoundUp(axis, _stands_along(axis, usual), conclusion)


def _by_body_alone(body: Float[np.ndarray, " 3"], off_deg: float, usual: UpAxis) -> FoundUp:
    axis = nearest_axis(_direction(body))
    if _angle_deg(body, up_vector(axis)) <= _LEAN_DEG:
        conclusion = f", so {axis} is taken to be up; if the person lies, say --world-up={usual}"
        return FoundUp(axis, _stands_along(axis, usual), conclusion)
    return FoundUp(
        usual,
        f"the body points {off_deg:.0f} degrees away from {usual}, which is taken to be up: it bends or lies, or the "
        "world is tilted or has another axis up (--world-up)",
    )


def _stands_along(axis: UpAxis, usual: UpAxis) -> str:
    return f"the body stands along {axis} of the world, not along {usual}"


def _tilted(body: Float[np.ndarray, " 3"], cameras_up: Float[np.ndarray, " 3"]) -> FoundUp:
    up = body + cameras_up
    up /= np.linalg.norm(up)
    axis = nearest_axis(_direction(up))
    return FoundUp(
        _direction(up),
        f"the world is tilted by {_angle_deg(up, up_vector(axis)):.0f} degrees from {axis} up, as the body and the "
        "cameras stand",
        "; what needs the vertical (TRC, C3D, angles, report) is turned level, to about 3 degrees",
    )


def _lies(off_deg: float, usual: UpAxis) -> str:
    return (
        f"the body lies or stands on its head: it points {off_deg:.0f} degrees away from {usual}, which is up as the "
        "cameras stand; if it stood upright, give the axis that is up (--world-up)"
    )


def _angle_deg(first: Float[np.ndarray, " 3"], second: Float[np.ndarray, " 3"]) -> float:
    return float(np.rad2deg(np.arccos(np.clip(first @ second, -1.0, 1.0))))


def _direction(vector: Float[np.ndarray, " 3"]) -> tuple[float, float, float]:
    x, y, z = (float(each) for each in vector)
    return x, y, z
