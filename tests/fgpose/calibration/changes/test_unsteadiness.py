"""Images that shake are told from cameras that stand elsewhere, and from clocks that are late."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

import fgpose
from fgpose.calibration.changes.change import Change, Kind
from fgpose.calibration.changes.unsteadiness import unsteadiness_m
from fgpose.diagnosis.changes.unsteady_cameras import unsteady_cameras
from fgpose.diagnosis.examined import Examined
from fgpose.finding import Code, Severity
from tests.fgpose.calibration.changes.changing import FPS, RIG, bumped, filmed, late, walk_m

DISTANCE_M = 5.0
SECONDS = 12.0


@cache
def seen() -> fgpose.Observations:
    return filmed(walk_m(1, SECONDS))


def shaken(cameras: list[int], sigma_m: float, seed: int = 0) -> fgpose.Observations:
    """As from hands: by so much where the person is, and by something else half a second later."""
    points_px, rng = seen().points2d_px.copy(), np.random.default_rng(seed)
    for c in cameras:
        noise = gaussian_filter1d(rng.normal(size=(len(points_px), 2)), 0.25 * FPS, axis=0)
        points_px[:, c] += (noise / noise.std(axis=0))[:, None] * sigma_m * RIG.cameras[c].K[0, 0] / DISTANCE_M
    return replace(seen(), points2d_px=points_px)


def found_m(observations: fgpose.Observations, changes: tuple[Change, ...] = (), cameras: int = 4) -> np.ndarray:
    names = RIG.names[:cameras]
    return unsteadiness_m([observations.subset(names)], RIG.subset(names), changes)


def test_cameras_that_stand_still_move_by_what_all_joints_share_of_the_errors_of_networks() -> None:
    assert np.max(found_m(seen())) < 0.005


@pytest.mark.parametrize("cameras", [2, 4])
def test_a_camera_of_poor_detections_stands_still(cameras: int) -> None:
    """By 28 mm, each joint by itself: their median moves too."""
    points_px, rng = seen().points2d_px.copy(), np.random.default_rng(0)
    points_px[:, 1] += rng.normal(0, 5.0, points_px[:, 1].shape)
    assert np.max(found_m(replace(seen(), points2d_px=points_px), cameras=cameras)) < 0.008


@pytest.mark.parametrize("cameras", [[1], [0, 1, 2, 3]])
def test_the_amplitude_is_found(cameras: list[int]) -> None:
    """Filtered by 0.25 s, 0.6 of the variance is new after half a second: sigma times 0.8, and a part of each
    camera is taken for that of the point where they meet."""
    unsteady_m = found_m(shaken(cameras, 0.08))
    np.testing.assert_allclose(unsteady_m[cameras], 0.08 * 0.8, rtol=0.45)
    assert np.max(np.delete(unsteady_m, cameras), initial=0.0) < 0.5 * unsteady_m[cameras].min()


def test_of_two_cameras_it_is_one_or_the_other() -> None:
    unsteady_m = found_m(shaken([1], 0.08), cameras=2)
    assert np.max(unsteady_m) > 0.03
    assert np.min(unsteady_m) == 0.0


def test_a_bump_is_no_shaking() -> None:
    assert np.max(found_m(bumped(seen(), 1, 3.0, 180, walk_m(1, SECONDS)))) < 0.008


def test_a_late_clock_is_none_when_it_is_undone() -> None:
    delayed, offset = late(seen(), 1, 10), Change(Kind.OFFSET, 1, offset_s=-10 / FPS)
    assert np.max(found_m(delayed, (offset,))) < 0.006 < 0.01 < np.max(found_m(delayed))


def test_two_cameras_in_one_place_tell_nothing_of_depth() -> None:
    """All rays to a point are one."""
    first = RIG.cameras[0]
    twice = fgpose.CameraRig((first, replace(first, name="twin")))
    same = replace(seen().subset(RIG.names[:1]), camera_names=(first.name,))
    points_px, confidence = (np.repeat(each, 2, axis=1) for each in (same.points2d_px, same.confidence))
    both = replace(
        same, camera_names=twice.names, points2d_px=points_px, confidence=confidence, points3d_m=None,
        covariance3d_m2=None,
    )  # fmt: skip
    assert np.max(unsteadiness_m([both], twice, ())) < 1e-6


def test_too_short_to_tell() -> None:
    assert np.isnan(found_m(seen().frames(slice(0, 90)))).all()


def test_nobody_to_tell_by() -> None:
    nothing = seen().without(np.ones(seen().confidence.shape, dtype=bool))
    assert np.isnan(found_m(nothing)).all()


def test_one_camera_is_named_and_may_be_left_out() -> None:
    (finding,) = unsteady_cameras(Examined(RIG, {0: shaken([1], 0.08)}))
    # Three outvote it: errors are 1.1 times as large.
    assert (finding.code, finding.severity, finding.camera) == (Code.UNSTEADY_CAMERA, Severity.DOUBTFUL, "ring_1")
    assert "ring_1 does not stand still: within 0.5 s all joints together move by " in finding.reason
    assert "leave it out with --cameras" in finding.remedy
    # 0.06 m at 5 m, of a focal length of 900 px.
    assert finding.numbers["moves_px"] == pytest.approx(11, rel=0.3)


@pytest.mark.slow
def test_several_are_one_finding() -> None:
    (finding,) = unsteady_cameras(Examined(RIG, {0: shaken([0, 1, 2, 3], 0.08)}))
    assert (finding.camera, finding.severity) == ("", Severity.WRONG)
    assert "do not stand still" in finding.reason
    assert "--cameras" not in finding.remedy
    assert unsteady_cameras(Examined(RIG, {0: seen()})) == []


@pytest.mark.slow
@pytest.mark.parametrize("cameras", [[1], [0, 1, 2, 3]])
def test_nothing_else_is_said(cameras: list[int]) -> None:
    """Before, images were lost, cameras bumped or views exchanged."""
    findings = fgpose.diagnose(shaken(cameras, 0.08), RIG).findings
    assert [each.code for each in findings] == [Code.UNSTEADY_CAMERA]
