"""What is probably wrong with a recording, a rig or a result: one thing, its cause, and what to do about it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum


class Severity(StrEnum):
    """How much of what is given can no longer be believed."""

    WRONG = "wrong"
    """Numbers are off by more than they claim."""
    DOUBTFUL = "doubtful"
    """Some of them may be."""
    NOTE = "note"
    """Numbers are right within what they claim; it is good to know all the same."""


class Code(StrEnum):
    """What a finding is about. Stable: programs may compare them; each has an entry in docs/help/findings.md."""

    # What the keypoints and the calibration are.
    IMAGE_SIZE = "image-size"
    NORMALISED = "normalised-coordinates"
    ZERO_KEYPOINTS = "zero-keypoints"
    PLACEHOLDER_KEYPOINTS = "placeholder-keypoints"
    CLIPPED_KEYPOINTS = "clipped-keypoints"
    TURNED_IMAGE = "turned-image"
    MIRRORED_IMAGE = "mirrored-image"
    EXCHANGED_CAMERAS = "exchanged-cameras"
    UNIT = "unit"
    CAMERA_AXES = "camera-axes"
    WORLD_UP = "world-up"
    WRONG_SKELETON = "wrong-skeleton"
    EXCHANGED_SIDES = "exchanged-sides"
    OTHER_PERSON = "other-person"
    MOVED_CAMERA = "moved-camera"
    WRONG_LENS = "wrong-lens"
    WRONG_CAMERA = "wrong-camera"
    NO_AGREEMENT = "no-agreement"
    CALIBRATION = "calibration"
    PER_VIEW_JOINTS = "per-view-joints"
    # What changes in time.
    LATE_CAMERA = "late-camera"
    LOST_FRAMES = "lost-frames"
    CLOCK_RATE = "clock-rate"
    BUMPED_CAMERA = "bumped-camera"
    UNSTEADY_CAMERA = "unsteady-camera"
    UNSTEADY_LENS = "unsteady-lens"
    AMBIGUOUS_START = "ambiguous-start"
    UNDETERMINED_CLOCK = "undetermined-clock"
    FROZEN_CAMERA = "frozen-camera"
    REPEATED_IMAGES = "repeated-images"
    SMOOTHED_KEYPOINTS = "smoothed-keypoints"
    NOISY_KEYPOINTS = "noisy-keypoints"
    INTERPOLATED_KEYPOINTS = "interpolated-keypoints"
    FRAME_ORDER = "frame-order"
    MISSING_FRAMES = "missing-frames"
    FRAME_RATE = "frame-rate"
    # Who is seen, and how well.
    NOBODY = "nobody"
    SOMEBODY_ELSE = "somebody-else"
    IDENTITY_SWITCH = "identity-switch"
    SEVERAL_PEOPLE = "several-people"
    FEW_CAMERAS = "few-cameras"
    BLIND_CAMERA = "blind-camera"
    NEVER_SEEN = "never-seen"
    LOW_CONFIDENCE = "low-confidence"
    EQUAL_CONFIDENCE = "equal-confidence"
    HALLUCINATING_CAMERA = "hallucinating-camera"
    THING_FOR_PERSON = "thing-for-person"
    MISPLACED_JOINT = "misplaced-joint"
    READ_WITH_REPAIRS = "read-with-repairs"
    # What came out.
    UNDETERMINED = "undetermined"
    NOT_CONVERGED = "not-converged"
    SOLVER_FAILURE = "solver-failure"
    LARGE_ERRORS = "large-errors"
    DISAGREEING_CAMERA = "disagreeing-camera"
    CONTRADICTED = "contradicted"
    GAP = "gap"
    OUTSIDE = "outside"
    IMPOSSIBLE_SPEED = "impossible-speed"
    IMPOSSIBLE_TURN = "impossible-turn"
    SHORT_LIFE = "short-life"
    PERHAPS_EXCHANGED = "perhaps-exchanged"
    PERHAPS_SAME = "perhaps-same"
    MOTIONLESS = "motionless"
    REFLECTION = "reflection"
    OTHER_BONES = "other-bones"


@dataclass(frozen=True)
class Finding:
    """Something that is probably wrong, why it is thought so, and what to do.

    The reason names the number that gave it away and what it was compared with. A remedy that changes the input was
    tried on the recording: what did not enter it is better with it than without.
    """

    code: Code
    severity: Severity
    reason: str
    remedy: str
    weight: float = 1.0
    """Share of the result that it puts in doubt, in [0, 1]: the most important has the largest."""
    camera: str = ""
    """Which one it is about; empty: all, or none in particular. The same for joint (or "arms", "legs") and person."""
    joint: str = ""
    person: int | None = None
    from_s: float | None = None
    """Since when, by the clock of the recording; None: throughout. Until when: to_s."""
    to_s: float | None = None
    numbers: Mapping[str, float] = field(default_factory=dict)
    """What it rests on, by names with units: {"rotation_deg": 2.1}."""

    def __post_init__(self) -> None:
        # Files are strict about numbers.
        known = {name: float(value) for name, value in self.numbers.items() if math.isfinite(value)}
        object.__setattr__(self, "numbers", known)

    @property
    def subject(self) -> str:
        """Camera, joint or person; empty: the whole recording."""
        who = "" if self.person is None else f"person {self.person}"
        return self.camera or ": ".join(part for part in (who, self.joint) if part)

    @property
    def text(self) -> str:
        """In one paragraph, as it is printed."""
        return f"{self.reason}. {self.remedy} [{self.code}]"


def severest_first(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Of equally severe ones the weightiest first."""
    order = list(Severity)
    return tuple(sorted(findings, key=lambda each: (order.index(each.severity), -each.weight)))
