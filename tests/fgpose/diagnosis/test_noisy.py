"""Detections that jump about from image to image."""

from __future__ import annotations

import numpy as np
import pytest

import fgpose
from fgpose.diagnosis.examined import Examined
from fgpose.diagnosis.seen.noisy import noisy_keypoints
from fgpose.finding import Code, Severity
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from tests.fgpose.diagnosis.damaged import room, with_points


@pytest.fixture(scope="module")
def rig() -> CameraRig:
    return room(4, seed=3)


def jumping(seen: Observations, by_px: float, frames: slice, cameras: slice = slice(None)) -> Observations:
    points_px = seen.points2d_px.copy()
    points_px[frames, cameras] += np.random.default_rng(0).normal(0, by_px, points_px[frames, cameras].shape)
    return with_points(seen, points_px)


@pytest.mark.parametrize(("frames", "when"), [(slice(None), "throughout"), (slice(60, None), "from 2 to 5 s")])
def test_views_in_the_dark(seen, rig, frames: slice, when: str) -> None:
    (finding,) = noisy_keypoints(Examined.of(jumping(seen, 40.0, frames), rig))
    assert (finding.code, finding.severity) == (Code.NOISY_KEYPOINTS, Severity.DOUBTFUL)
    assert when in finding.reason
    # 40 px at 4 to 5 m and 1400 px; a body of which half is seen is not as large.
    assert 0.09 <= finding.numbers["noise_m"] <= 0.2


def test_one_camera_in_the_dark_is_told_of_by_others(seen, rig) -> None:
    assert noisy_keypoints(Examined.of(jumping(seen, 40.0, slice(None), slice(1)), rig)) == []


def test_usual_errors_do_not_jump(seen, rig) -> None:
    assert noisy_keypoints(Examined.of(seen, rig)) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["balance_openpose", "balance_blazepose"])
def test_nothing_is_told_of_real_recordings(name: str) -> None:
    rig, seen = fgpose.files.load_recording(name)
    assert noisy_keypoints(Examined.of(seen, rig)) == []


@pytest.mark.slow
def test_what_follows_from_noise_is_not_said(seen, rig) -> None:
    given = jumping(seen, 40.0, slice(60, None))
    findings = fgpose.diagnose(given, rig, fgpose.smooth(given, rig)).findings
    assert [each.code for each in findings] == [Code.NOISY_KEYPOINTS]
