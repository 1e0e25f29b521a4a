"""Cameras whose clock or pose is not what the rig says: all the time, from a moment on, or more and more."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fgpose.calibration.camera_faults import CameraFault, camera_faults
from fgpose.calibration.changes.change import Change, Kind
from fgpose.calibration.changes.find_changes import LEAST_S, Changes, find_changes
from fgpose.calibration.large_moves import BUMP_DEG, BUMP_M
from fgpose.diagnosis.changes.in_words import CLOCKS, POSES, earliest_and_latest, moment, use
from fgpose.diagnosis.changes.late_cameras import late_camera, late_throughout, lost_images, other_rate
from fgpose.diagnosis.changes.other_lenses import or_the_other, other_lenses, unsteady_lenses
from fgpose.diagnosis.changes.unsteady_cameras import unsteady_cameras
from fgpose.diagnosis.examined import Examined, NotJudgedError
from fgpose.diagnosis.hypotheses.one_camera import Why
from fgpose.diagnosis.seen.presence import seen_elsewhere
from fgpose.finding import Code, Finding, Severity

# Nothing can be told of when such a camera saw what, or where it was then.
_NOT_OF_THIS_TIME = (Why.UNKNOWN, Why.DISTORTED, Why.RATE)
# Of bumps that are one, to the second to which they are found; and as many as a recording with a careless operator has.
_ONE_MOMENT_S, _OFTEN = 2.0, 2
_TWICE = 2.0  # a second or two tell turns and moves apart no better
_LENSES_SHOW_S = 18.0
_NEAR_SWITCH_S = 0.5  # a view that goes over is found to have moved so near to that


def moved_and_late_cameras(examined: Examined) -> list[Finding]:
    """By the angles by which the rays of the cameras miss each other, second by second of the whole recording."""
    if examined.rig.n_cameras < 2:
        raise NotJudgedError("there is one camera")
    if examined.geometry.explanation is not None:
        raise NotJudgedError("the calibration does not fit the keypoints")
    followed = [name for name in examined.rig.names if name not in examined.unfollowed]
    if 2 <= len(followed) < examined.rig.n_cameras:
        # What fits somebody in a few images of the others does so by chance.
        return moved_and_late_cameras(examined.with_cameras(followed))
    elsewhere = {c for c, odd in examined.geometry.odd if odd.why in _NOT_OF_THIS_TIME}
    kept, whole = [c for c in range(examined.rig.n_cameras) if c not in elsewhere], examined
    if elsewhere:
        examined = examined.with_cameras([examined.rig.names[c] for c in kept])
    if examined.longest_s < LEAST_S:
        return _with_elsewhere(examined, faults_of_short(examined))
    found = find_changes(list(examined.people.values()), examined.rig, examined.steps.part)
    if not found.compared:
        raise NotJudgedError("no two cameras see the same person for some seconds")
    if not examined.geometry.usable and not found.agree:
        found = replace(found, lenses=(), breathing=())
    elif examined.geometry.usable and examined.side_by_side:
        found = replace(
            found, lenses=(), breathing=(), changes=tuple(each for each in found.changes if each.is_of_clock)
        )
    changes = tuple(each for each in found.changes if not _is_of_switch(each, examined))
    findings = findings_of(replace(found, changes=changes), examined.rig.names)
    # A camera that agrees with none may be one that shakes; one of another rate looks alike.
    may_shake = elsewhere and all(odd.why is not Why.RATE for _, odd in whole.geometry.odd)
    unsteady = unsteady_cameras(whole) if may_shake else unsteady_cameras(examined, found.changes)
    return _with_elsewhere(examined, [*unsteady, *findings])


def lenses_that_show(examined: Examined) -> list[Finding]:
    """They are found by moved_and_late_cameras, in what is long enough for it: distortion that was left out (k1 of
    -0.25) shows in 20 s of somebody who walks, and in 15 s it does not."""
    if examined.longest_s < _LENSES_SHOW_S:
        raise NotJudgedError(f"it lasts less than {_LENSES_SHOW_S:.0f} s")
    examined.refuse_side_by_side()
    return []


def _with_elsewhere(examined: Examined, findings: list[Finding]) -> list[Finding]:
    explained = examined.rig.names if any(not each.camera for each in findings) else [each.camera for each in findings]
    return [*findings, *seen_elsewhere(examined, explained)]


def _is_of_switch(change: Change, examined: Examined) -> bool:
    """Whether a camera seems to have been moved when another view went over to somebody else or came back: views that
    follow somebody else make others look moved. What was moved does not show the person where the rig says in the end.
    """
    if change.kind is not Kind.BUMP:
        return False
    seen, camera = examined.main, change.camera
    then = np.abs(seen.frame_time_s - _moment_s(change)) <= _NEAR_SWITCH_S
    shows = np.flatnonzero(seen.seen[:, camera].any(axis=1))
    others = np.delete(examined.gone_over, camera, axis=1)
    return bool(others[then].any() and not examined.gone_over[shows[-1:], camera].any())


def _moment_s(bump: Change) -> float:
    """When the camera was moved, the first time."""
    return bump.at_s if np.isfinite(bump.at_s) else bump.until_s


def _is_for_a_while(bump: Change) -> bool:
    return bool(np.isfinite([bump.at_s, bump.until_s]).all())


def findings_of(found: Changes, names: Sequence[str]) -> list[Finding]:
    """What was found, in words."""
    of_kind = {kind: [each for each in found.changes if each.kind is kind] for kind in Kind}
    also_clock = any(each.is_of_clock for each in found.changes)
    also_pose = any(not each.is_of_clock for each in found.changes)
    jumped = {each.camera for kind in (Kind.JUMP, Kind.RATE) for each in of_kind[kind]}
    late = [each for each in of_kind[Kind.OFFSET] if each.camera not in jumped]
    together = also_clock and also_pose
    return [
        *other_lenses(found.lenses, names),
        *unsteady_lenses(found.breathing, names),
        *(late_throughout(each, found, names, together) for each in late),
        *lost_images(found, names, together),
        *(other_rate(each, found, names, together) for each in of_kind[Kind.RATE]),
        *_moved_cameras(of_kind[Kind.MOVED], names, together),
        *_bumped_cameras(of_kind[Kind.BUMP], names, together),
    ]


def _moved_cameras(changes: Sequence[Change], names: Sequence[str], together: bool) -> list[Finding]:
    """One by one, unless so many were moved that nothing is left that tells where the world is."""
    cameras = sorted({each.camera for each in changes})
    if len(cameras) < 2 or len(names) - len(cameras) > 1:
        return [_moved_throughout(each, names, together) for each in changes]
    most_deg = max(each.rotation_deg for each in changes)
    return [
        Finding(
            Code.MOVED_CAMERA,
            Severity.WRONG,
            f"{len(cameras)} of {len(names)} cameras ({', '.join(names[c] for c in cameras)}) are not where the "
            f"calibration says, by up to {most_deg:.1f} degrees",
            f"Calibrate again. {POSES} makes cameras agree, but nothing then tells where the world is.",
            0.8,
            numbers={"rotation_deg": most_deg, "cameras": float(len(cameras))},
        )
    ]


def _bumped_cameras(changes: Sequence[Change], names: Sequence[str], together: bool) -> list[Finding]:
    """One by one, unless several were moved at one moment, or one again and again. What is right from a moment on, and
    until another one, is so at neither: it moves slowly."""
    cameras = sorted({each.camera for each in changes})
    at_s = sorted(map(_moment_s, changes))
    who = names[cameras[0]] if len(cameras) == 1 else f"{len(cameras)} cameras ({', '.join(names[c] for c in cameras)})"
    slowly = len({bool(np.isfinite(each.until_s)) for each in changes if not _is_for_a_while(each)}) == 2
    again = len(changes) > _OFTEN or slowly
    if len(cameras) > 1 and at_s[-1] - at_s[0] < _ONE_MOMENT_S:
        reason = f"{who} were moved at {np.mean(at_s):.1f} s, while they filmed"
        remedy = f"Cut the recording at {np.mean(at_s):.1f} s, and calibrate the other part again."
    elif again and (len(cameras) == 1 or len(names) == 2):
        reason = f"{who} did not stand still: moved at {', '.join(f'{s:.1f}' for s in at_s)} s, or all the time"
        remedy = "Fix the tripods, and record again: nothing tells where a camera is that moves all the time."
    else:
        return [_bumped(each, names, together) for each in changes]
    of_one = names[cameras[0]] if len(cameras) == 1 else ""
    numbers = {"at_s": float(np.mean(at_s)), "cameras": float(len(cameras))}
    return [
        Finding(Code.BUMPED_CAMERA, Severity.WRONG, reason, remedy, 0.8, camera=of_one, from_s=at_s[0], numbers=numbers)
    ]


def _moved(name: str, or_another: str, by: str, remedy: str, numbers: dict[str, float]) -> Finding:
    return Finding(
        Code.MOVED_CAMERA,
        Severity.DOUBTFUL,
        f"{name}{or_another} seems to have been moved since it was calibrated, by about {by}",
        remedy,
        0.6,
        camera=name,
        numbers=numbers,
    )


def _moved_throughout(change: Change, names: Sequence[str], together: bool) -> Finding:
    name = names[change.camera]
    remedy = _mended(change, together, f"{name} is not where the calibration says: calibrate again.")
    return _moved(name, or_the_other(change.camera, names), _by(change), remedy, _numbers(change))


def _bumped(change: Change, names: Sequence[str], together: bool) -> Finding:
    name, at_s = names[change.camera], _moment_s(change)
    if _is_for_a_while(change):
        right = f", and put back at {change.until_s:.1f} s; before and after it was where the calibration says"
        by_hand = f"Cut the recording at {at_s:.1f} and {change.until_s:.1f} s, and calibrate the part between again."
        poses = " It gives the camera another pose in between."
    else:
        until = np.isfinite(change.until_s)
        right = "; the calibration is right from then on" if until else "; until then it was where the calibration says"
        part = "before" if until else "after"
        by_hand = f"Cut the recording at {at_s:.1f} s, and calibrate the part {part} it again."
        poses = " It gives the camera one pose before and one after."
    return Finding(
        Code.BUMPED_CAMERA,
        Severity.WRONG,
        f"{name}{or_the_other(change.camera, names)} was moved {moment(change, at_s)}, while it filmed, by "
        f"about {_by(change)}{right}",
        _mended(change, together, by_hand, poses),
        0.8,
        camera=name,
        from_s=change.at_s if np.isfinite(change.at_s) else None,
        to_s=change.until_s if np.isfinite(change.until_s) else None,
        numbers=_numbers(change) | {"at_s": at_s, **earliest_and_latest(change)},
    )


def _by(change: Change) -> str:
    cm, sigma_cm = 100 * float(np.linalg.norm(change.translation_m)), 100 * change.translation_sigma_m
    by = f"{change.rotation_deg:.1f} +/- {np.rad2deg(change.sigma):.1f} degrees"
    return f"{by} and {cm:.0f} +/- {sigma_cm:.0f} cm"


def _mended(change: Change, together: bool, by_hand: str, also: str = "") -> str:
    if change.rotation_deg > BUMP_DEG or np.linalg.norm(change.translation_m) > BUMP_M:
        return f"{by_hand} It is further away than a bump can be refined."
    return f"{use(POSES, CLOCKS, together=together)}{also}"


def _numbers(change: Change) -> dict[str, float]:
    return {
        "rotation_deg": change.rotation_deg,
        "translation_m": float(np.linalg.norm(change.translation_m)),
        "sigma_deg": float(np.rad2deg(change.sigma)),
        "sigma_m": change.translation_sigma_m,
    }


def faults_of_short(examined: Examined) -> list[Finding]:
    """By a quick self-calibration, which takes clocks and poses for constant."""
    if examined.rig.n_cameras < 3:
        raise NotJudgedError("fewer than three cameras, and too short for two")
    if examined.main.n_frames < 2:
        raise NotJudgedError(examined.frames_in_words())
    recording = examined.association if examined.association is not None else examined.main
    faults = camera_faults(recording, examined.rig)
    if not faults:
        raise NotJudgedError("no two cameras agree on any joint")
    late, moved = [fault for fault in faults if fault.late], [fault for fault in faults if fault.moved]
    if not late and not moved:
        raise NotJudgedError(f"it lasts less than {LEAST_S:.0f} s")
    several = len(moved) > 1
    clocks = use(CLOCKS, POSES, together=bool(moved))
    return [
        *(late_camera(each.name, each.offset_frames, each.offset_s, each.offset_sigma_s, clocks) for each in late),
        *(_moved_of_short(fault, bool(late), several) for fault in moved),
    ]


def _moved_of_short(fault: CameraFault, also_late: bool, several: bool) -> Finding:
    if fault.rotation_deg > _TWICE * BUMP_DEG or fault.translation_m > _TWICE * BUMP_M:
        return _elsewhere(fault)
    lenses = "; or the focal lengths are not those of the calibration, which a short recording does not tell"
    by = f"{fault.rotation_deg:.1f} degrees and {100 * fault.translation_m:.0f} cm{lenses if several else ''}"
    remedy = use(POSES, CLOCKS, together=also_late)
    numbers = {"rotation_deg": fault.rotation_deg, "translation_m": fault.translation_m}
    return _moved(fault.name, "", by, remedy, numbers)


def _elsewhere(fault: CameraFault) -> Finding:
    return Finding(
        Code.WRONG_CAMERA,
        Severity.DOUBTFUL,
        f"{fault.name} contradicts the others: it would have to be turned by {fault.rotation_deg:.1f} degrees and "
        f"moved by {100 * fault.translation_m:.0f} cm to agree with them, further than a bump moves a camera",
        "Was it put elsewhere since it was calibrated, or did it lose frames? Leave it out (--cameras), or calibrate "
        "again.",
        0.6,
        camera=fault.name,
        numbers={"rotation_deg": fault.rotation_deg, "translation_m": fault.translation_m},
    )
