"""What a recording and its rig say before anything is estimated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose.diagnosis.examined import Examined
from fgpose.diagnosis.hypotheses.findings import disagreements
from fgpose.diagnosis.input_checks import off_centre, unusual_steps
from fgpose.finding import Code
from fgpose.geometry.camera import CameraRig
from tests.fgpose.diagnosis.damaged import recorded, room


def without_centre(rig: CameraRig, cameras: tuple[int, ...]) -> CameraRig:
    """As files read that leave cx and cy out."""
    own = list(rig.cameras)
    for c in cameras:
        K = own[c].K.copy()
        K[:2, 2] = 0.0
        own[c] = replace(own[c], K=K)
    return CameraRig(tuple(own))


@pytest.mark.slow
def test_a_principal_point_that_was_left_out() -> None:
    rig = room(3)
    seen = recorded(rig)
    assert off_centre(Examined(rig, {0: seen})) == []
    (of_one,) = off_centre(Examined(without_centre(rig, (1,)), {0: seen}))
    assert (of_one.code, of_one.camera) == (Code.WRONG_LENS, "cam2")
    assert "cx = 0, cy = 0" in of_one.reason
    (of_all,) = off_centre(Examined(without_centre(rig, (0, 1, 2)), {0: seen}))
    assert "cam1, cam2, cam3" in of_all.reason


@pytest.mark.parametrize(
    ("of_focal", "code", "words"),
    [
        (1.0, Code.WRONG_LENS, "multiply cx and cy, and not the focal length, by 1.5"),
        (2 / 3, Code.IMAGE_SIZE, "Multiply the keypoints by 0.66"),
    ],
)
def test_a_principal_point_of_another_resolution_is_told_from_a_whole_calibration_of_it(
    of_focal: float, code: Code, words: str
) -> None:
    rig = room(4)
    other = np.array([[of_focal, 1, 2 / 3], [1, of_focal, 2 / 3], [1, 1, 1]])
    wrong = CameraRig(tuple(replace(camera, K=camera.K * other) for camera in rig.cameras))
    (found,) = disagreements(Examined(wrong, {0: recorded(rig)}))
    assert found.code is code
    assert words in found.remedy


def test_images_that_were_cut_with_their_calibration_are_right() -> None:
    rig = room(3)
    seen = recorded(rig)
    cut_px = np.array([600.0, 0.0])
    cameras = (replace(each, K=each.K - np.array([[0, 0, 600.0], [0, 0, 0], [0, 0, 0]])) for each in rig.cameras)
    cut = replace(seen, points2d_px=seen.points2d_px - cut_px, points3d_m=None, covariance3d_m2=None)
    assert off_centre(Examined(CameraRig(tuple(cameras)), {0: cut})) == []


@pytest.mark.usefixtures("without_search_for_faults")
@pytest.mark.parametrize(
    ("factor", "words"), [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds"), (1e-3, "another unit")]
)
def test_times_in_another_unit(factor: float, words: str) -> None:
    rig = room(3)
    seen = recorded(rig)
    assert unusual_steps(Examined(rig, {0: seen})) == []
    slowed = replace(seen, time_s=factor * seen.time_s)
    (finding,) = unusual_steps(Examined(rig, {0: slowed}))
    assert finding.code is Code.FRAME_RATE
    assert words in finding.remedy
    if factor == 1e9:
        assert [each for each in fgpose.diagnose(slowed, rig).findings if each.code is Code.FRAME_RATE] == [finding]
