"""Recordings of one person and of several, which the tests of the viewer share."""

from __future__ import annotations

from pathlib import Path

import pytest
from rrd_contents import camera
from shown_people import (
    SECOND,
    SECOND_FRAMES,
    SKELETON,
    Update,
    association_of,
    first_person,
    second_person,
    updates_of,
)

from fgpose.association.recording import Association
from fgpose.geometry.camera import CameraRig
from fgpose.trajectory import Trajectory
from fgpose.viewer import open_people_recording


@pytest.fixture(scope="module")
def rig() -> CameraRig:
    return CameraRig((camera("cam 1", -0.5), camera("cam_2", 0.5)))


@pytest.fixture(scope="module")
def association(rig: CameraRig) -> Association:
    return association_of(rig)


@pytest.fixture(scope="module")
def second(rig: CameraRig) -> Trajectory:
    return second_person(rig)


@pytest.fixture(scope="module")
def first() -> Trajectory:
    return first_person()


@pytest.fixture(scope="module")
def updates(association: Association, first: Trajectory, second: Trajectory) -> list[Update]:
    return updates_of(association, first, second)


@pytest.fixture(scope="module")
def file(
    tmp_path_factory: pytest.TempPathFactory, rig: CameraRig, association: Association, second: Trajectory
) -> Path:
    path = tmp_path_factory.mktemp("people") / "people.rrd"
    with open_people_recording(path, rig, SKELETON) as recording:
        assert not path.exists()
        recording.log_association(association)
        recording.log_person(SECOND, second, SECOND_FRAMES.start)
    return path
