"""Which findings are consequences of others, and which are left to say."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from fgpose.finding import Code, Finding, Severity, severest_first

# What a cause explains: its consequences need no finding of their own. Of one camera it explains those of that camera
# and, as it takes part in every comparison, those of the others that rest on it.
_GEOMETRY = (
    Code.IMAGE_SIZE,
    Code.NORMALISED,
    Code.TURNED_IMAGE,
    Code.MIRRORED_IMAGE,
    Code.EXCHANGED_CAMERAS,
    Code.CAMERA_AXES,
    Code.NO_AGREEMENT,
    Code.WRONG_CAMERA,
    Code.WRONG_LENS,
    Code.OTHER_PERSON,
    Code.FROZEN_CAMERA,
    Code.FRAME_ORDER,
)
_OF_GEOMETRY = frozenset(
    {
        Code.MOVED_CAMERA,
        Code.BUMPED_CAMERA,
        Code.UNSTEADY_CAMERA,
        Code.UNSTEADY_LENS,
        Code.WRONG_CAMERA,
        Code.NO_AGREEMENT,
        Code.WRONG_LENS,
        Code.LATE_CAMERA,
        Code.LOST_FRAMES,
        Code.CLOCK_RATE,
        Code.FRAME_RATE,
        Code.UNIT,
        Code.PER_VIEW_JOINTS,
        Code.WORLD_UP,
        Code.WRONG_SKELETON,
        Code.EXCHANGED_SIDES,
        Code.LARGE_ERRORS,
        Code.DISAGREEING_CAMERA,
        Code.HALLUCINATING_CAMERA,
        Code.MISPLACED_JOINT,
        Code.CONTRADICTED,
        Code.GAP,
        Code.OUTSIDE,
        Code.IMPOSSIBLE_SPEED,
        Code.IMPOSSIBLE_TURN,
        Code.NOT_CONVERGED,
        Code.UNDETERMINED,
        Code.BLIND_CAMERA,
        Code.IDENTITY_SWITCH,
    }
)
_OF_ONE_CAMERA = frozenset(
    {
        Code.DISAGREEING_CAMERA,
        Code.HALLUCINATING_CAMERA,
        Code.MISPLACED_JOINT,
        Code.CONTRADICTED,
        Code.LARGE_ERRORS,
        Code.GAP,
        Code.IMPOSSIBLE_TURN,
        Code.IDENTITY_SWITCH,
    }
)
# Rays to one place of an image.
_OF_PLACEHOLDERS = frozenset(
    {
        *_OF_ONE_CAMERA,
        Code.OUTSIDE,
        Code.IMPOSSIBLE_SPEED,
        Code.FRAME_RATE,
        Code.EXCHANGED_SIDES,
        Code.NOT_CONVERGED,
        Code.UNDETERMINED,
    }
)
_OF_CLOCKS = frozenset({*_OF_ONE_CAMERA, Code.LATE_CAMERA})
# All that changes in time, and what is not where it was.
_OF_SHAKING = _OF_CLOCKS | {
    Code.LOST_FRAMES,
    Code.CLOCK_RATE,
    Code.BUMPED_CAMERA,
    Code.MOVED_CAMERA,
    Code.EXCHANGED_SIDES,
    Code.IMPOSSIBLE_SPEED,
    Code.NOT_CONVERGED,
    Code.UNDETERMINED,
}
EXPLAINS: Mapping[Code, frozenset[Code]] = {
    **{code: _OF_GEOMETRY - {code} for code in _GEOMETRY},
    Code.OTHER_PERSON: _OF_GEOMETRY - {Code.OTHER_PERSON} | {Code.THING_FOR_PERSON},
    Code.WRONG_CAMERA: _OF_GEOMETRY - {Code.WRONG_CAMERA, Code.WRONG_LENS, Code.NO_AGREEMENT},
    Code.WRONG_LENS: _OF_GEOMETRY - {Code.WRONG_LENS},
    Code.NO_AGREEMENT: _OF_GEOMETRY - {Code.NO_AGREEMENT, Code.WRONG_CAMERA, Code.WRONG_LENS},
    Code.WRONG_SKELETON: frozenset(
        {
            Code.EXCHANGED_SIDES,
            Code.MISPLACED_JOINT,
            Code.WORLD_UP,
            Code.UNIT,
            Code.IMPOSSIBLE_TURN,
            Code.GAP,
            Code.UNDETERMINED,
            Code.NEVER_SEEN,
        }
    ),
    Code.EXCHANGED_SIDES: _OF_ONE_CAMERA,
    Code.ZERO_KEYPOINTS: _OF_PLACEHOLDERS,
    Code.PLACEHOLDER_KEYPOINTS: _OF_PLACEHOLDERS,
    Code.UNIT: frozenset(
        {Code.IMPOSSIBLE_SPEED, Code.FRAME_RATE, Code.LARGE_ERRORS, Code.OUTSIDE, Code.MOVED_CAMERA, Code.BUMPED_CAMERA}
    ),
    Code.PER_VIEW_JOINTS: _OF_ONE_CAMERA | {Code.OUTSIDE, Code.IMPOSSIBLE_SPEED, Code.NOT_CONVERGED, Code.UNDETERMINED},
    Code.THING_FOR_PERSON: _OF_ONE_CAMERA,
    Code.MOVED_CAMERA: _OF_ONE_CAMERA,
    Code.BUMPED_CAMERA: _OF_ONE_CAMERA | {Code.MOVED_CAMERA, Code.LATE_CAMERA, Code.CLOCK_RATE},
    Code.UNSTEADY_CAMERA: _OF_SHAKING,
    Code.UNSTEADY_LENS: _OF_SHAKING | {Code.UNSTEADY_CAMERA},
    Code.LATE_CAMERA: _OF_ONE_CAMERA,
    Code.LOST_FRAMES: _OF_CLOCKS | {Code.CLOCK_RATE},
    Code.CLOCK_RATE: _OF_CLOCKS,
    Code.FRAME_RATE: frozenset({Code.LOST_FRAMES, Code.CLOCK_RATE, Code.LATE_CAMERA}),
    Code.NOISY_KEYPOINTS: _OF_ONE_CAMERA
    | {Code.NO_AGREEMENT, Code.OTHER_PERSON, Code.EXCHANGED_SIDES, Code.UNDETERMINED},
    Code.SMOOTHED_KEYPOINTS: _OF_CLOCKS | {Code.LOST_FRAMES, Code.CLOCK_RATE, Code.UNSTEADY_CAMERA},
    Code.INTERPOLATED_KEYPOINTS: _OF_CLOCKS
    | {Code.LOST_FRAMES, Code.CLOCK_RATE, Code.SMOOTHED_KEYPOINTS, Code.UNSTEADY_CAMERA},
    Code.REPEATED_IMAGES: _OF_CLOCKS | {Code.CLOCK_RATE, Code.UNSTEADY_CAMERA},
    Code.SOMEBODY_ELSE: frozenset(
        {
            Code.CONTRADICTED,
            Code.IMPOSSIBLE_SPEED,
            Code.BUMPED_CAMERA,
            Code.MOVED_CAMERA,
            Code.UNSTEADY_CAMERA,
            Code.WRONG_LENS,
        }
    ),
    Code.IDENTITY_SWITCH: frozenset({Code.HALLUCINATING_CAMERA, Code.CONTRADICTED}),
    Code.NOBODY: frozenset({Code.GAP}),
    Code.LOW_CONFIDENCE: frozenset({Code.MISPLACED_JOINT, Code.CONTRADICTED}),
    Code.FEW_CAMERAS: frozenset({Code.IMPOSSIBLE_TURN, Code.IMPOSSIBLE_SPEED}),
}


_MAKES_SIDES_SEEM_EXCHANGED = (
    Code.MOVED_CAMERA,
    Code.BUMPED_CAMERA,
    Code.LATE_CAMERA,
    Code.LOST_FRAMES,
    Code.CLOCK_RATE,
)
# Where it is said of several cameras together, it need not be said of each.
_SAID_OF_ALL = frozenset({Code.EXCHANGED_SIDES})
# With one of the other causes found, the keypoints of the camera are those of the person.
_MAKES_SOMEBODY_ELSE = frozenset(_GEOMETRY) - {
    Code.NO_AGREEMENT,
    Code.WRONG_CAMERA,
    Code.WRONG_LENS,
    Code.OTHER_PERSON,
    Code.FROZEN_CAMERA,
}
# Of one camera these are the same: what disagrees is taken for hallucinated. The first is the one that is said.
_THE_SAME = (Code.DISAGREEING_CAMERA, Code.HALLUCINATING_CAMERA)


def most_important(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Without repetitions and without what others explain, a note only notes; a cause is as severe as what it explains.
    The severest first, of equal ones the weightiest, then what may cause the others."""
    different: dict[tuple[object, ...], Finding] = {}
    for each in findings:
        # Of all cameras together a calibration says several things.
        reason = each.reason if each.code is Code.CALIBRATION else ""
        different.setdefault((each.code, each.camera, each.joint, each.person, each.from_s, reason), each)
    notes = [each for each in different.values() if each.severity is Severity.NOTE]
    grave = [each for each in different.values() if each.severity is not Severity.NOTE]
    causes = [each for each in different.values() if not _is_explained(each, grave, notes)]
    order = list(Severity)
    causes = [each for each in causes if not any(_says_more(other, each, order) for other in causes)]
    as_severe = [_with_severity_of_explained(each, grave) for each in causes]
    return severest_first(as_severe)


def _is_explained(each: Finding, grave: list[Finding], notes: list[Finding]) -> bool:
    """What is worth a note only does not make half of all errors large."""
    if any(_explains(cause, each) for cause in grave):
        return True
    is_note = each.severity is Severity.NOTE and each.code is not Code.LARGE_ERRORS
    return is_note and any(_explains(note, each) for note in notes)


def _explains(cause: Finding, each: Finding) -> bool:
    """A doubt about one camera does not make what is wrong of another. In one that is moved or late a leg is now and
    then where the other one is."""
    if each.code is Code.EXCHANGED_SIDES and cause.code in _MAKES_SIDES_SEEM_EXCHANGED:
        return each.severity is not Severity.WRONG and each.camera == cause.camera
    if each.code not in EXPLAINS.get(cause.code, ()):
        return False
    is_surer = each.severity is Severity.WRONG and cause.severity is not Severity.WRONG
    return not is_surer or each.camera == cause.camera or "" in (each.camera, cause.camera)


def _with_severity_of_explained(cause: Finding, grave: list[Finding]) -> Finding:
    """A cause takes the place of what follows from it, so it is as severe; but for exchanged sides, which are corrected
    as far as they say."""
    if cause.code is Code.EXCHANGED_SIDES:
        return cause
    follows = [each for each in grave if _explains(cause, each)]
    if cause.severity is Severity.DOUBTFUL and any(each.severity is Severity.WRONG for each in follows):
        return replace(cause, severity=Severity.WRONG)
    return cause


def _says_more(other: Finding, each: Finding, order: list[Severity]) -> bool:
    """Whether the one is of several cameras, the other the same of one of them; or both say the same of one camera, or
    the one why it seems to show somebody else."""
    severer, severe = order.index(other.severity), order.index(each.severity)
    if not each.camera:
        return False
    if each.code is Code.OTHER_PERSON and other.code in _MAKES_SOMEBODY_ELSE:
        return other.camera in ("", each.camera)
    if other.code is each.code:
        return each.code in _SAID_OF_ALL and not other.camera and severer <= severe
    if other.camera != each.camera or not {other.code, each.code} <= set(_THE_SAME):
        return False
    return (severer, _THE_SAME.index(other.code)) < (severe, _THE_SAME.index(each.code))
