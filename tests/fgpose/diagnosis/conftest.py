"""Somebody who walks before the cameras of each file."""

from __future__ import annotations

import pytest

from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from tests.fgpose.diagnosis.damaged import recorded


@pytest.fixture(scope="module")
def seen(rig: CameraRig) -> Observations:
    return recorded(rig, seed=3)
