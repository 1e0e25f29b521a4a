"""Which camera has which source."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgpose.geometry.camera import CameraRig
from fgpose.geometry.changing_rig import is_changing
from fgpose.io.calibration import load_rig, save_rig
from fgpose.live.cameras.rig_file import load_live_rig
from fgpose.live.sources import CameraSource


@pytest.fixture
def calibration(rig: CameraRig, tmp_path: Path) -> Path:
    """Of two cameras."""
    save_rig(rig.subset(rig.names[:2]), tmp_path / "Calib.toml")
    return tmp_path / "Calib.toml"


def tables(names: tuple[str, ...], keys: str = "") -> str:
    return "".join(f'[cameras."{name}"]\nsource = "{name}.mp4"\n{keys}\n' for name in names)


def test_sources_beside_a_calibration_of_any_format(rig: CameraRig, calibration: Path, tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text('[live]\ncalibration = "Calib.toml"\n' + tables(rig.names[:2], 'fps = 25\npace = "fast"'))
    live_rig = load_live_rig(path)
    assert live_rig.rig.names == tuple(live_rig.sources) == rig.names[:2]
    source = str(tmp_path / f"{rig.names[0]}.mp4")
    assert live_rig.sources[rig.names[0]] == CameraSource(source=source, fps=25.0, pace="fast")


def test_sources_in_the_calibration_itself(rig: CameraRig, calibration: Path, tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(calibration.read_text() + tables(rig.names[:2]))
    live_rig = load_live_rig(path)
    assert live_rig.rig.names == rig.names[:2]
    assert load_rig(path).names == rig.names[:2]  # every other command can use the file too


def test_starts_of_videos_that_are_no_start_s_are_warned_of(rig: CameraRig, tmp_path: Path) -> None:
    two = rig.subset(rig.names[:2])
    save_rig(two.with_time_offsets(np.array([0.0, 1.3])), tmp_path / "Calib.toml")
    path = tmp_path / "rig.toml"
    path.write_text('[live]\ncalibration = "Calib.toml"\n' + tables(two.names))
    with pytest.warns(UserWarning, match=f"{two.names[1]} takes images 1.3 s later than {two.names[0]} .* or nobody"):
        load_live_rig(path)
    save_rig(two.with_time_offsets(np.array([0.0, 0.1])), tmp_path / "Calib.toml")
    with pytest.warns(UserWarning, match=f"by the time offsets of {re.escape(str(path))}, "):
        load_live_rig(path)


def test_sources_in_the_tables_of_caliscope(tmp_path: Path) -> None:
    camera = "size = [640, 480]\nmatrix = [[500, 0, 320], [0, 500, 240], [0, 0, 1]]\ndistortions = [0, 0, 0, 0, 0]\n"
    pose = "rotation = [0.1, 0.2, 0.3]\ntranslation = [{}, 0.0, 3.0]\n"
    path = tmp_path / "rig.toml"
    path.write_text(
        "".join(f'[cameras.{k}]\nport = {k}\nsource = "/dev/video{k}"\n{camera}{pose.format(k)}' for k in range(2))
    )
    live_rig = load_live_rig(path)
    assert {name: settings.source for name, settings in live_rig.sources.items()} == {
        "cam_0": "/dev/video0",
        "cam_1": "/dev/video1",
    }


def test_passwords_come_from_the_environment(
    rig: CameraRig, calibration: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "rig.toml"
    sources = tables(rig.names[:2]).replace(f"{rig.names[0]}.mp4", "rtsp://viewer:${FGPOSE_CAMERA_PASSWORD}@10.0.0.2/a")
    path.write_text('[live]\ncalibration = "Calib.toml"\n' + sources)
    with pytest.raises(
        ValueError, match=f"camera {rig.names[0]}: the environment variable FGPOSE_CAMERA_PASSWORD is not set"
    ):
        load_live_rig(path)
    monkeypatch.setenv("FGPOSE_CAMERA_PASSWORD", "hunter2")
    live_rig = load_live_rig(path)
    assert live_rig.sources[rig.names[0]].source == "rtsp://viewer:hunter2@10.0.0.2/a"
    assert "hunter2" not in repr(live_rig)


@pytest.mark.parametrize("address", ["rtsp:/viewer:hunter2@10.0.0.2/a", "viewer:hunter2@10.0.0.2/a"])
def test_a_mistyped_address_is_named_without_its_password(
    address: str, rig: CameraRig, calibration: Path, tmp_path: Path
) -> None:
    """It would be taken for a file, whose name is in every message."""
    path = tmp_path / "rig.toml"
    sources = tables(rig.names[:2]).replace(f"{rig.names[0]}.mp4", address)
    path.write_text('[live]\ncalibration = "Calib.toml"\n' + sources)
    with pytest.raises(ValueError, match=f"camera {rig.names[0]}: .* an address is written rtsp://") as error:
        load_live_rig(path)
    assert "hunter2" not in str(error.value)


BAD = {
    "no sources": (lambda a, b: "", "there are no sources"),
    "a camera without a source": (lambda a, b: tables((a,)), "camera {b} of the rig has no source"),
    "a source without a camera": (lambda a, b: tables((a, b, "roof")), "the source of roof has no camera; the rig has"),
    "two cameras with one name": (lambda a, b: tables((a, b, a)), "'{a}'"),
    "two cameras named alike": (
        lambda a, b: tables((a, b)) + f'[cameras.other]\nname = "{a}"\nsource = "x.mp4"\n',
        "two cameras are named {a}",
    ),
    "no source in a table": (
        lambda a, b: tables((a,)) + f'[cameras."{b}"]\nfps = 5\n',
        "camera {b}: source is missing",
    ),
    "an unknown key": (lambda a, b: tables((a, b), "lop = true"), "camera {a}: unknown key lop; did you mean loop?"),
    "a value of a wrong kind": (lambda a, b: tables((a, b), 'fps = "many"'), "camera {a}: fps must be a float"),
    "a pace that is none": (lambda a, b: tables((a, b), 'pace = "slow"'), "camera {a}: pace must be one of real time"),
    "no table": (lambda a, b: f'[cameras]\n"{a}" = 3\n', "cameras.{a} is a table"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_one_clear_error(name: str, rig: CameraRig, calibration: Path, tmp_path: Path) -> None:
    text, message = BAD[name]
    a, b = rig.names[:2]
    path = tmp_path / "rig.toml"
    path.write_text('[live]\ncalibration = "Calib.toml"\n' + text(a, b))
    with pytest.raises(ValueError, match=r"rig\.toml: ") as error:
        load_live_rig(path)
    assert message.format(a=a, b=b) in str(error.value)
    assert "\n" not in str(error.value)


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"rig\.toml"):
        load_live_rig(tmp_path / "rig.toml")
    (tmp_path / "rig.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match=r"rig\.toml: "):
        load_live_rig(tmp_path / "rig.toml")


@pytest.mark.parametrize("suffix", ["toml", "npz"])
def test_which_recording_a_rig_was_found_from_changes_nothing(tmp_path: Path, rig: CameraRig, suffix: str) -> None:
    """Its starts, its rate, its lost images: live, they would put together images of different moments. How late a
    camera is stays."""
    late_s, starts_s = np.array([0.0, 0.02, 0.0, -0.01]), np.array([0.0, 1.3, -0.8, 2.1])
    begun = rig.with_starts(starts_s)
    begun = begun.with_time_offsets(begun.time_offsets_s + late_s)
    moved = replace(begun.cameras[1], world_T_camera=np.eye(4), moves=((3.0, rig.cameras[1].world_T_camera),))
    lossy = replace(begun.cameras[2], clock_drift=1e-3, clock_jumps=((2.0, 0.2),))
    recorded = CameraRig((begun.cameras[0], moved, lossy, begun.cameras[3]))
    save_rig(recorded, tmp_path / f"calibration.{suffix}")
    live = f'[live]\ncalibration = "calibration.{suffix}"\n' + "".join(
        f'[cameras.{name}]\nsource = "zmq"\n' for name in rig.names
    )
    (tmp_path / "live.toml").write_text(live)
    read = load_live_rig(tmp_path / "live.toml").rig
    np.testing.assert_allclose(read.time_offsets_s, late_s, atol=1e-12)
    assert not is_changing(read)
    assert not any(camera.start_s for camera in read.cameras)
    for camera, still in zip(read.cameras, rig.cameras, strict=True):
        np.testing.assert_allclose(camera.world_T_camera, still.world_T_camera, atol=1e-9)
