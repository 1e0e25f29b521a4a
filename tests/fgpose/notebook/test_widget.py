"""Rerun's viewer in a notebook: what is sent to its widget, and what is said where it is not installed."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from rrd_contents import METRE_TOLERANCE, entities, values

import fgpose
from fgpose.notebook import viewer
from fgpose.trajectory import Trajectory
from fgpose_benchmarks.synthetic import Scene

pytestmark = pytest.mark.usefixtures("strict_and_silent")


class Widget:
    """In place of Rerun's, whose package is large."""

    def __init__(self, *, width: str, height: int) -> None:
        self.width, self.height, self.sent = width, height, b""

    def send_rrd(self, data: bytes) -> None:
        self.sent += data


def versions(**installed: str) -> Callable[[str], str]:
    def found(package: str) -> str:
        if package.replace("-", "_") in installed:
            return installed[package.replace("-", "_")]
        raise PackageNotFoundError(package)

    return found


@pytest.fixture
def with_widget(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("rerun_notebook")
    module.__dict__["Viewer"] = Widget
    monkeypatch.setitem(sys.modules, "rerun_notebook", module)
    same = version("rerun-sdk")
    monkeypatch.setattr(viewer, "version", versions(rerun_sdk=same, rerun_notebook=same))


@pytest.fixture(scope="module")
def walk(walking_scene: Scene) -> Trajectory:
    return fgpose.refine(walking_scene.observations.frames(slice(0, 10)), walking_scene.rig)


@pytest.mark.usefixtures("with_widget")
def test_the_widget_gets_the_motion_and_the_cameras(walk: Trajectory, walking_scene: Scene, tmp_path: Path) -> None:
    widget = walk.show(walking_scene.rig, height_px=400)
    assert (widget.width, widget.height) == ("auto", 400)
    path = tmp_path / "sent.rrd"
    path.write_bytes(widget.sent)
    (joints,) = [each for each in entities(path) if each.endswith("/joints") and "trajectory" in each]
    shown = values(path, joints, "Points3D:positions")
    assert len(shown) == 10
    np.testing.assert_allclose(shown[3], walk.positions_m[3], atol=METRE_TOLERANCE)
    assert any(walking_scene.rig.names[0] in each for each in entities(path))
    alone = walk.show()
    assert alone.sent.startswith(b"RRF2")


def test_the_widget_of_rerun_takes_it(walk: Trajectory) -> None:
    widgets = pytest.importorskip("rerun_notebook")
    assert isinstance(walk.show(), widgets.Viewer)


@pytest.mark.usefixtures("with_widget")
def test_nothing_is_not_shown(walk: Trajectory) -> None:
    with pytest.raises(ValueError, match="there is no frame to be shown"):
        walk[:0].show()


def test_what_is_not_installed_is_named(walk: Trajectory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun_notebook", None)
    monkeypatch.setattr(viewer, "version", versions(rerun_sdk="0.41.7"))
    with pytest.raises(ImportError, match=r"notebook widget of Rerun: pip install 'fgpose\[notebook\]'"):
        walk.show()
    monkeypatch.setitem(sys.modules, "rerun_notebook", ModuleType("rerun_notebook"))
    monkeypatch.setattr(viewer, "version", versions(rerun_sdk="0.41.7", rerun_notebook="0.30.0"))
    with pytest.raises(ImportError, match=r"rerun-notebook is 0\.30\.0 and rerun-sdk 0\.41\.7: pip install"):
        walk.show()
    monkeypatch.setattr(viewer, "version", versions())
    with pytest.raises(ImportError, match=r"show\(\) needs Rerun and its widget: pip install 'fgpose\[notebook\]'"):
        walk.show()
