"""What a calibration from people gives: the rig, how sure it is, and a verdict in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from jaxtyping import Float

from fgpose.calibration.from_people.walk import Walk
from fgpose.geometry.camera import CameraRig
from fgpose.shown import Shown


class Grade(Enum):
    """How far a calibration can be trusted."""

    GOOD = "good"
    COARSE = "coarse"
    """Good enough to begin from (refine_rig), not to measure with."""
    FAILED = "failed"
    """No rig file is written."""

    @property
    def gravity(self) -> int:
        """The larger, the worse."""
        return list(Grade).index(self)


@dataclass(frozen=True)
class CalibrationFinding:
    """One reason for a verdict, and what helps."""

    camera: str
    """Whose it is; empty: of the whole rig."""
    grade: Grade
    reason: str
    """As "the focal length is not determined"."""
    remedy: str
    """As "walk towards the camera and away from it"."""

    @property
    def text(self) -> str:
        """Whose it is, and the reason."""
        return f"{f'camera {self.camera}' if self.camera else 'all cameras'}: {self.reason}"


def by_remedy(findings: Sequence[CalibrationFinding]) -> list[tuple[CalibrationFinding, ...]]:
    """Those of one grade that the same helps against together, the gravest first."""
    together: dict[tuple[Grade, str], list[CalibrationFinding]] = {}
    for finding in findings:
        together.setdefault((finding.grade, finding.remedy), []).append(finding)
    return [tuple(together[key]) for key in sorted(together, key=lambda key: -key[0].gravity)]


def worst_grade(findings: Sequence[CalibrationFinding]) -> Grade:
    return max((finding.grade for finding in findings), key=lambda grade: grade.gravity, default=Grade.GOOD)


@dataclass(frozen=True, eq=False, repr=False)
class CameraSigmas(Shown):
    """Standard deviations of the cameras, about the centroid of the rig, inflated by the disagreement of two halves of
    the recording. What a detector makes wrong of a joint in one camera all the time is in both halves, not in these."""

    position_m: Float[np.ndarray, " camera"]
    """Of the place, root of the sum over the axes."""
    direction_deg: Float[np.ndarray, " camera"]
    """Of the rotation, root of the sum over the axes."""
    focal: Float[np.ndarray, " camera"]
    """Of the focal length, as a share of it; zero where it was given."""
    offset_s: Float[np.ndarray, " camera"]
    """Of the start, relative to the first camera; zero where it was given."""
    scale: float
    """Of all lengths, as a share of them."""
    vertical_deg: float
    floor_m: float


@dataclass(frozen=True, eq=False, repr=False)
class CalibratedFromPeople(Shown):
    """A rig that was found from the people in it."""

    rig: CameraRig
    """World z up, floor at z = 0, origin under the first camera, whose horizontal viewing direction is x; metres.
    time_offset_s of each camera turns its clock into that of the first."""
    sigmas: CameraSigmas
    walk: Walk
    """What was used, on the common clock."""
    joints_m: Float[np.ndarray, "frame joint 3"]
    """Of the walk, world frame; NaN = not determined."""
    residual_px: Float[np.ndarray, "frame camera joint"]
    """Length of the reprojection errors; NaN = missing."""
    findings: tuple[CalibrationFinding, ...]
    scale_from: str
    """Which cue the scale is from, as "stature 1.78 m"."""

    @property
    def grade(self) -> Grade:
        """The worst of the findings."""
        return worst_grade(self.findings)
