"""What the fall of a body says of the times and the scale of a recording."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from fgpose.diagnosis.finished import FinishedRecording, of_each_person
from fgpose.finding import Code, Finding, Severity
from fgpose.kinematics.landmarks import Points, landmarks, points_of
from fgpose.sampling import stretches, usual_step_s
from fgpose.trajectory import Trajectory

_GRAVITY_MPS2 = 9.81
# Mass of segments in per cent of that of the body, and their centre of mass as a share of the way from the first joint
# to the second (de Leva 1996, J. Biomech. 29, men; women differ by less than 1 % and 0.05). Hands and feet are taken to
# be at wrists and ankles, the trunk's a little above the middle between shoulders and hips: a constant error of it does
# not fall.
_OF_A_SIDE = (
    ("shoulder", "elbow", 2.71, 0.577),
    ("elbow", "wrist", 1.62, 0.457),
    ("wrist", "wrist", 0.61, 0.0),
    ("hip", "knee", 14.16, 0.410),
    ("knee", "ankle", 4.33, 0.440),
    ("ankle", "ankle", 1.37, 0.0),
)
_TRUNK, _TRUNK_CENTRE, _HEAD = 43.46, 0.45, 6.94
# Who stands on tiptoe has the ankles less than 12 cm higher than who stands: the length of a foot before the ankle.
_OFF_THE_FLOOR_M = 0.12
# Less is a hop or a high step.
_LEAST_FRAMES, _LEAST_RISE_M = 6, 0.05
# A flight is a parabola to within errors of the centre of mass: in six jumps of motion capture (cmu_01_01_a) to within
# 1 to 4 mm rms, of 180 mm of height.
_PARABOLA_SHARE = 0.03
# 30 frames a second where there were 25 make a factor of 1.2; it is distinguished from 1 half-way. Of the six jumps it
# is 1.00 to 1.08, their median 1.02. Far smaller ones may be of somebody who climbs down from something.
_RATE_RATIO, _LEAST_RATE_RATIO = 1.1, 0.45


class Flight(NamedTuple):
    """A time for which nothing touches the floor."""

    start_s: float
    fall_mps2: float
    """Acceleration of the centre of mass, downwards."""


@of_each_person
def wrong_falls(recording: FinishedRecording, person: int, trajectory: Trajectory) -> Finding | None:
    """Jumps in which the body does not fall as things do: frame rate or scale of the recording are wrong."""
    jumps = flights(trajectory)
    if not jumps:
        return None
    fall_mps2 = float(np.median([jump.fall_mps2 for jump in jumps]))
    ratio = np.sqrt(fall_mps2 / _GRAVITY_MPS2)
    if 1 / _RATE_RATIO <= ratio <= _RATE_RATIO or ratio < _LEAST_RATE_RATIO:
        return None
    return Finding(
        Code.FRAME_RATE,
        Severity.WRONG,
        f"in {len(jumps)} jump{'s' if len(jumps) > 1 else ''}, the first at {jumps[0].start_s:.2f} s, "
        f"{recording.called(person) or 'the person'} falls with {fall_mps2:.1f} m/s² instead of {_GRAVITY_MPS2}: the "
        f"frame rate is {ratio:.2f} times the true one, or lengths are {ratio**2:.2f} times the true ones",
        "Check the frame rate (--fps) and the size of the calibration target, or what the scale is from.",
        0.7,
    )


def flights(trajectory: Trajectory) -> list[Flight]:
    """Jumps that are seen wholly and are parabolas; none where the skeleton lacks a limb.

    Args:
        trajectory: of somebody who stands on the floor at some time, in a world with z up.
    """
    joints = landmarks(trajectory.skeleton)
    wanted = {
        f"{side}_{each}" for side in ("left", "right") for first, second, *_ in _OF_A_SIDE for each in (first, second)
    }
    if not wanted <= set(joints) or trajectory.n_frames < _LEAST_FRAMES:
        return []
    ankles = {name: joints[name] for name in ("left_ankle", "right_ankle")}
    foot_m = np.minimum(*(each[:, 2] for each in points_of(trajectory.positions_m, ankles).values()))
    known = np.isfinite(foot_m)
    if not known.any():
        return []
    off_the_floor = foot_m > np.quantile(foot_m[known], 0.05) + _OFF_THE_FLOOR_M
    limbs = sorted({index for name in wanted for index in joints[name]})
    seen = np.all(trajectory.observed[:, limbs], axis=1)
    steady = np.append(np.diff(trajectory.time_s) < 1.5 * usual_step_s(trajectory.time_s), True)
    # The whole body only while it is off the floor: of an hour all of its points take 0.2 GB.
    fits = [
        _fitted(trajectory.time_s[first:last], _height_m(trajectory.positions_m[first:last], joints))
        for first, last in stretches(off_the_floor)
        if first > 0 and last < len(seen) and seen[first:last].all() and steady[first:last].all()
    ]
    return [flight for flight in fits if flight is not None]


def _height_m(
    positions_m: Float[np.ndarray, "frame joint 3"], joints: Mapping[str, tuple[int, ...]]
) -> Float[np.ndarray, " frame"]:
    """Of the centre of mass."""
    return centre_of_mass_m(points_of(positions_m, joints))[:, 2]


def _fitted(time_s: Float[np.ndarray, " frame"], height_m: Float[np.ndarray, " frame"]) -> Flight | None:
    """None if it is not a parabola with its top in between."""
    if len(time_s) < _LEAST_FRAMES:
        return None
    middle_s, half_s = time_s.mean(), (time_s[-1] - time_s[0]) / 2
    square, slope, level = np.polyfit(time_s - middle_s, height_m, 2)
    rms_m = np.sqrt(np.mean((height_m - np.polyval((square, slope, level), time_s - middle_s)) ** 2))
    rise_m = -square * half_s**2
    if rise_m < _LEAST_RISE_M or rms_m > _PARABOLA_SHARE * rise_m or abs(slope) > -2 * square * half_s:
        return None
    return Flight(float(time_s[0]), float(-2 * square))


def centre_of_mass_m(points: Points) -> Float[np.ndarray, "*frames 3"]:
    """Of the body, in the world frame; without a head it is taken to be at the shoulders."""
    middle = {name: (points[f"left_{name}"] + points[f"right_{name}"]) / 2 for name in ("hip", "shoulder")}
    trunk_m = middle["shoulder"] + _TRUNK_CENTRE * (middle["hip"] - middle["shoulder"])
    parts = [(_TRUNK, trunk_m), (_HEAD, points.get("head", middle["shoulder"]))]
    for side in ("left", "right"):
        for first, second, mass, share in _OF_A_SIDE:
            start_m, end_m = points[f"{side}_{first}"], points[f"{side}_{second}"]
            parts.append((mass, start_m + share * (end_m - start_m)))
    masses = np.array([mass for mass, _ in parts])
    return np.tensordot(masses / masses.sum(), np.stack([part_m for _, part_m in parts]), axes=1)
