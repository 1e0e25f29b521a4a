"""What changes in time, in words."""

from __future__ import annotations

import numpy as np

from fgpose.calibration.changes.change import Change, Kind
from fgpose.calibration.changes.find_changes import Changes
from fgpose.diagnosis.camera_faults_checks import findings_of
from fgpose.finding import Code, Finding

NAMES = ("left", "middle", "right")


def said(*changes: Change, names: tuple[str, ...] = NAMES) -> list[Finding]:
    return findings_of(Changes(changes, 1 / 30, 240.0, compared=True), names)


def test_lost_frames() -> None:
    (finding,) = said(Change(Kind.JUMP, 1, at_s=20.0, offset_s=0.2, sigma=0.002))
    assert (finding.code, finding.camera, finding.from_s) == (Code.LOST_FRAMES, "middle", 20.0)
    assert "middle lost 6 frames (200 +/- 2 ms) at 20.0 s" in finding.reason
    assert "--estimate-time-offsets" in finding.remedy


def test_a_constant_offset_is_not_advised_beside_a_jump() -> None:
    found = said(Change(Kind.OFFSET, 1, offset_s=0.1), Change(Kind.JUMP, 1, at_s=20.0, offset_s=0.2))
    assert [each.code for each in found] == [Code.LOST_FRAMES]


def test_a_rate_is_named() -> None:
    (finding,) = said(Change(Kind.RATE, 2, rate=0.001, sigma=0.004))
    assert finding.code is Code.CLOCK_RATE
    assert "29.97 Hz" in finding.reason
    assert "7.2 frames" in finding.reason


def test_a_bump_has_a_time() -> None:
    moved = Change(Kind.BUMP, 0, at_s=18.0, rotation=np.array([0.0, np.deg2rad(2.0), 0.0]), sigma=0.001)
    (finding,) = said(moved)
    assert (finding.code, finding.camera, finding.from_s) == (Code.BUMPED_CAMERA, "left", 18.0)
    assert "moved at 18.0 s, while it filmed, by about 2.0 +/- 0.1 degrees" in finding.reason
    assert "or middle" not in finding.reason
    (of_two,) = said(moved, names=NAMES[:2])
    assert "or middle" in of_two.reason


def test_what_is_too_far_for_a_bump_is_not_refined() -> None:
    (finding,) = said(Change(Kind.MOVED, 0, translation_m=np.array([0.5, 0.0, 0.0])))
    assert "calibrate again" in finding.remedy
    assert "--refine-calibration" not in finding.remedy


def test_late_and_moved_cameras_are_refined_together() -> None:
    turned = Change(Kind.MOVED, 0, rotation=np.array([0.0, 0.02, 0.0]))
    found = said(Change(Kind.OFFSET, 1, offset_s=1 / 30), turned)
    assert all("together" in each.remedy for each in found)
    assert "numbered from 0" in found[0].remedy
