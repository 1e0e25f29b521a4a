"""Recordings of several people as files and for live viewers: read back without a viewer, a window or a browser."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rrd_contents import entities, rows, values, view_origins
from shown_people import CAMERAS, SECOND, SECOND_FRAMES, SHOWN, SKELETON

from fgpose.association.recording import Association
from fgpose.geometry.camera import CameraRig
from fgpose.io.skeletons import load_skeleton
from fgpose.trajectory import Trajectory
from fgpose.viewer import Recording, open_people_recording

pytest.importorskip("rerun")
pytestmark = pytest.mark.usefixtures("strict_and_silent")


def test_layout_shows_whoever_comes(file: Path) -> None:
    origins = view_origins(file)
    assert origins["2D"] == {f"/world/camera/{name}/image" for name in CAMERAS} | {"/legend/cameras"}
    assert origins["3D"] == {"/world"}
    assert origins["TextLog"] == {"/events"}
    assert origins["StateTimeline"] == {"/tracks", "/status"}
    assert origins["TimeSeries"] == {"/plots/reprojection_px", "/plots/people", "/plots/unused"}
    shown = entities(file) | {"/legend/cameras"}
    for where in set().union(*origins.values()):
        assert any(entity == where or entity.startswith(f"{where}/") for entity in shown), where


def test_live_file_is_the_same_although_nobody_watches(
    tmp_path: Path, rig: CameraRig, association: Association, second: Trajectory, file: Path
) -> None:
    path = tmp_path / "live.rrd"
    with open_people_recording(path, rig, SKELETON, live=True, port=0) as recording:
        assert recording.viewer_url is not None
        assert "127.0.0.1" in recording.viewer_url
        recording.log_association(association)
        recording.log_person(SECOND, second, SECOND_FRAMES.start)
    assert recording.viewer_url is None
    for entity, component in (*SHOWN, ("/world/camera/cam_2/image/detections", "Points2D:class_ids")):
        assert rows(path, entity, component) == rows(file, entity, component)


def test_the_file_appears_whole_or_not_at_all(tmp_path: Path, rig: CameraRig, second: Trajectory) -> None:
    path = tmp_path / "out.rrd"
    path.write_bytes(b"old")

    def interrupted_by(error: BaseException) -> None:
        with open_people_recording(path, rig, SKELETON) as recording:
            recording.log_person(SECOND, second)
            raise error

    with pytest.raises(ZeroDivisionError):
        interrupted_by(ZeroDivisionError())
    assert path.read_bytes() == b"old"
    assert [file.name for file in tmp_path.iterdir() if file.is_file()] == ["out.rrd"]
    # Ctrl-C is how a live session ends.
    with pytest.raises(KeyboardInterrupt):
        interrupted_by(KeyboardInterrupt())
    assert len(values(path, *SHOWN[0])) == second.n_frames
    assert [file.name for file in tmp_path.iterdir() if file.is_file()] == ["out.rrd"]


def test_bad_input_is_refused(tmp_path: Path, rig: CameraRig, association: Association, second: Trajectory) -> None:
    options: dict[str, Any] = {"image_width_px": 0, "jpeg_quality": 101, "image_limit_mb": -1.0, "n_frames": 0}
    for name, value in options.items():
        with pytest.raises(ValueError, match=f"{name} must be .* got {value}"):
            open_people_recording(None, rig, SKELETON, **{name: value})
    with open_people_recording(tmp_path / "a.rrd", rig.subset(["cam_2"]), SKELETON) as recording:
        with pytest.raises(ValueError, match="the calibration has no camera cam 1"):
            recording.log_association(association)
        with pytest.raises(ValueError, match="the calibration has no camera cam 1"):
            recording.log_person(SECOND, second)
        with pytest.raises(ValueError, match="counted from 0, got person -1 from frame 0 on"):
            recording.log_person(-1, second)
        with pytest.raises(ValueError, match="counted from 0, got person 5 from frame -2 on"):
            recording.log_person(SECOND, second, -2)
        nothing = Trajectory(SKELETON, np.zeros(0), np.zeros((0, 17, 3)), np.zeros((0, 17)))
        with pytest.raises(ValueError, match="the trajectory of person 5 has no frame"):
            recording.log_person(SECOND, nothing)
    with pytest.raises(ValueError, match="closed"):
        recording.log_person(SECOND, replace(second, residual_px=None))
    with open_people_recording(tmp_path / "b.rrd", rig, load_skeleton("h36m_17")) as recording:
        with pytest.raises(ValueError, match="the association has the joints of skeleton coco_17"):
            recording.log_association(association)
        with pytest.raises(ValueError, match="person 5 has the joints of skeleton coco_17"):
            recording.log_person(SECOND, second)
    # Nothing of what was refused is shown.
    assert not [each for name in ("a.rrd", "b.rrd") for each in entities(tmp_path / name) if each.startswith("/world")]


def test_recording_to_nowhere_takes_everything(rig: CameraRig, association: Association, second: Trajectory) -> None:
    with open_people_recording(None, rig, SKELETON) as recording:
        assert type(recording) is Recording
        recording.log_association(association)
        recording.log_person(SECOND, second, SECOND_FRAMES.start)
        assert not recording.wants_image("cam_2", 0)
        recording.log_image("cam_2", 0, 0.0, np.zeros((480, 640, 3), dtype=np.uint8))
