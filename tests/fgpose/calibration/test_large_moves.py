"""What looks like a moved camera and is none is not mended by moving it."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose.calibration.self_calibration import calibrate_cameras
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, ring_rig, simulate, walking
from tests.wrong_rigs import turned

SKELETON = fgpose.load_skeleton("h36m_17")


@pytest.fixture(scope="module")
def rig() -> CameraRig:
    return ring_rig(3)


@pytest.fixture(scope="module")
def seen(rig: CameraRig) -> Observations:
    walk = simulate(walking(60, 20.0), SKELETON, rig, 20.0, DetectionNoise(), NO_OCCLUSION, 1).observations
    return replace(walk, points3d_m=None, covariance3d_m2=None)


def test_images_of_another_size_are_not_refined_away(seen: Observations, rig: CameraRig) -> None:
    half = replace(seen, points2d_px=seen.points2d_px / 2)
    with pytest.raises(ValueError, match=r"not refined: this would move camera ring_\d by \d+ cm") as refused:
        calibrate_cameras(half, rig, poses=True, clocks=False)
    assert "fgpose info" in str(refused.value)


def test_exchanged_cameras_are_not_refined_away(seen: Observations, rig: CameraRig) -> None:
    order = [1, 0, 2]
    exchanged = replace(seen, points2d_px=seen.points2d_px[:, order], confidence=seen.confidence[:, order])
    with pytest.raises(ValueError, match="exchanged cameras") as refused:
        fgpose.calibration.refine_rig(exchanged, rig)
    moves_cm = [float(found) for found in re.findall(r"by (\d+) cm and", str(refused.value))]
    assert max(moves_cm) > 15


@pytest.mark.parametrize("degrees", [1.0, 8.0])
def test_a_bump_is_refined(seen: Observations, rig: CameraRig, degrees: float) -> None:
    found = fgpose.calibration.refine_rig(seen, turned(rig, 1, degrees))
    # Half a degree, 4 cm at 4.5 m, is left of 5 px of correlated errors and the prior.
    assert found.rotation_deg[1] == pytest.approx(degrees, abs=0.7)
    assert np.delete(found.rotation_deg, 1).max() < 0.5
