"""What disagreeing cameras are told to be, in words."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from fgpose.calibration.large_moves import BUMP_DEG, BUMP_M
from fgpose.diagnosis.body.sides import exchanged_limbs, mirrored
from fgpose.diagnosis.body.skeletons import better_skeleton
from fgpose.diagnosis.examined import Examined, NotJudgedError
from fgpose.diagnosis.hypotheses.consistency import NEAR_M, consistency
from fgpose.diagnosis.hypotheses.exchanged import side_hypotheses
from fgpose.diagnosis.hypotheses.geometry import Geometry
from fgpose.diagnosis.hypotheses.hypothesis import Causes, Hypothesis, in_words, mended
from fgpose.diagnosis.hypotheses.images import mirrored_hypotheses
from fgpose.diagnosis.hypotheses.one_camera import OddCamera, Why
from fgpose.diagnosis.hypotheses.search import EXPLAINED, Explanation
from fgpose.diagnosis.hypotheses.since_a_moment import SinceAMoment, since_a_moment
from fgpose.diagnosis.hypotheses.state import SearchState
from fgpose.diagnosis.swapped_sides import exchanged_in_images
from fgpose.finding import Code, Finding, Severity
from fgpose.sampling import spread_evenly

_USUAL = "2 to 6 cm are usual"
_FEWEST_EQUAL, _MOSTLY_EQUAL = 20, 0.9
_UNSURE = 0.6  # of the confidence of the other cameras: below, a camera hallucinates rather than sees somebody else
_HANDED_FRAMES = 120
_FAR_M = 100.0  # rays that hardly converge: a number would say nothing
_AFTER_A_MOMENT = {
    Code.EXCHANGED_CAMERAS: "Were files put together, or cameras plugged in again? Exchange the keypoints back.",
    Code.MIRRORED_IMAGE: "Was a program started again, with mirroring on? Mirror the keypoints back.",
}


def disagreements(examined: Examined) -> list[Finding]:
    """Cameras that do not agree where the body is, and the cause, if what it does not rest on agrees with it."""
    if examined.rig.n_cameras < 2:
        raise NotJudgedError("one camera")
    copies = list(_copies(examined))
    if copies:
        return copies
    geometry = examined.geometry
    if not geometry.state.consistency.judged.any():
        return [_nothing_in_common(examined)]
    changed = since_a_moment(geometry.state) if geometry.explanation is None else None
    if changed is not None:
        return [_changed(changed, examined.rig.names)]
    if exchanged_limbs(examined):
        return []  # told of the sides
    if geometry.explanation is not None:
        return list(_explained(on_the_right_sides(examined, geometry.explanation), examined.rig.names))
    if geometry.odd:
        return [_of_odd(examined, geometry, camera, why) for camera, why in geometry.odd]
    if not geometry.wrong:
        return [_hardly(geometry)] if geometry.hardly_agrees else []
    if geometry.usable and better_skeleton(examined.body_m, examined.main.skeleton) is not None:
        return []  # it is the names of the joints
    return [_no_agreement(geometry)]


def _copies(examined: Examined) -> Iterator[Finding]:
    """Cameras with the keypoints of another one."""
    points_px, names = examined.main.points2d_px, examined.rig.names
    for a, b in combinations(range(len(names)), 2):
        both = examined.main.seen[:, a] & examined.main.seen[:, b]
        equal = both & (points_px[:, a] == points_px[:, b]).all(axis=-1)
        if both.sum() > _FEWEST_EQUAL and equal.sum() > _MOSTLY_EQUAL * both.sum():
            yield Finding(
                Code.EXCHANGED_CAMERAS,
                Severity.WRONG,
                f"{names[a]} and {names[b]} have the same keypoints, to the last digit: two cameras never see the same",
                "Was a folder copied, or given twice? Give each camera its own keypoints.",
                1.0,
                camera=names[b],
            )


def _nothing_in_common(examined: Examined) -> Finding:
    n_seen = int(examined.seen.any(axis=(0, 2)).sum())
    if not n_seen:
        return Finding(
            Code.NO_AGREEMENT,
            Severity.WRONG,
            "No camera has a detection: all keypoints are missing, or have confidence 0, which says the same",
            "Give the confidences of the detector, or 1 for what was detected.",
            1.0,
        )
    return Finding(
        Code.NO_AGREEMENT,
        Severity.WRONG,
        f"No joint is seen by enough cameras at once to tell where it is: {n_seen} of {examined.rig.n_cameras} cameras "
        "see anybody at all, in the same images never",
        "Is it the same person, at the same time? Look at the keypoints of each camera.",
        1.0,
    )


def _changed(found: SinceAMoment, names: tuple[str, ...]) -> Finding:
    cause, when = found.cause, f"until {found.at_s:.1f} s" if found.until else f"from {found.at_s:.1f} s on"
    before_m, after_m = _worst_m(found.before.medians_m), _worst_m(found.after.medians_m)
    return Finding(
        cause.code,
        Severity.WRONG,
        f"{cause.reason.replace('{cameras}', cause.named(names))}, {when}. As it is, cameras miss the body by "
        f"{_length(before_m)} then; with this put right by {_length(after_m)}",
        f"{_AFTER_A_MOMENT[cause.code]} Or cut the recording there.",
        1.0,
        camera=names[cause.cameras[0]] if len(cause.cameras) == 1 else "",
        from_s=None if found.until else found.at_s,
        to_s=found.at_s if found.until else None,
        numbers={"at_s": found.at_s, "before_m": before_m, "after_m": after_m},
    )


def _explained(found: Explanation, names: tuple[str, ...]) -> Iterator[Finding]:
    groups: dict[tuple[Code, str], list[Hypothesis]] = {}
    for cause in found.causes:
        groups.setdefault((cause.code, cause.reason), []).append(cause)
    for (code, reason), causes in groups.items():
        cameras = sorted({c for cause in causes for c in cause.cameras})
        who = in_words(cameras, names)
        if found.rival is not None and _is_of_another(found, code) and len(cameras) == 1:
            who = f"{who} or of {found.rival.named(names)} (which of them, the recording does not tell)"
        yield Finding(
            code,
            Severity.WRONG,
            f"{reason.replace('{cameras}', who)}. {_numbers(found, len(groups))}{_but_for(found, names)}"
            f"{_rival(found, code, names)}",
            causes[0].remedy,
            1.0,
            camera=names[cameras[0]] if len(cameras) == 1 and found.rival is None else "",
            numbers={**causes[0].numbers, "before_m": _worst_m(found.before.medians_m), "after_m": _after_m(found)},
        )


def _numbers(found: Explanation, n_causes: int) -> str:
    """What it rests on."""
    these = "this" if n_causes == 1 else "this and the other causes"
    before_m, after_m = _worst_m(found.before.medians_m), _after_m(found)
    apart = f"by {_length(before_m)}" if np.isfinite(before_m) else "wholly"
    return (
        f"As it is, cameras miss the body {apart}; with {these} put right by {_length(after_m)}, in the half of the "
        "recording that was not used to find it"
    )


def _but_for(found: Explanation, names: tuple[str, ...]) -> str:
    """Who disagrees even so."""
    if not found.odd:
        return ""
    who = in_words(found.odd, names)
    return f"; {who} disagrees even so, and what is wrong of it can be told when this is put right"


def _rival(found: Explanation, code: Code, names: tuple[str, ...]) -> str:
    """What explains it as well, and what would have to be done."""
    rival = found.rival
    if rival is None or _is_of_another(found, code):
        return ""
    reason, remedy = rival.reason.replace("{cameras}", rival.named(names)), rival.remedy.split("? ")[-1]
    return f". It may as well be that {_lower(reason)}; then {_lower(remedy).rstrip('.')}"


def _is_of_another(found: Explanation, code: Code) -> bool:
    """Whether the same of another camera explains it as well."""
    return found.rival is not None and found.rival.code is code and found.rival.cameras != found.causes[0].cameras


def _lower(sentence: str) -> str:
    return sentence[:1].lower() + sentence[1:]


def _worst_m(medians_m: np.ndarray) -> float:
    """Of the cameras."""
    known = medians_m[~np.isnan(medians_m)]
    return float(known.max()) if known.size else np.inf


def _after_m(found: Explanation) -> float:
    return _worst_m(found.after.medians_m)


def _length(length_m: float) -> str:
    if length_m > _FAR_M:
        return f"more than {_FAR_M:.0f} m"
    return f"{length_m:.1f} m" if length_m >= 1 else f"{max(round(100 * length_m), 1):.0f} cm"


def _of_odd(examined: Examined, geometry: Geometry, camera: int, odd: OddCamera) -> Finding:
    name = examined.rig.names[camera]
    others = in_words(geometry.agreeing, examined.rig.names)
    missed_m = float(geometry.state.medians_m[camera])
    by = f"by {_length(missed_m)} ({_USUAL})" if np.isfinite(missed_m) else "wholly"
    numbers = {"missed_m": missed_m} if np.isfinite(missed_m) else {}
    misses = f"{others} agree where the body is, and {name} misses it {by}"
    if odd.why is Why.POSE:
        return _elsewhere(name, misses, odd, numbers)
    if odd.why is Why.RATE:
        return _at_another_rate(name, misses, odd, numbers)
    if odd.why is not Why.UNKNOWN:
        reason = f"{misses}: it {odd.why.value}"
        remedy = "Look at its images: are they of the same moments as those of the others, and was it touched?"
        return Finding(Code.DISAGREEING_CAMERA, Severity.WRONG, reason, remedy, 0.8, camera=name, numbers=numbers)
    if (exchanges := exchanged_in_images(examined, name)) is not None:
        return exchanges
    confidence, usual = _confidences(examined, camera)
    if confidence < _UNSURE * usual:
        reason = f"{misses}; its network says to be unsure: confidence {confidence:.2f}, of the others {usual:.2f}"
        remedy = "Look at its images: is anybody in them? Leave the camera out with --cameras."
        return Finding(Code.HALLUCINATING_CAMERA, Severity.WRONG, reason, remedy, 0.9, camera=name, numbers=numbers)
    reason = (
        f"{misses}. No place of the camera, no clock and no size of its images makes its keypoints those of this body"
    )
    remedy = "Are they of another person or of another recording? Give the right ones, or leave it out with --cameras."
    return Finding(Code.OTHER_PERSON, Severity.WRONG, reason, remedy, 0.9, camera=name, numbers=numbers)


def _elsewhere(name: str, misses: str, odd: OddCamera, numbers: dict[str, float]) -> Finding:
    """A camera that stands elsewhere: by as much as a bump does, or by more."""
    numbers = {**numbers, "rotation_deg": odd.rotation_deg, "translation_m": odd.translation_m}
    where = f"turned by {odd.rotation_deg:.1f} degrees and moved by {_length(odd.translation_m)}"
    if odd.rotation_deg < BUMP_DEG and odd.translation_m < BUMP_M:
        reason = f"{misses}. It agrees if it is {where}: it was bumped since it was calibrated"
        remedy = "Use --refine-calibration."
        return Finding(Code.MOVED_CAMERA, Severity.WRONG, reason, remedy, 0.8, camera=name, numbers=numbers)
    reason = (
        f"The calibration of {name} is not that of this recording: {misses}. It agrees if it is {where}, which is "
        "more than a bump"
    )
    remedy = "Give the right calibration or calibrate it again, or leave it out with --cameras."
    return Finding(Code.WRONG_CAMERA, Severity.WRONG, reason, remedy, 0.9, camera=name, numbers=numbers)


def _at_another_rate(name: str, misses: str, odd: OddCamera, numbers: dict[str, float]) -> Finding:
    reason = (
        f"{misses}. Its images show the same motion {odd.rate:.3g} times as fast as their stamps say: it filmed at "
        f"another rate, {1 / odd.rate:.3g} times that of the recording"
    )
    remedy = (
        f"Give the times of its images, or clock_drift {odd.rate - 1:.4g} of this camera in the calibration, or leave "
        "it out with --cameras."
    )
    numbers = {**numbers, "clock_drift": odd.rate - 1}
    return Finding(Code.CLOCK_RATE, Severity.WRONG, reason, remedy, 0.9, camera=name, numbers=numbers)


def _confidences(examined: Examined, camera: int) -> tuple[float, float]:
    """Median of a camera, and of the others."""
    medians = [
        float(np.median(own)) if (own := examined.confidence[:, c][examined.seen[:, c]]).size else 0.0
        for c in range(examined.rig.n_cameras)
    ]
    return medians[camera], float(np.median(np.delete(medians, camera)))


def _no_agreement(geometry: Geometry) -> Finding:
    worst_m = _worst_m(geometry.state.medians_m)
    names = geometry.state.scene.names
    by = f"miss each other's joints by {_length(worst_m)}" if np.isfinite(worst_m) else "have no place in common"
    numbers = {"missed_m": worst_m} if np.isfinite(worst_m) else {}
    if geometry.clocks_differ:
        return Finding(
            Code.DISAGREEING_CAMERA,
            Severity.WRONG,
            f"The cameras {by} ({_USUAL}), but agree if their clocks differ",
            "Find when each began with fgpose synchronise.",
            0.9,
            numbers=numbers,
        )
    unsteady = geometry.state.unsteadiness
    if len(names) == 2 and not worst_m > 0.1:
        by = f"see a body whose limbs change their lengths by {100 * unsteady:.0f} %"
    else:
        by = f"{by} ({_USUAL})"
    alone = ", alone or two of them together" if len(names) > 2 else " alone"
    return Finding(
        Code.NO_AGREEMENT,
        Severity.WRONG,
        f"The cameras do not agree where the body is: {', '.join(names)} {by}. No known cause was found that makes "
        f"them agree{alone}: not the size, turning or mirroring of images, the order of cameras, or a convention of "
        "poses",
        "Is the calibration that of this recording, and are all keypoints of one person? Calibrate anew, or with "
        "fgpose calibrate from the people in it.",
        1.0,
        numbers=numbers,
    )


def _hardly(geometry: Geometry) -> Finding:
    names, missed_m = geometry.state.scene.names, _worst_m(geometry.state.medians_m)
    share = float(geometry.state.consistency.shares.min())
    return Finding(
        Code.NO_AGREEMENT,
        Severity.DOUBTFUL,
        f"{' and '.join(names)} hardly agree: {100 * share:.0f} % of their rays pass each other by less than "
        f"{_length(NEAR_M)}, and half of them by {_length(missed_m)} or more ({_USUAL})",
        "Is most of the body hidden from one of them? If not, keypoints or calibration are of another camera, or of "
        "another recording.",
        0.8,
        numbers={"missed_m": missed_m},
    )


def on_the_right_sides(examined: Examined, found: Explanation) -> Explanation:
    """The explanation, or another one that the cameras cannot tell from it, if the body is mirrored with it.

    Such are left and right exchanged in the other half of the cameras; in images that are mirrored in all of them,
    exchanged or not; and where cameras stand symmetrically, mirrored images and exchanged cameras.
    """
    scene = examined.scene(spread_evenly(examined.main.n_frames, _HANDED_FRAMES))
    everybody = tuple(range(scene.n_cameras))

    def leaves_mirrored(causes: Iterable[Hypothesis]) -> bool:
        return mirrored(consistency(mended(causes, scene)).positions_m, examined.main.skeleton)

    is_mirrored, rival = leaves_mirrored(found.causes), found.rival
    if all(cause.code is Code.EXCHANGED_SIDES for cause in found.causes):
        of_sides = {c for cause in found.causes for c in cause.cameras}
        others = tuple(cause for c in everybody if c not in of_sides for cause in side_hypotheses((c,)))
        return replace(found, causes=others if is_mirrored and others else found.causes, rival=None)
    if rival is not None and leaves_mirrored([rival]):
        same = mirrored_hypotheses(everybody) if rival.code is Code.MIRRORED_IMAGE else ()
        rival = next((other for other in same if not leaves_mirrored([other])), None)
    if not is_mirrored:
        return replace(found, rival=rival)
    alone = [(other,) for other in (*([] if rival is None else [rival]), *mirrored_hypotheses(everybody))]
    for others in (*_with_other_mirroring(found.causes), *alone):
        after = SearchState(found.of_others(mended(others, found.before.scene)))
        if not leaves_mirrored(others) and after.cost < EXPLAINED * found.before.cost:
            return replace(found, causes=others, after=after, rival=None)
    return found


def _with_other_mirroring(causes: Causes) -> Iterator[Causes]:
    """With left and right as they are on the body in mirrored images, or as they are in the mirror."""
    for place, cause in enumerate(causes):
        if cause.code is Code.MIRRORED_IMAGE:
            yield from ((*causes[:place], other, *causes[place + 1 :]) for other in mirrored_hypotheses(cause.cameras))
