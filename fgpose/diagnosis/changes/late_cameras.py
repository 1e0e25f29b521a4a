"""Cameras whose clocks differ from those of the others, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from fgpose.calibration.changes.change import Change, Kind
from fgpose.calibration.changes.comparison import MAX_LAG_S
from fgpose.calibration.changes.find_changes import Changes
from fgpose.diagnosis.body.joint_names import in_a_row
from fgpose.diagnosis.changes.in_words import CLOCKS, POSES, earliest_and_latest, moment, use
from fgpose.diagnosis.changes.other_lenses import or_the_other
from fgpose.finding import Code, Finding, Severity

_AT_THE_END = 0.95  # of the lags that were tried
# A frame rate that is taken for another one. Of drifts only: 25 Hz for 50 is no drift.
_NTSC = (9e-4, 1.1e-3)
# More than clocks differ that were ever set alike, and half of what --estimate-time-offsets finds.
_FAR_APART_S = 0.12
_ONE_BY_ONE = 2  # losses of a camera that are told each by itself
_MOST_TOLD = 8
_APART_S = 2.0  # jumps are located to a second, either way


def late_camera(
    name: str,
    frames: float,
    offset_s: float,
    sigma_s: float,
    remedy: str,
    clocks: str = "the clocks of the others",
    when: str = "",
    also: str = "",
) -> Finding:
    by = f"{abs(frames):.1f} frames ({1000 * abs(offset_s):.0f} +/- {1000 * sigma_s:.0f} ms)"
    if abs(offset_s) > _AT_THE_END * MAX_LAG_S:
        by = f"{MAX_LAG_S:.1f} s or more"
    by_hand = " Were the cameras started by hand? Then fgpose synchronise finds when each began."
    return Finding(
        Code.LATE_CAMERA,
        Severity.DOUBTFUL,
        f"{name} takes its images {by} {'later' if offset_s > 0 else 'earlier'} than their times say, measured by "
        f"{clocks}{when}",
        f"{remedy}{also}{by_hand if abs(offset_s) > _FAR_APART_S else ''}",
        0.5,
        camera=name,
        numbers={"offset_s": offset_s, "sigma_s": sigma_s},
    )


def late_throughout(change: Change, found: Changes, names: Sequence[str], together: bool) -> Finding:
    frames = change.offset_s / found.step_s
    also = " Is one file numbered from 0 and another from 1?" if abs(abs(frames) - 1) < 0.1 else ""
    remedy, when = use(CLOCKS, POSES, together=together), ", all through the recording"
    clocks = _clocks_of_others(found, names)
    late = late_camera(names[change.camera], frames, change.offset_s, change.sigma, remedy, clocks, when, also)
    # Three outvote one that is late; half of all are believed as the others are.
    far_apart = {each.camera for each in found.changes if each.is_of_clock and abs(each.offset_s) > _FAR_APART_S}
    is_believed = change.camera in far_apart and 2 * len(far_apart) >= len(names)
    return replace(late, severity=Severity.WRONG) if is_believed else late


def _clocks_of_others(found: Changes, names: Sequence[str]) -> str:
    """Only differences of clocks are seen: by which clocks others are late is said where that may be doubtful."""
    differ = {each.camera for each in found.changes if each.is_of_clock}
    same = [name for c, name in enumerate(names) if c not in differ]
    if len(differ) == 1 or not same:
        return "the clocks of the others"
    return f"the clock{'s' if len(same) > 1 else ''} of {in_a_row(same)}"


def lost_images(found: Changes, names: Sequence[str], together: bool) -> list[Finding]:
    """One by one, unless there are so many that their moments are told together: of one camera, or of several."""
    jumps = sorted((each for each in found.changes if each.kind is Kind.JUMP), key=lambda each: each.at_s)
    of_camera = {c: [each for each in jumps if each.camera == c] for c in sorted({each.camera for each in jumps})}
    if len(of_camera) > 1 and len(jumps) > _ONE_BY_ONE * len(of_camera):
        return [_lost_by_several(of_camera, found, names, together)]
    findings = []
    for c, own in of_camera.items():
        if len(own) > _ONE_BY_ONE:
            findings.append(_lost_again(names[c], own, found, together))
        else:
            findings += [_lost_at_once(each, found, names, together) for each in own]
    return findings


def _lost_again(name: str, jumps: Sequence[Change], found: Changes, together: bool) -> Finding:
    total = sum(each.offset_s for each in jumps)
    reason = (
        f"{name} lost images {len(jumps)} times, {total / found.step_s:.0f} frames ({1000 * total:.0f} ms) in all, and "
        f"those after them were numbered on without a gap: {_moments(jumps, found)}"
    )
    return _lost(reason, jumps, found, together, name)


def _lost_by_several(
    of_camera: Mapping[int, Sequence[Change]], found: Changes, names: Sequence[str], together: bool
) -> Finding:
    each = "; ".join(f"{names[c]} {_moments(own, found)}" for c, own in of_camera.items())
    jumps = [change for own in of_camera.values() for change in own]
    reason = (
        "Images were lost again and again, and those after them numbered on without a gap. Measured by each other, "
        f"cameras lost {each}. What all lost at once is not seen, and does no harm"
    )
    return _lost(reason, jumps, found, together, "")


def _moments(jumps: Sequence[Change], found: Changes) -> str:
    told = [f"{each.offset_s / found.step_s:.0f} at {each.at_s:.1f} s" for each in jumps]
    return in_a_row(told[:_MOST_TOLD]) if len(told) <= _MOST_TOLD else f"{', '.join(told[:_MOST_TOLD])}, and so on"


def _lost(reason: str, jumps: Sequence[Change], found: Changes, together: bool, camera: str) -> Finding:
    sigma_s = float(np.sqrt(np.mean([each.sigma**2 for each in jumps])))
    use_clocks = f"{use(CLOCKS, POSES, together=together)} It undoes these jumps, each to about {1000 * sigma_s:.0f} ms"
    if found.duration_s < _APART_S * len(jumps):
        left = "so many are hardly told one from another, and some are missed: better give the times of the images."
    else:
        left = "a constant offset or another rate would be wrong. Or give the times of the images."
    numbers = {
        "jumps": float(len(jumps)),
        "frames": sum(each.offset_s for each in jumps) / found.step_s,
        "sigma_s": sigma_s,
        "cameras": float(len({each.camera for each in jumps})),
    }
    since_s = min(each.at_s for each in jumps)
    remedy = f"{use_clocks}; {left}"
    return Finding(
        Code.LOST_FRAMES, Severity.WRONG, reason, remedy, 0.8, camera=camera, from_s=since_s, numbers=numbers
    )


def _lost_at_once(change: Change, found: Changes, names: Sequence[str], together: bool) -> Finding:
    name, frames = names[change.camera], change.offset_s / found.step_s
    number = f"{abs(frames):.0f} frame{'s' if abs(frames) >= 1.5 else ''}"
    sizes = f"({1000 * abs(change.offset_s):.0f} +/- {1000 * change.sigma:.0f} ms)"
    when = moment(change, change.at_s)
    if frames > 0:
        what = f"{name} lost {number} {sizes} {when}, and its images were numbered on without a gap"
        why = "from there on it is ahead of the others"
    else:
        what = f"the clock of {name} jumps back by {number} {sizes} {when}"
        why = "from there on it is behind the others, as if images were written twice"
    return Finding(
        Code.LOST_FRAMES,
        Severity.WRONG,
        f"{what}: {why}",
        f"{use(CLOCKS, POSES, together=together)} It finds the jump; a constant offset would be wrong before "
        "or after it. Or give the times of the images.",
        0.8,
        camera=name,
        from_s=change.at_s,
        numbers={"jump_s": change.offset_s, "sigma_s": change.sigma, "frames": frames, **earliest_and_latest(change)},
    )


def other_rate(change: Change, found: Changes, names: Sequence[str], together: bool) -> Finding:
    name, total_s = names[change.camera], change.rate * found.duration_s
    # Several clocks that drift are each measured by the mean of others that drift too.
    alone = len({each.camera for each in found.changes if each.is_of_clock}) == 1
    known = f"+/- {1000 * change.sigma:.0f} ms" if alone else "ms, if no other clock drifts"
    ntsc = _NTSC[0] < abs(change.rate) < _NTSC[1]
    likely = ": 29.97 Hz, or 59.94, taken for 30 or 60" if ntsc else ""
    return Finding(
        Code.CLOCK_RATE,
        Severity.WRONG,
        f"the images of {name}{or_the_other(change.camera, names)} follow each other {100 * abs(change.rate):.2f} % "
        f"more {'slowly' if change.rate > 0 else 'quickly'} than their times say, measured by the others{likely}; that "
        f"adds up to {abs(total_s) / found.step_s:.1f} frames ({1000 * abs(total_s):.0f} {known})",
        f"{use(CLOCKS, POSES, together=together)} It finds the rate. Or give the true rate, or the times of the "
        "images.",
        0.8,
        camera=name,
        numbers={"rate": change.rate, "total_s": total_s, "sigma_s": change.sigma},
    )
