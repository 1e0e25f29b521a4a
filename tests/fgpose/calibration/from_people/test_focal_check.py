"""Focal lengths that were given are checked by the recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_walk_adjustment import MORE, RIG, started
from walks import walk

from fgpose.calibration.from_people.rig.focal_check import FocalCheck, check_focal
from fgpose.calibration.from_people.rig.walk_adjustment import adjust
from fgpose.geometry.camera import Camera, CameraRig
from fgpose_benchmarks.synthetic import DetectionNoise


def checked(ratio: float) -> FocalCheck:
    """With the focal length of the second camera given as so many times the true one."""
    start = list(started(RIG, 1.0).cameras)
    start[1] = with_focal(start[1], ratio)
    adjusted = adjust(walk(RIG, 600, DetectionNoise()), CameraRig(tuple(start)), config=MORE)
    return check_focal(adjusted.problem, adjusted.state)


def with_focal(camera: Camera, ratio: float) -> Camera:
    K = camera.K.copy()
    K[[0, 1], [0, 1]] *= ratio
    return replace(camera, K=K)


@pytest.mark.slow
def test_right_focal_lengths_hardly_change() -> None:
    check = checked(1.0)
    assert (check.sigma < 0.05).all()
    assert (np.abs(check.change) < 3 * check.sigma).all()


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.75, 1.3])
def test_a_wrong_focal_length_would_change_back(ratio: float) -> None:
    check = checked(ratio)
    # One step of a problem that is not linear: it comes to within a third of the way.
    assert check.change[1] == pytest.approx(-np.log(ratio), rel=0.33)
    assert np.abs(check.change).argmax() == 1
    assert abs(check.change[1]) > 5 * check.sigma[1]
