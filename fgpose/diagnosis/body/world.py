"""The world of the calibration by the body in it: its unit, and which way is up."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from fgpose.diagnosis.body.proportions import LEAST_FRAMES, rough_stature_m, stature_m
from fgpose.diagnosis.examined import Examined, NotJudgedError
from fgpose.diagnosis.finished import FinishedRecording
from fgpose.finding import Code, Finding, Severity
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.up_axis import WorldUp, z_up_R_world
from fgpose.kinematics.vertical import find_up, question_up
from fgpose.trajectory import Status, Trajectory

# A child of one year is 0.75 m tall, the tallest people 2.3 m (WHO Child Growth Standards; NCD-RisC 2020); the stature
# is known to about 10 % from the lengths of limbs, to half of it from one or two of them.
_SMALLEST_M, _TALLEST_M = 0.65, 2.4
_ROUGHLY = 1.5
_USUAL_M = 1.7
_LIKE = 0.15  # of a known factor: statures of adults, and the error of the measured one
_SHORT = {
    "millimetres": "mm",
    "centimetres": "cm",
    "decimetres": "dm",
    "inches": "inch",
    "feet": "ft",
    "metres": "m",
}
# Grown-ups, with what limbs tell of the stature: 1 % of them are smaller than 1.5 m or larger than 2 m.
_GROWN_UP_M = (1.4, 2.1)
_STATURE_SIGMA = 0.06  # of grown-ups, as a share
# Squares of the boards that people print, metres.
_SQUARE_M = (0.012, 0.13)


class Mistake(NamedTuple):
    """Units that were mistaken for each other."""

    factor: float
    """What lengths have to be multiplied by."""
    true: str
    read_as: str


_MISTAKES = (
    Mistake(0.001, "millimetres", "metres"),
    Mistake(0.01, "centimetres", "metres"),
    Mistake(0.0254, "inches", "metres"),
    Mistake(0.1, "decimetres", "metres"),
    Mistake(0.3048, "feet", "metres"),
    Mistake(10.0, "centimetres", "millimetres"),
    Mistake(25.4, "inches", "millimetres"),
    Mistake(100.0, "decimetres", "millimetres"),
    Mistake(304.8, "feet", "millimetres"),
    Mistake(1000.0, "metres", "millimetres"),
)


def wrong_unit(examined: Examined) -> list[Finding]:
    """A body that is smaller or larger than any."""
    tall_m = stature_m(examined.body_m, examined.main.skeleton)
    margin = _ROUGHLY if examined.side_by_side else 1.0
    if np.isnan(tall_m):
        tall_m, margin = rough_stature_m(examined.body_m, examined.main.skeleton), _ROUGHLY
    if np.isnan(tall_m) and len(examined.body_m) < LEAST_FRAMES:
        raise NotJudgedError(examined.frames_in_words())
    if np.isnan(tall_m):
        raise NotJudgedError("too few limbs are seen to tell how large the person is")
    if _SMALLEST_M / margin < tall_m < _TALLEST_M * margin:
        return [] if _GROWN_UP_M[0] < tall_m < _GROWN_UP_M[1] or margin > 1 else [_unusual(tall_m)]
    factor = _USUAL_M / tall_m
    near = _LIKE + np.log(margin)
    likely = [mistake for mistake in _MISTAKES if abs(np.log(factor / mistake.factor)) < near]
    metres_per_unit, read_as = _as_read(factor)
    if likely:
        metres_per_unit = likely[0].factor / (1000 if likely[0].read_as == "millimetres" else 1)
    guesses = [f"{each.true} read as {each.read_as}" for each in likely]
    if _SQUARE_M[0] < metres_per_unit < _SQUARE_M[1]:
        guesses.append(f"squares of a board of about {1000 * factor * (0.001 if factor > 1 else 1):.0f} mm")
    cause = (
        f"they are probably {' or '.join(guesses)}" if guesses else f"they are not the {read_as} that they were read as"
    )
    return [
        Finding(
            Code.UNIT,
            Severity.WRONG,
            f"The person is {_tall(tall_m)} tall, so lengths of the calibration have to be multiplied by about "
            f"{factor:.3g}: {cause}",
            f"Give the true unit: {_option(likely, metres_per_unit)}. One length that is measured in the room tells it "
            "better than the stature of people.",
            1.0,
            numbers={
                "stature_m": tall_m,
                "factor": likely[0].factor if likely else factor,
                "factor_sigma": 0.0 if likely else _STATURE_SIGMA * factor,
            },
        )
    ]


def _unusual(tall_m: float) -> Finding:
    """Of a stature that some people have."""
    who = "a child" if tall_m < _USUAL_M else "so tall"
    return Finding(
        Code.UNIT,
        Severity.NOTE
        if tall_m < _USUAL_M
        else Severity.DOUBTFUL,  # there are many children, and hardly anybody so tall
        f"By the lengths of the limbs the person is {tall_m:.2f} m tall: {who}, or all lengths of the calibration are "
        f"{tall_m / _USUAL_M:.1f} of the true ones",
        "Measure one length in the room, or the person: nothing else tells a scale that is a little off.",
        0.3,
        numbers={"stature_m": tall_m},
    )


def _as_read(factor: float) -> tuple[float, str]:
    """Metres in a unit, and as what it was read: nothing is measured in units longer than a few metres."""
    return (factor / 1000, "millimetres") if factor > 3 else (factor, "metres")


def _option(likely: list[Mistake], metres_per_unit: float) -> str:
    names = [_SHORT[each.true] for each in likely if each.true in _SHORT]
    number = f"--unit {metres_per_unit:.2g} (metres)"
    return f"--unit {names[0]}, or {number}" if names else number


def _tall(length_m: float) -> str:
    if length_m < 0.01:
        return f"{1000 * length_m:.2g} mm"
    if length_m < 1:
        return f"{100 * length_m:.2g} cm"
    return f"{length_m:.3g} m" if length_m < 1000 else f"{length_m:,.0f} m"


def wrong_up(examined: Examined) -> list[Finding]:
    """A world in which another axis than z is up, or another than the one that was given."""
    if examined.result is not None and examined.result.given_up is not None:
        return []  # its world was turned as was given; see wrong_given_up
    body_m = examined.body_m
    status = np.where(np.isfinite(body_m).all(axis=-1), Status.OBSERVED, Status.UNOBSERVABLE).astype(np.int8)
    body = Trajectory(examined.main.skeleton, np.arange(len(body_m), dtype=float), body_m, status)
    if examined.world_up != "auto":
        return _questioned(examined.world_up, [body], examined.rig)
    found = find_up([body], examined.rig)
    if not found.remark:
        return []
    remedy = (
        "TRC, C3D, BVH, .mot, angles and reports have it up; positions in parquet, npz and Python stay in the "
        "calibration's world. If it is another, give --world-up."
    )
    severity = Severity.DOUBTFUL if found.is_doubtful else Severity.NOTE
    return [Finding(Code.WORLD_UP, severity, found.remark, remedy, 0.3)]


def wrong_given_up(recording: FinishedRecording) -> list[Finding]:
    """A result that was turned by an axis that somebody gave, where bodies and cameras say another."""
    if recording.given_up is None:
        return []
    world_R_up = z_up_R_world(recording.given_up).T
    people = [each.turned(world_R_up) for each in recording.people.values()]
    return _questioned(recording.given_up, people, None if recording.rig is None else recording.rig.turned(world_R_up))


def _questioned(given: WorldUp, people: Iterable[Trajectory], rig: CameraRig | None) -> list[Finding]:
    found = question_up(given, people, rig)
    if found is None:
        return []
    severity, weight = (Severity.DOUBTFUL, 0.4) if found.is_tilt else (Severity.WRONG, 0.8)
    numbers = {"angle_deg": found.angle_deg}
    return [Finding(Code.WORLD_UP, severity, found.reason, found.remedy, weight, numbers=numbers)]
