"""Lenses that are given to a calibration with a board, and are wrong."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest

from fgpose.assessment.rig_alignment import rig_similarity
from fgpose.calibration.board.calibrate import CalibratedFromBoards, calibrate_from_boards
from fgpose.calibration.from_people.calibrated import Grade
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.intrinsics import shifted, zoomed
from fgpose_benchmarks.synthetic.boards import BoardScene, simulate_boards

NUMBER = re.compile(r"\d+(\.\d)?")


def number(text: str) -> float:
    found = NUMBER.search(text)
    assert found is not None
    return float(found.group())


@pytest.fixture(scope="module")
def scene() -> BoardScene:
    return simulate_boards(3, 5, n_common=24, n_near=9)


def off_m(result: CalibratedFromBoards, true: CameraRig) -> np.ndarray:
    """Of the places, but for a motion of the whole rig."""
    found = rig_similarity(result.rig, true, with_scale=False).rig(result.rig)
    return np.linalg.norm(found.positions_m - true.positions_m, axis=1)


def first_wrong(rig: CameraRig, change: Callable[[Camera], Camera]) -> CameraRig:
    return CameraRig((change(rig.cameras[0]), *rig.cameras[1:]))


@pytest.mark.parametrize(
    ("change", "said", "tolerance"),
    # Views of one camera tell its focal length to 0.15 %, and its principal point to 2 px: three times that.
    [
        (lambda camera: zoomed(camera, 1.01), "its focal length seems to be 1.0% off what was given", 0.45),
        (lambda camera: zoomed(camera, 1.05), "its focal length seems to be 4.8% off what was given", 0.45),
        (lambda camera: shifted(camera, 0.025, 0), "its principal point seems to be 27 px off what was given", 6),
    ],
    ids=["focal 1 %", "focal 5 %", "centre"],
)
def test_a_wrong_lens_is_named(
    scene: BoardScene, change: Callable[[Camera], Camera], said: str, tolerance: float
) -> None:
    """Before, the verdict was good, with places 30 to 50 standard deviations off."""
    result = calibrate_from_boards(scene.sightings, intrinsics=first_wrong(scene.rig, change))
    (finding,) = result.findings
    assert (finding.camera, finding.grade) == (scene.rig.names[0], Grade.COARSE)
    assert NUMBER.sub("", finding.reason) == NUMBER.sub("", said)
    assert number(finding.reason) == pytest.approx(number(said), abs=tolerance)
    assert (off_m(result, scene.rig) < 3 * result.sigmas.position_m).all()


def test_wrong_lenses_of_all_cameras_are_named(scene: BoardScene) -> None:
    """They make the whole rig larger, and contradict nobody."""
    wrong = CameraRig(tuple(zoomed(camera, 1.03) for camera in scene.rig.cameras))
    result = calibrate_from_boards(scene.sightings, intrinsics=wrong)
    assert [finding.camera for finding in result.findings] == list(scene.rig.names)
    assert (off_m(result, scene.rig) < 3 * result.sigmas.position_m).all()


def test_right_lenses_are_not_doubted(scene: BoardScene) -> None:
    result = calibrate_from_boards(scene.sightings, intrinsics=scene.rig)
    assert result.findings == ()
    assert result.sigmas.position_m.max() < 0.003


def test_lenses_of_another_calibration_are_not_called_wrong(scene: BoardScene) -> None:
    """As far off as a good one leaves them. Their errors are in the standard deviations of the poses: these were 1 mm
    whatever was given."""
    factors = (1.001, 0.999, 1.0007)
    given = CameraRig(tuple(zoomed(camera, by) for camera, by in zip(scene.rig.cameras, factors, strict=True)))
    result = calibrate_from_boards(scene.sightings, intrinsics=given)
    assert result.findings == ()
    assert (off_m(result, scene.rig) < 3 * result.sigmas.position_m).all()


def test_few_views_do_not_contradict_a_lens() -> None:
    """Six to eight from afar: a lens that is free follows their noise by tens of per cent."""
    scene = simulate_boards(3, 0, n_common=12, n_near=0)
    result = calibrate_from_boards(scene.sightings, intrinsics=scene.rig)
    assert all("images only" in finding.reason for finding in result.findings)
