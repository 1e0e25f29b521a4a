"""3D joints of one view that are in another frame or unit than they were read in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose.association.recording import associate
from fgpose.diagnosis.examined import Examined
from fgpose.diagnosis.seen.own_3d import foreign_3d
from fgpose.finding import Code, Severity
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.observations import Observations
from tests.fgpose.diagnosis.damaged import motion_m, recorded, room
from tests.fgpose.tracking.kinect_people import kinect_people

_DISTANCE_SIGMA = 0.06  # of all joints of an image: that of networks is 0.04
_JOINT_SIGMA_M = 0.12  # of each joint along each axis: that of wrists, the least accurate


@pytest.fixture(scope="module")
def rig() -> CameraRig:
    return room(3, seed=3)


@pytest.fixture(scope="module")
def seen(rig: CameraRig) -> Observations:
    """With 3D of each view, in the world, as inaccurate as that of networks."""
    rng, truth_m = np.random.default_rng(2), motion_m()
    points_m = np.empty((len(truth_m), 3, *truth_m.shape[1:]))
    for c, camera in enumerate(rig.cameras):
        own_m = camera.to_camera_frame(truth_m) * (1 + _DISTANCE_SIGMA * rng.normal(size=(len(truth_m), 1, 1)))
        points_m[:, c] = camera.to_world_frame(own_m + _JOINT_SIGMA_M * rng.normal(size=own_m.shape))
    return replace(recorded(rig, truth_m, seed=3), points3d_m=points_m, covariance3d_m2=None)


def read_as(seen: Observations, rig: CameraRig, how: str, cameras: tuple[int, ...]) -> Observations:
    assert seen.points3d_m is not None
    points_m = seen.points3d_m.copy()
    for c in cameras:
        points_m[:, c] = wrong_m(points_m[:, c], rig.cameras[c], how)
    return replace(seen, points3d_m=points_m)


def wrong_m(points_m: np.ndarray, camera: Camera, how: str) -> np.ndarray:
    if how == "world as camera":
        return camera.to_world_frame(points_m)
    own_m = camera.to_camera_frame(points_m)
    if how == "camera as world":
        return own_m
    factors = {"y up, z back": (1, -1, -1), "m as mm": 0.001, "feet as m": 3.28}
    return camera.to_world_frame(own_m * np.array(factors[how]))


def test_nothing_is_told_of_right_ones(seen, rig) -> None:
    assert foreign_3d(Examined.of(seen, rig)) == []
    alone = rig.subset(["cam2"])
    assert foreign_3d(Examined.of(seen.subset(["cam2"]), alone)) == []


def test_nothing_is_told_of_those_of_depth_cameras() -> None:
    people = kinect_people(20, end_s=4.0)
    associated = associate(people.observations, people.rig)
    assert foreign_3d(Examined.of(associated, people.rig)) == []


@pytest.mark.parametrize(
    ("how", "cause", "remedy"),
    [
        ("world as camera", "frame of the world, read as in that of the camera", "--points3d-frame world"),
        ("camera as world", "frame of the camera, read as in that of the world", "--points3d-frame camera"),
        ("y up, z back", "another frame, or of a camera elsewhere", "--points3d-frame"),
        ("m as mm", "in m, read as mm", "--points3d-unit m "),
        ("feet as m", "another unit", "Multiply them by about 0.2"),
    ],
)
def test_what_they_were_read_as_is_said(seen, rig, how: str, cause: str, remedy: str) -> None:
    (finding,) = foreign_3d(Examined.of(read_as(seen, rig, how, (1,)), rig))
    assert (finding.code, finding.severity, finding.camera) == (Code.PER_VIEW_JOINTS, Severity.WRONG, "cam2")
    assert cause in finding.reason
    assert remedy in finding.remedy


def test_of_all_cameras_it_is_said_once(seen, rig) -> None:
    (finding,) = foreign_3d(Examined.of(read_as(seen, rig, "world as camera", (0, 1, 2)), rig))
    assert finding.camera == ""
    assert "that all cameras alone give are" in finding.reason


def test_one_camera_is_diagnosed(seen, rig) -> None:
    wrong, alone = read_as(seen, rig, "world as camera", (0,)).subset(["cam1"]), rig.subset(["cam1"])
    (finding,) = (each for each in fgpose.diagnose(wrong, alone).findings if each.code is Code.PER_VIEW_JOINTS)
    assert finding.reason.startswith("The 3D joints that cam1 alone gives are ")
    assert Code.PER_VIEW_JOINTS not in {each.code for each in fgpose.diagnose(seen.subset(["cam1"]), alone).findings}
