"""What changes in time, in words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgpose.calibration.changes.change import Change, Kind
from fgpose.calibration.changes.find_changes import Changes
from fgpose.diagnosis.changes.camera_faults_checks import findings_of, moved_and_late_cameras
from fgpose.diagnosis.examined import Examined
from fgpose.finding import Code, Finding, Severity
from tests.fgpose.calibration.changes.changing import RIG, bumped, filmed, walk_m

NAMES = ("left", "middle", "right")


def said(*changes: Change, names: tuple[str, ...] = NAMES) -> list[Finding]:
    return findings_of(Changes(changes, 1 / 30, 240.0, compared=True), names)


def test_lost_frames() -> None:
    (finding,) = said(Change(Kind.JUMP, 1, at_s=20.0, offset_s=0.2, sigma=0.002))
    assert (finding.code, finding.camera, finding.from_s) == (Code.LOST_FRAMES, "middle", 20.0)
    assert "middle lost 6 frames (200 +/- 2 ms) at 20.0 s" in finding.reason
    assert "--estimate-time-offsets" in finding.remedy


def test_images_that_are_lost_again_and_again_are_told_together() -> None:
    jumps = [Change(Kind.JUMP, 1, at_s=at_s, offset_s=0.1, sigma=0.01) for at_s in (3.0, 70.0, 150.0)]
    (of_one,) = said(*jumps)
    assert (of_one.camera, of_one.from_s, of_one.numbers["frames"]) == ("middle", 3.0, pytest.approx(9))
    assert "middle lost images 3 times, 9 frames (300 ms) in all" in of_one.reason
    assert "3 at 3.0 s, 3 at 70.0 s and 3 at 150.0 s" in of_one.reason
    assert "to about 10 ms; a constant offset or another rate would be wrong" in of_one.remedy
    more = [Change(Kind.JUMP, 2, at_s=float(at_s), offset_s=1 / 30, sigma=0.01) for at_s in range(10, 130)]
    (of_several,) = said(*jumps, *more)
    assert (of_several.code, of_several.camera) == (Code.LOST_FRAMES, "")
    assert "middle 3 at 3.0 s" in of_several.reason
    assert "right 1 at 10.0 s" in of_several.reason
    assert "1 at 17.0 s, and so on" in of_several.reason
    assert "better give the times of the images" in of_several.remedy


def test_a_time_that_is_hardly_known_is_an_interval() -> None:
    jump = Change(Kind.JUMP, 1, at_s=20.0, offset_s=0.2, sigma=0.002)
    (known,), (doubtful,) = (said(replace(jump, between_s=each)) for each in ((19.0, 21.0), (16.2, 21.5)))
    assert "at 20.0 s" in known.reason
    assert "at some time from 16 to 22 s, most probably at 20.0 s" in doubtful.reason
    assert (doubtful.numbers["earliest_s"], doubtful.numbers["latest_s"]) == (16.2, 21.5)


def test_a_constant_offset_is_not_advised_beside_a_jump() -> None:
    found = said(Change(Kind.OFFSET, 1, offset_s=0.1), Change(Kind.JUMP, 1, at_s=20.0, offset_s=0.2))
    assert [each.code for each in found] == [Code.LOST_FRAMES]


def test_of_two_cameras_one_that_is_far_too_late_is_wrong() -> None:
    """55 % of the errors were within the 99 % ellipsoids at 0.16 s; of four cameras, the others outvote it."""
    late = Change(Kind.OFFSET, 1, offset_s=0.16, sigma=0.002)
    slightly = replace(late, offset_s=0.05)
    severities = [said(change, names=names)[0].severity for names in (NAMES[:2], NAMES) for change in (late, slightly)]
    assert severities == [Severity.WRONG, Severity.DOUBTFUL, Severity.DOUBTFUL, Severity.DOUBTFUL]


def test_clocks_of_which_none_is_outvoted_are_measured_by_those_that_are_named() -> None:
    names = (*NAMES, "back")
    late = [Change(Kind.OFFSET, c, offset_s=0.133, sigma=0.003) for c in (0, 1)]
    for name, finding in zip(names, said(*late, names=names), strict=False):
        assert (finding.code, finding.camera, finding.severity) == (Code.LATE_CAMERA, name, Severity.WRONG)
        assert "measured by the clocks of right and back" in finding.reason
    assert "measured by the clock of right" in said(*late)[0].reason
    (alone,) = said(late[0], names=names)
    assert alone.severity is Severity.DOUBTFUL
    assert "measured by the clocks of the others" in alone.reason


def test_a_rate_is_named() -> None:
    (finding,) = said(Change(Kind.RATE, 2, rate=0.001, sigma=0.004))
    assert finding.code is Code.CLOCK_RATE
    assert "29.97 Hz" in finding.reason
    assert "7.2 frames (240 +/- 4 ms)" in finding.reason
    beside_another = said(Change(Kind.OFFSET, 1, offset_s=0.1), Change(Kind.RATE, 2, rate=0.001, sigma=0.004))[1]
    assert "7.2 frames (240 ms, if no other clock drifts)" in beside_another.reason


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


def test_cameras_that_were_moved_at_one_moment_are_one_finding() -> None:
    turn = np.array([0.0, 0.03, 0.0])
    (finding,) = said(*(Change(Kind.BUMP, c, at_s=7.0 + 0.3 * c, rotation=turn) for c in range(3)))
    assert (finding.code, finding.camera) == (Code.BUMPED_CAMERA, "")
    assert "3 cameras (left, middle, right) were moved at 7.3 s" in finding.reason
    assert "--refine-calibration" not in finding.remedy


def test_a_camera_that_sinks_is_not_refined() -> None:
    """Refined as three bumps, the error was three times as large."""
    turn = np.array([0.0, 0.03, 0.0])
    (finding,) = said(*(Change(Kind.BUMP, 0, at_s=at_s, rotation=turn) for at_s in (4.0, 7.0, 9.0)))
    assert "left did not stand still: moved at 4.0, 7.0, 9.0 s" in finding.reason
    assert "--refine-calibration" not in finding.remedy


def test_a_camera_that_was_put_back_has_a_beginning_and_an_end() -> None:
    turn = np.array([0.0, 0.03, 0.0])
    away = Change(Kind.BUMP, 0, at_s=4.0, until_s=8.0, rotation=turn)
    (finding,) = said(away)
    assert (finding.code, finding.from_s, finding.to_s) == (Code.BUMPED_CAMERA, 4.0, 8.0)
    assert "left was moved at 4.0 s, while it filmed" in finding.reason
    assert "put back at 8.0 s" in finding.reason
    assert "--refine-calibration. It gives the camera another pose in between." in finding.remedy
    (far,) = said(replace(away, rotation=20 * turn))
    assert "Cut the recording at 4.0 and 8.0 s" in far.remedy
    # Another move afterwards does not make a camera one that moves slowly.
    assert len(said(away, Change(Kind.BUMP, 0, at_s=12.0, rotation=turn))) == 2


def test_what_is_right_until_a_moment_and_from_another_on_moves_slowly() -> None:
    """One bump says that the calibration is right after it, the other one that it is right before."""
    turn = np.array([0.0, 0.03, 0.0])
    (finding,) = said(Change(Kind.BUMP, 0, at_s=12.5, rotation=turn), Change(Kind.BUMP, 0, until_s=8.3, rotation=-turn))
    assert "left did not stand still: moved at 8.3, 12.5 s, or all the time" in finding.reason
    twice = [Change(Kind.BUMP, 0, at_s=at_s, rotation=turn) for at_s in (8.3, 12.5)]
    assert len(said(*twice)) == 2


def test_cameras_of_which_none_holds_the_world_are_one_finding() -> None:
    turn = np.array([0.0, 0.03, 0.0])
    both = [Change(Kind.MOVED, c, rotation=turn) for c in (0, 2)]
    (finding,) = said(*both)
    assert finding.severity is Severity.WRONG
    assert "2 of 3 cameras (left, right)" in finding.reason
    assert len(said(*both, names=("left", "middle", "right", "back"))) == 2


@pytest.mark.slow
def test_two_cameras_on_one_table_that_was_knocked_against() -> None:
    truth_m = walk_m(1, 10.0)
    seen = filmed(truth_m)
    for c in (1, 2):
        seen = bumped(seen, c, 3.0, 150, truth_m)
    (finding,) = moved_and_late_cameras(Examined(RIG, {0: seen}))
    assert (finding.code, finding.camera) == (Code.BUMPED_CAMERA, "")
    assert "2 cameras (ring_1, ring_2) were moved at 5.0 s" in finding.reason
