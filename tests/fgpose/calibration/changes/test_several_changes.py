"""Several cameras that change: each was measured by others that were wrong themselves."""

from __future__ import annotations

import numpy as np
import pytest

from fgpose.calibration.changes.change import Change, Kind, with_changes
from fgpose.calibration.changes.find_changes import find_changes
from tests.fgpose.calibration.changes.changing import (
    FPS,
    RIG,
    bumped,
    exchanged,
    filmed,
    late,
    moved_rig,
    slower,
    walk_m,
)


def test_clocks_that_all_differ() -> None:
    """Before, the first one was measured by the mean of the others, and the third was named for what was left."""
    three = RIG.subset(RIG.names[:3])
    seen = late(late(filmed(walk_m(1, 10.0)).subset(three.names), 1, 6), 2, 11)
    found = find_changes([seen], three).changes
    # Numbered too high by 6 and 11 images, measured by the second.
    offset_s = {each.camera: each.offset_s for each in found}
    assert {each.kind for each in found} == {Kind.OFFSET}
    assert offset_s.keys() == {0, 2}
    # Three standard deviations of 3 ms.
    assert offset_s[0] == pytest.approx(6 / FPS, abs=0.009)
    assert offset_s[2] == pytest.approx(-5 / FPS, abs=0.009)


@pytest.mark.parametrize("n_cameras", [pytest.param(4, marks=pytest.mark.slow), 3])
def test_a_camera_that_was_moved_and_put_back(n_cameras: int) -> None:
    """No move from a moment on, or until one, suited: it was said that nothing had changed."""
    truth_m, names = walk_m(6, 12.0), RIG.names[:n_cameras]
    seen, away = filmed(truth_m), filmed(truth_m, moved_rig(1, 2.0))
    (found,) = find_changes([exchanged(seen, 1, away, slice(120, 240)).subset(names)], RIG.subset(names)).changes
    assert (found.kind, found.camera) == (Kind.BUMP, 1)
    # A second is what is promised.
    assert found.at_s == pytest.approx(120 / FPS, abs=1.0)
    assert found.until_s == pytest.approx(240 / FPS, abs=1.0)
    # Four seconds of three cameras: three standard deviations of 0.3 degrees, as stated.
    assert found.rotation_deg == pytest.approx(2.0, abs=0.9)
    (changed,) = [each for each in with_changes(RIG, [found], poses=True, clocks=False).cameras if each.moves]
    (_, moved), (_, back) = changed.moves
    np.testing.assert_allclose(moved, found.moved_pose(RIG.cameras[1].world_T_camera))
    np.testing.assert_allclose(back, RIG.cameras[1].world_T_camera)


@pytest.mark.slow
def test_cameras_that_were_bumped_at_once() -> None:
    """Before, a third one was named, that agreed with both as they seemed to stand."""
    truth_m = walk_m(6, 10.0)
    seen = bumped(bumped(filmed(truth_m), 0, 2.0, 150, truth_m), 1, 2.0, 150, truth_m)
    found = find_changes([seen], RIG).changes
    assert sorted((each.kind, each.camera) for each in found) == [(Kind.BUMP, 0), (Kind.BUMP, 1)]
    for each in found:
        assert each.at_s == pytest.approx(150 / FPS, abs=1.0)  # what is promised
        # Turned by 2 degrees, moved by 22 mm; before, by 13 cm.
        assert np.linalg.norm(each.translation_m) < 0.1


def test_the_sigma_of_an_offset_holds_a_drift_that_is_not_noticed() -> None:
    """Of 36 ms, one frame, beside an offset of five: it was stated to 5 ms."""
    three, truth_m = RIG.subset(RIG.names[:3]), walk_m(3, 12.0)
    seen = late(slower(filmed(truth_m), 1, 1.003, truth_m), 1, 5).subset(three.names)
    (found,) = find_changes([seen], three).changes
    assert found.kind is Kind.OFFSET
    assert type(found.offset_s) is float
    assert found.offset_s == pytest.approx(0.018 - 5 / FPS, abs=2 * found.sigma)
    # Standard deviation of what grows evenly; a fifth less, for blocks at both ends may tell less.
    assert found.sigma > 0.8 * 0.036 / np.sqrt(12)


def test_changes_are_alike_to_a_part_of_what_is_known() -> None:
    second_s = np.arange(10.0)
    late_s = [Change(Kind.OFFSET, 0, offset_s=offset_s, sigma=0.01) for offset_s in (0.1, 0.101, 0.11)]
    assert late_s[0].is_like(late_s[1], second_s)
    assert not late_s[0].is_like(late_s[2], second_s)
    assert not late_s[0].is_like(Change(Kind.RATE, 0, offset_s=0.1, sigma=0.01), second_s)
    jumps = [Change(Kind.JUMP, 0, at_s=at_s, offset_s=0.1, sigma=0.01) for at_s in (4.2, 4.3, 5.1)]
    assert jumps[0].is_like(jumps[1], second_s)
    assert not jumps[0].is_like(jumps[2], second_s)
