"""What of a diagnosis is said while the system runs, and in which words: here alone."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from fgpose.finding import Code, Finding, Severity
from fgpose.live.frame import LiveFinding, LiveJudgement

_AS_IT_IS = ""
_CALIBRATE = "Calibrate again (fgpose calibrate --from rig.toml), and start again."
_CLOCK = (
    "Enter this computer as NTP server in the cameras, or give latency_s of the camera in the rig file "
    "(docs/live_cameras.md)."
)
_SKELETON = "Start again with the skeleton that these joints are (--skeleton)."
_OTHER_RIG = "Correct the calibration that the rig file names, and start again."

REMEDIES: Mapping[Code, str | None] = {
    # What the keypoints and the calibration are.
    Code.IMAGE_SIZE: _AS_IT_IS,
    Code.NORMALISED: _AS_IT_IS,
    Code.ZERO_KEYPOINTS: _AS_IT_IS,
    Code.PLACEHOLDER_KEYPOINTS: _AS_IT_IS,
    Code.CLIPPED_KEYPOINTS: _AS_IT_IS,
    Code.TURNED_IMAGE: _AS_IT_IS,
    Code.MIRRORED_IMAGE: "Switch mirroring off, in the camera or its detector.",
    Code.EXCHANGED_CAMERAS: "Give each camera its own source in the rig file, and its own name to each detector.",
    Code.UNIT: f"The lengths of the calibration must be metres. {_OTHER_RIG}",
    Code.CAMERA_AXES: _OTHER_RIG,
    Code.WORLD_UP: None,  # positions are in the world of the calibration, whichever axis of it is up
    Code.WRONG_SKELETON: _SKELETON,
    Code.EXCHANGED_SIDES: _AS_IT_IS,
    Code.OTHER_PERSON: "Are these keypoints of another camera, or is its calibration another camera's?",
    Code.MOVED_CAMERA: _CALIBRATE,
    Code.WRONG_LENS: _AS_IT_IS,
    Code.WRONG_CAMERA: _CALIBRATE,
    Code.NO_AGREEMENT: f"Is the calibration that of these cameras? {_CALIBRATE}",
    Code.CALIBRATION: None,  # told of a calibration from people, when it is made
    Code.PER_VIEW_JOINTS: "points3d_camera_m are metres in the frame of the camera (docs/live_messages.md).",
    # What changes in time.
    Code.LATE_CAMERA: _CLOCK,
    Code.LOST_FRAMES: _CLOCK,
    Code.CLOCK_RATE: _CLOCK,
    Code.BUMPED_CAMERA: f"Fix the camera. {_CALIBRATE}",
    Code.UNSTEADY_CAMERA: "Fix the camera, and switch electronic stabilisation off.",
    Code.UNSTEADY_LENS: "Fix the focus and the zoom of the camera.",
    Code.AMBIGUOUS_START: None,  # of videos that began at different moments
    Code.UNDETERMINED_CLOCK: None,  # of a result; frames have the sigma of each clock
    Code.FROZEN_CAMERA: None,  # the state of the camera says so within a second
    Code.REPEATED_IMAGES: "Repeated images are left out: let the detector send each image once.",
    Code.SMOOTHED_KEYPOINTS: _AS_IT_IS,
    Code.NOISY_KEYPOINTS: "More light, shorter exposures, larger images of the person, or a larger network.",
    Code.INTERPOLATED_KEYPOINTS: _AS_IT_IS,
    Code.FRAME_ORDER: None,  # of files
    Code.MISSING_FRAMES: None,  # of a result
    Code.FRAME_RATE: "Are the times of the images when they were taken, in seconds, and is the calibration in metres?",
    # Who is seen, and how well.
    Code.NOBODY: None,  # a note, and what frames say
    Code.SOMEBODY_ELSE: None,  # everybody has a number of their own
    Code.IDENTITY_SWITCH: None,  # everybody is followed; who may have been exchanged is provisional
    Code.SEVERAL_PEOPLE: None,  # nobody is chosen
    Code.FEW_CAMERAS: None,  # status and covariance of the joints, and observed_share
    Code.BLIND_CAMERA: None,  # a note
    Code.NEVER_SEEN: None,  # a note
    Code.LOW_CONFIDENCE: "It probably guesses what it cannot see: send less sure joints as missing (NaN).",
    Code.EQUAL_CONFIDENCE: None,  # of a result
    Code.HALLUCINATING_CAMERA: "Look at its images: is anybody in them?",
    Code.THING_FOR_PERSON: "Look at its images: does its network take a thing for somebody?",
    Code.MISPLACED_JOINT: None,  # of a result
    Code.READ_WITH_REPAIRS: None,  # of files
    # What came out: of results alone, which a live system has not.
    **dict.fromkeys(
        (
            Code.UNDETERMINED,
            Code.NOT_CONVERGED,
            Code.SOLVER_FAILURE,
            Code.LARGE_ERRORS,
            Code.CONTRADICTED,
            Code.GAP,
            Code.OUTSIDE,
            Code.IMPOSSIBLE_SPEED,
            Code.IMPOSSIBLE_TURN,
            Code.SHORT_LIFE,
            Code.PERHAPS_EXCHANGED,
            Code.PERHAPS_SAME,
            Code.MOTIONLESS,
            Code.REFLECTION,
            Code.OTHER_BONES,
        )
    ),
    Code.DISAGREEING_CAMERA: "Is somebody else in its images, a reflection? Is its clock right, was it moved?",
}
"""What to do about each, in a running system; None: it is not said there."""

# Of a recording worth a note. Live, a filter that knows the past alone says people to be where they were a moment ago,
# and no covariance contains it.
_DOUBTFUL_LIVE = frozenset({Code.SMOOTHED_KEYPOINTS})
# Wrong of all cameras, or of some and it is not told which: then no position can be believed.
_OF_ALL = frozenset(
    {
        Code.IMAGE_SIZE,
        Code.NORMALISED,
        Code.TURNED_IMAGE,
        Code.MIRRORED_IMAGE,
        Code.EXCHANGED_CAMERAS,
        Code.UNIT,
        Code.CAMERA_AXES,
        Code.WRONG_LENS,
        Code.NO_AGREEMENT,
        Code.MOVED_CAMERA,
        Code.BUMPED_CAMERA,
        Code.DISAGREEING_CAMERA,
        Code.ZERO_KEYPOINTS,
        Code.PLACEHOLDER_KEYPOINTS,
    }
)


def told_live(findings: Iterable[Finding], began_s: float) -> tuple[LiveFinding, ...]:
    """What is wrong or doubtful, the severest first.

    Args:
        findings: of a diagnosis.
        began_s: Unix time from which their times count.
    """
    told = [
        LiveFinding(
            code=finding.code.value,
            severity=severity,
            reason=finding.reason,
            remedy=remedy or finding.remedy,
            camera=finding.camera,
            from_s=None if finding.from_s is None else began_s + finding.from_s,
            to_s=None if finding.to_s is None else began_s + finding.to_s,
        )
        for finding in findings
        if (severity := _severity(finding)) is not Severity.NOTE and (remedy := REMEDIES[finding.code]) is not None
    ]
    return tuple(sorted(told, key=lambda each: list(Severity).index(each.severity)))


def _severity(finding: Finding) -> Severity:
    is_graver = finding.severity is Severity.NOTE and finding.code in _DOUBTFUL_LIVE
    return Severity.DOUBTFUL if is_graver else finding.severity


def changes(
    before: LiveJudgement | None, now: LiveJudgement | None
) -> tuple[tuple[LiveFinding, ...], tuple[LiveFinding, ...]]:
    """What is found that was not before, and what is found no longer."""
    old, new = (() if each is None else each.findings for each in (before, now))
    old_keys, new_keys = ({(finding.code, finding.camera) for finding in findings} for findings in (old, new))
    return (
        tuple(finding for finding in new if (finding.code, finding.camera) not in old_keys),
        tuple(finding for finding in old if (finding.code, finding.camera) not in new_keys),
    )


def doubt(judgement: LiveJudgement | None, camera: str) -> str:
    """Why what comes of a camera should not be trusted, in words; empty: nothing says so. What is only doubtful makes
    no camera so: estimates allow for most of it."""
    for finding in () if judgement is None else judgement.findings:
        if finding.severity is Severity.WRONG and (finding.camera == camera or _is_of_all(finding)):
            return f"by the diagnosis of the last minute: {finding.reason} [{finding.code}]"
    return ""


def _is_of_all(finding: LiveFinding) -> bool:
    # Who is exchanged with somebody, or has a copy, is named alone where it may be either.
    is_unnamed = not finding.camera or finding.code == Code.EXCHANGED_CAMERAS
    return is_unnamed and finding.code in _OF_ALL
