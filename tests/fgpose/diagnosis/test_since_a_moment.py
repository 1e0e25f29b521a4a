"""Causes that begin, or end, at a moment."""

from __future__ import annotations

import numpy as np
import pytest

import fgpose
from fgpose.diagnosis.examined import Examined
from fgpose.diagnosis.hypotheses.since_a_moment import since_a_moment
from fgpose.finding import Code, Severity
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from tests.fgpose.diagnosis.damaged import SIZE_PX, SKELETON, room, with_points

AT, AT_S = 80, 80 / 30


@pytest.fixture(scope="module")
def rig() -> CameraRig:
    return room(4, seed=3)


def exchanged(seen: Observations, frames: slice) -> Observations:
    points_px = seen.points2d_px.copy()
    points_px[frames, [0, 2]] = seen.points2d_px[frames, [2, 0]]
    return with_points(seen, points_px)


def mirrored(seen: Observations, frames: slice) -> Observations:
    points_px = seen.points2d_px.copy()
    points_px[frames, 1] = seen.points2d_px[frames, 1][:, SKELETON.mirror]
    points_px[frames, 1, :, 0] = SIZE_PX[0] - 1 - points_px[frames, 1, :, 0]
    return with_points(seen, points_px)


@pytest.mark.parametrize("frames", [slice(AT, None), slice(AT)])
def test_cameras_that_are_exchanged_for_a_part_of_the_time(seen, rig, frames: slice) -> None:
    (first, *_) = fgpose.diagnose(exchanged(seen, frames), rig).findings
    assert (first.code, first.severity) == (Code.EXCHANGED_CAMERAS, Severity.WRONG)
    assert "cam1 and cam3" in first.reason
    assert (first.from_s, first.to_s)[frames.start is None] == pytest.approx(AT_S, abs=0.1)


@pytest.mark.slow
def test_what_follows_from_it_is_not_said(seen, rig) -> None:
    findings = fgpose.diagnose(exchanged(seen, slice(AT, None)), rig).findings
    assert [each.code for each in findings] == [Code.EXCHANGED_CAMERAS]


def test_a_program_that_mirrors_from_a_moment_on(seen, rig) -> None:
    (first, *_) = fgpose.diagnose(mirrored(seen, slice(AT, None)), rig).findings
    assert (first.code, first.camera) == (Code.MIRRORED_IMAGE, "cam2")
    assert first.numbers["at_s"] == pytest.approx(AT_S, abs=0.1)


def test_nothing_of_the_kind_is_told_of_other_recordings(seen, rig) -> None:
    points_px = seen.points2d_px.copy()
    points_px[AT:, 1] += np.array([160.0, 20.0])  # bumped
    for given in (seen, with_points(seen, points_px), exchanged(seen, slice(None))):
        assert since_a_moment(Examined.of(given, rig).geometry.state) is None
