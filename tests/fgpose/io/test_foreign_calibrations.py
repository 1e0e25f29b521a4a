"""Calibrations of other programs, each with a known camera that it must give back."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.io.calibration import load_intrinsics, load_rig
from fgpose_benchmarks.synthetic import ring_rig

DISTORTION = np.array([-0.1, 0.03, 0.0, 0.0, 0.002])
QCA = Path(__file__).parents[2] / "data" / "qualisys" / "Calib.qca.txt"


@pytest.fixture
def rig() -> CameraRig:
    cameras = ring_rig(3).cameras
    return CameraRig(
        tuple(
            Camera(
                f"cam{n}",
                (1920, 1080),
                np.array([[1500.0 + n, 0, 955], [0, 1500.0 + n, 548], [0, 0, 1]]),
                each,
                DISTORTION,
            )
            for n, each in enumerate(camera.world_T_camera for camera in cameras)
        )
    )


def assert_same(found: CameraRig, rig: CameraRig, tolerance: float = 1e-9) -> None:
    assert found.names == rig.names
    for camera, true in zip(found.cameras, rig.cameras, strict=True):
        assert camera.size_px == true.size_px
        # Texts with all digits.
        np.testing.assert_allclose(camera.K, true.K, rtol=tolerance, atol=tolerance)
        np.testing.assert_allclose(camera.world_T_camera, true.world_T_camera, atol=tolerance)
        np.testing.assert_allclose(camera.distortion, true.distortion, atol=tolerance)


def xcp(rig: CameraRig, radial: str = "ViconRadial2 955 548 {0} {1} {4}") -> str:
    lines = ['<?xml version="1.0" encoding="UTF-8" standalone="no" ?>', '<Cameras SOURCE="Nexus 2.16" VERSION="2.0">']
    lines.append('<Camera DEVICEID="2100001" TYPE="Vero" DISPLAY_TYPE="Vero" SENSOR_SIZE="2048 1088"/>')
    for camera in rig.cameras:
        quaternion = Rotation.from_matrix(camera.camera_T_world[:3, :3]).as_quat().tolist()
        numbers = {
            "FOCAL_LENGTH": [camera.K[0, 0]],
            "PRINCIPAL_POINT": camera.K[:2, 2].tolist(),
            "ORIENTATION": quaternion,
            "POSITION": (1000 * camera.position_m).tolist(),
        }
        texts = " ".join(f'{name}="{" ".join(map(repr, map(float, value)))}"' for name, value in numbers.items())
        texts += f' VICON_RADIAL2="{radial.format(*DISTORTION)}" WORLD_ERROR="0.1"'
        size = "{} {}".format(*camera.size_px)
        head = f'DEVICEID="{camera.name}" TYPE="VideoCamera" PIXEL_ASPECT_RATIO="1" SENSOR_SIZE="{size}"'
        lines.append(f"<Camera {head}><KeyFrames><KeyFrame {texts}/></KeyFrames></Camera>")
    return "\n".join([*lines, "</Cameras>"])


@pytest.mark.parametrize("radial", ["ViconRadial2 955 548 {0} {1} {4}", "955 548 {0} {1} {4}"])
def test_vicon_xcp(rig: CameraRig, tmp_path: Path, radial: str) -> None:
    path = tmp_path / "trial.xcp"
    path.write_text(xcp(rig, radial))
    assert_same(load_rig(path), rig)
    assert load_intrinsics(path, ["cam1"]).cameras[0].size_px == (1920, 1080)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("ORIENTATION", "OTHER", "camera cam0: ORIENTATION must have 4 numbers, but is None"),
        (
            'SENSOR_SIZE="1920 1080"',
            'SENSOR_SIZE="1920 ?"',
            r"camera cam0: SENSOR_SIZE has something that is no number",
        ),
        ("KeyFrame ", "Frame ", "camera cam0: it has no KeyFrame"),
        ("<Camera ", "<Device ", "truncated"),
    ],
)
def test_a_damaged_xcp_is_refused_by_camera(rig: CameraRig, tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "trial.xcp"
    path.write_text(xcp(rig).replace(old, new))
    with pytest.raises(ValueError, match=rf"trial\.xcp: .*{message}"):
        load_rig(path)


def opencap(camera: Camera, size: list[list[int]]) -> dict[str, Any]:
    return {
        "distortion": DISTORTION[None],
        "intrinsicMat": camera.K,
        "imageSize": np.array(size),
        "rotation": camera.camera_T_world[:3, :3],
        "translation": 1000 * camera.camera_T_world[:3, 3:],
    }


@pytest.mark.parametrize("size", [[[1080], [1920]], [[1920], [1080]]], ids=["height first", "width first"])
def test_opencap_pickles(rig: CameraRig, tmp_path: Path, size: list[list[int]]) -> None:
    for camera in rig.cameras:
        folder = tmp_path / "Videos" / camera.name
        folder.mkdir(parents=True)
        with (folder / "cameraIntrinsicsExtrinsics.pickle").open("wb") as file:
            pickle.dump(opencap(camera, size), file)
    for path in (tmp_path, tmp_path / "Videos", tmp_path / "Videos" / "cam1" / "cameraIntrinsicsExtrinsics.pickle"):
        assert_same(load_rig(path), rig)
    assert load_intrinsics(tmp_path, rig.names).names == rig.names


class Harmful:
    def __reduce__(self) -> tuple[Any, ...]:
        return print, ("this must not run",)


def test_a_pickle_that_would_run_something_does_not(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "cameraIntrinsicsExtrinsics.pickle"
    path.write_bytes(pickle.dumps({"intrinsicMat": Harmful()}))
    with pytest.raises(ValueError, match=r"pickle: .*not safe to load.*builtins\.print"):
        load_rig(path)
    path.write_bytes(pickle.dumps({"weights": np.zeros(3)}))
    with pytest.raises(ValueError, match=r"a pickle, but none of OpenCap's cameras: intrinsicMat, .* is missing"):
        load_rig(path)
    assert not capsys.readouterr().out


def test_biocv_files_of_one_folder_are_one_rig(rig: CameraRig, tmp_path: Path) -> None:
    for camera in rig.cameras:
        pose = camera.camera_T_world.copy()
        pose[:3, 3] *= 1000
        rows = [[1920], [1080], *camera.K.tolist(), [], *pose.tolist(), [], DISTORTION.tolist()]
        (tmp_path / f"{camera.name}.mp4.calib").write_text("\n".join(" ".join(map(repr, row)) for row in rows) + "\n")
    assert_same(load_rig(tmp_path), rig)
    assert_same(load_rig(tmp_path / "cam1.mp4.calib"), rig)
    (tmp_path / "cam2.mp4.calib").write_text("1920\n1080\n1 2 three\n")
    with pytest.raises(ValueError, match=r"camera cam2: cam2\.mp4\.calib is not an array of numbers"):
        load_rig(tmp_path)


def json_table(camera: Camera, scale: float = 1.0) -> dict[str, Any]:
    camera_T_world = camera.camera_T_world
    pose = {"R": camera_T_world[:3, :3].tolist(), "t": (scale * camera_T_world[:3, 3]).tolist()}
    return {"K": camera.K.tolist(), "dist": DISTORTION.tolist(), **pose, "imgSize": list(camera.size_px)}


def test_json_with_a_table_for_each_camera(rig: CameraRig, tmp_path: Path) -> None:
    path = tmp_path / "rig.json"
    tables = {camera.name: json_table(camera) for camera in rig.cameras}
    as_list = [{"name": name, **table} for name, table in tables.items()]
    millimetres = [{"name": camera.name, **json_table(camera, 1000)} for camera in rig.cameras]
    for document in (tables, as_list, {"cameras": as_list}, {"cameras": tables}, millimetres):
        path.write_text(json.dumps(document))
        assert_same(load_rig(path), rig)
    metrabs = {
        camera.name: {
            "intrinsic_matrix": camera.K.tolist(),
            "extrinsic_matrix": camera.camera_T_world.tolist(),
            "distortion_coeffs": DISTORTION.tolist(),
            "size": [1920, 1080],
        }
        for camera in rig.cameras
    }
    path.write_text(json.dumps(metrabs))
    assert_same(load_rig(path), rig)


def test_incomplete_json_says_what_it_needs(rig: CameraRig, tmp_path: Path) -> None:
    path, table = tmp_path / "rig.json", json_table(rig.cameras[0])
    path.write_text(json.dumps({"cam0": {key: value for key, value in table.items() if key != "imgSize"}}))
    with pytest.raises(ValueError, match=r"rig\.json: camera cam0: the size of its images is missing; add it"):
        load_rig(path)
    path.write_text(json.dumps({"cam0": {"K": table["K"]}}))
    with pytest.raises(ValueError, match=r"no camera with a pose in it: .* K, dist, R, t"):
        load_rig(path)


def qca(tmp_path: Path, *changes: tuple[str, str]) -> Path:
    text = QCA.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "Calib.qca.txt"
    path.write_text(text)
    return path


def test_qualisys_hybrid_cameras_take_videos(tmp_path: Path) -> None:
    path = qca(tmp_path, ('model="none"', 'model="Miqus Hybrid"'))
    text = path.read_text()
    marker = text[text.index("<camera ") : text.index("</camera>") + 9].replace("Miqus Hybrid", "Arqus A12")
    path.write_text(text.replace("<cameras>", f"<cameras>{marker.replace('cam01', '99001')}"))
    assert load_rig(path).names == ("cam01", "cam02", "cam03", "cam04")


def test_qualisys_images_smaller_than_the_sensor(tmp_path: Path) -> None:
    """The sensor has 1088 lines, which are called 1080p; 540p has half of them, over the whole field."""
    whole = load_rig(QCA)
    assert_same(load_rig(qca(tmp_path, ('viewrotation="0"', 'viewrotation="0" video_resolution="1080p"'))), whole)
    path = qca(tmp_path, ('viewrotation="0"', 'viewrotation="0" video_resolution="540p"'))
    with pytest.warns(UserWarning, match="smaller than the sensor.*cam01 544x960"):
        half = load_rig(path)
    for camera, true in zip(half.cameras, whole.cameras, strict=True):
        assert camera.size_px == (544, 960)
        np.testing.assert_allclose(camera.K[:2], true.K[:2] / 2)
        assert camera.K[2, 2] == 1.0
        np.testing.assert_array_equal(camera.distortion, true.distortion)


def test_qualisys_decimal_commas(tmp_path: Path) -> None:
    import re

    path = tmp_path / "Calib.qca.txt"
    path.write_text(re.sub(r'="(-?\d+)\.(\d+)"', r'="\1,\2"', QCA.read_text()))
    assert '"-0,046183"' in path.read_text()
    assert_same(load_rig(path), load_rig(QCA))
