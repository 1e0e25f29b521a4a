"""Lenses whose focal length changes to and fro."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose.calibration.changes.breathing import Breathing
from fgpose.calibration.changes.find_changes import find_changes
from fgpose.diagnosis.changes.other_lenses import unsteady_lenses
from fgpose.finding import Code
from tests.fgpose.calibration.changes.changing import FPS, RIG, filmed, walk_m

DURATION_S = 14.0
THREE = RIG.subset(RIG.names[:3])


def breathed(
    seen: fgpose.Observations, c: int, share: float, period_s: float, phase: float = 0.0
) -> fgpose.Observations:
    """A camera whose images grow and shrink about their centre, by up to this share."""
    points2d_px = seen.points2d_px.copy()
    factor = 1 + share * np.sin(2 * np.pi * np.arange(len(points2d_px)) / (FPS * period_s) + phase)
    centre_px = RIG.cameras[c].K[:2, 2]
    points2d_px[:, c] = centre_px + factor[:, None, None] * (points2d_px[:, c] - centre_px)
    return replace(seen, points2d_px=points2d_px)


def test_the_focus_of_one_camera() -> None:
    seen = breathed(filmed(walk_m(3, DURATION_S)).subset(THREE.names), 1, 0.03, 6.0)
    found = find_changes([seen], THREE)
    assert found.changes == ()
    (breathing,) = found.breathing
    assert breathing.camera == 1
    # A sine of 3 % has a standard deviation of 2.1 %; a process that returns to its mean is drawn to it, by a fifth.
    assert breathing.share == pytest.approx(0.021, abs=0.006)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 6])
def test_the_focus_of_all(seed: int) -> None:
    seen = filmed(walk_m(seed, 20.0))
    for c in range(RIG.n_cameras):
        seen = breathed(seen, c, 0.03, 6.0, 2.0 * c)
    assert len(find_changes([seen], RIG).breathing) >= 2


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 6])
def test_steady_lenses(seed: int) -> None:
    """With the errors of a real detector, which change with the side from which somebody is seen."""
    assert find_changes([filmed(walk_m(seed, 20.0))], RIG).breathing == ()


def test_what_is_said() -> None:
    names = ("left", "middle", "right")
    (one,) = unsteady_lenses([Breathing(1, 0.021)], names)
    assert (one.code, one.camera) == (Code.UNSTEADY_LENS, "middle")
    assert "The focal length of middle changes to and fro" in one.reason
    assert "by 2.1 % (standard deviation)" in one.reason
    assert "leave it out with --cameras" in one.remedy
    (several,) = unsteady_lenses([Breathing(1, 0.021), Breathing(2, 0.03)], names)
    assert several.camera == ""
    assert (
        "middle and right, perhaps of others too, changes to and fro while the recording lasts, by 3.0 %"
        in several.reason
    )
    assert "--cameras" not in several.remedy
    (of_two,) = unsteady_lenses([Breathing(0, 0.021)], names[:2])
    assert "left (or middle: with two cameras it cannot be told which)" in of_two.reason
    assert unsteady_lenses([], names) == []
