"""Rigs in the formats of others, read back by the rules of these others."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.io.calibration import load_rig, save_rig
from fgpose.io.calibration.rig_files import RigFormat

# Through a rotation vector in text: a few units in the last of 16 digits, 1e-12 px at 1000 px.
EXACT_PX = 1e-9
POINTS_M = np.random.default_rng(0).uniform(-1, 1, size=(20, 3))
TOMLS: tuple[RigFormat, ...] = ("pose2sim", "aniposelib", "caliscope")


def made_rig(n_cameras: int = 3, distortion: tuple[float, ...] = (-0.1, 0.02, 1e-3, -1e-3), lens: Any = "pinhole"):
    """Cameras whose names are not in the order of the rig."""
    rotations = Rotation.random(n_cameras, rng=np.random.default_rng(1)).as_matrix()
    K = np.array([[800.0, 0, 400], [0, 810, 300], [0, 0, 1]])
    return CameraRig(
        tuple(
            Camera.from_world_to_camera(
                f"view{n_cameras - c}", (800, 600), K, R, np.array([0.1 * c, -0.2, 5]), distortion, lens
            )
            for c, R in enumerate(rotations)
        )
    )


def path_of(folder: Path, file_format: RigFormat) -> Path:
    return folder / ("rig" if file_format == "easymocap" else "rig.npz" if file_format == "npz" else "rig.toml")


def pixels(K: Any, distortion: Any, rotation: Any, translation: Any, *, fisheye: bool = False) -> np.ndarray:
    """POINTS_M as OpenCV projects them with what stands in a file: world to camera."""
    K, distortion = np.array(K, dtype=float), np.array(distortion, dtype=float).ravel()
    rotation, translation = (np.array(vector, dtype=float).reshape(3, 1) for vector in (rotation, translation))
    project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
    return project(POINTS_M[:, None], rotation, translation, K, distortion)[0][:, 0]


def expected(camera: Camera) -> np.ndarray:
    rotation = Rotation.from_matrix(camera.camera_T_world[:3, :3]).as_rotvec()
    fisheye = camera.lens == "fisheye"
    return pixels(camera.K, camera.distortion, rotation, camera.camera_T_world[:3, 3], fisheye=fisheye)


@pytest.mark.parametrize("file_format", ["npz", "pose2sim", "aniposelib", "caliscope", "easymocap"])
# caliscope, aniposelib, Pose2Sim and EasyMocap give the coefficients to OpenCV, however many they are.
@pytest.mark.parametrize(
    "distortion",
    [
        (),
        (-0.1, 0.02, 1e-3, -1e-3),
        (-0.1, 0.02, 1e-3, -1e-3, 0.01),
        (0.47, -2.5, 8e-4, -2e-4, 1.45, 0.35, -2.33, 1.38),
    ],
)
def test_round_trip(tmp_path: Path, file_format: RigFormat, distortion: tuple[float, ...]) -> None:
    rig, path = made_rig(distortion=distortion), path_of(tmp_path, file_format)
    save_rig(rig, path, file_format)
    loaded = load_rig(path)
    assert loaded.names == rig.names
    for before, after in zip(rig.cameras, loaded.cameras, strict=True):
        assert after.size_px == before.size_px
        np.testing.assert_allclose(expected(after), expected(before), atol=EXACT_PX)
        np.testing.assert_allclose(after.position_m, before.position_m, atol=1e-12)
        if file_format == "npz":
            np.testing.assert_array_equal(after.world_T_camera, before.world_T_camera)


@pytest.mark.parametrize("file_format", TOMLS)
def test_fisheye_and_time_offsets_round_trip(tmp_path: Path, file_format: RigFormat) -> None:
    rig = made_rig(distortion=(0.05, -0.01, 0.002, -0.001), lens="fisheye")
    rig = rig.with_time_offsets(np.array([0.0, 61.25, -0.5]))
    save_rig(rig, tmp_path / "rig.toml", file_format)
    loaded = load_rig(tmp_path / "rig.toml")
    assert {camera.lens for camera in loaded.cameras} == {"fisheye"}
    np.testing.assert_array_equal(loaded.time_offsets_s, rig.time_offsets_s)


def test_aniposelib_reads_it(tmp_path: Path) -> None:
    """CameraGroup.load: the tables but metadata in the order of their texts, and Camera.load_dict what it names."""
    rig = made_rig(12)
    save_rig(rig, tmp_path / "calibration.toml", "aniposelib")
    document = tomllib.loads((tmp_path / "calibration.toml").read_text())
    tables = [document[key] for key in sorted(document) if key != "metadata"]
    assert [table["name"] for table in tables] == list(rig.names)
    for table, camera in zip(tables, rig.cameras, strict=True):
        assert table["size"] == [800, 600]
        assert "fisheye" not in table
        assert len(table["distortions"]) == 5
        found = pixels(table["matrix"], table["distortions"], table["rotation"], table["translation"])
        np.testing.assert_allclose(found, expected(camera), atol=EXACT_PX)


def test_caliscope_reads_it(tmp_path: Path) -> None:
    """CameraArray.from_toml: whole numbers as keys, and what a camera must have."""
    rig = made_rig()
    save_rig(rig, tmp_path / "camera_array.toml", "caliscope")
    cameras = tomllib.loads((tmp_path / "camera_array.toml").read_text())["cameras"]
    assert [int(key) for key in cameras] == [table["cam_id"] for table in cameras.values()] == [0, 1, 2]
    for table, camera in zip(cameras.values(), rig.cameras, strict=True):
        assert (table["ignore"], table["fisheye"], table["rotation_count"]) == (False, False, 0)
        assert np.shape(table["rotation"]) == (3,)
        found = pixels(table["matrix"], table["distortions"], table["rotation"], table["translation"])
        np.testing.assert_allclose(found, expected(camera), atol=EXACT_PX)


def test_pose2sim_reads_it(tmp_path: Path) -> None:
    """retrieve_calib_params: every table but metadata is a camera, in the order of the file."""
    rig = made_rig()
    save_rig(rig, tmp_path / "Calib.toml", "pose2sim")
    document = tomllib.loads((tmp_path / "Calib.toml").read_text())
    tables = [table for name, table in document.items() if name not in ("metadata", "capture_volume")]
    assert [table["name"] for table in tables] == list(rig.names)
    for table, camera in zip(tables, rig.cameras, strict=True):
        assert table["size"] == [800.0, 600.0]
        assert table["fisheye"] is False
        assert len(table["distortions"]) == 4
        found = pixels(table["matrix"], table["distortions"], table["rotation"], table["translation"])
        np.testing.assert_allclose(found, expected(camera), atol=EXACT_PX)


def test_easymocap_reads_it(tmp_path: Path) -> None:
    """read_camera: OpenCV's FileStorage, K, dist (1 x 5), R (Rodrigues), Rot and T of each of the names."""
    rig = made_rig()
    save_rig(rig, tmp_path / "rig", "easymocap")
    assert sorted(file.name for file in (tmp_path / "rig").iterdir()) == ["extri.yml", "intri.yml"]
    intri, extri = (
        cv2.FileStorage(str(tmp_path / "rig" / f), cv2.FILE_STORAGE_READ) for f in ("intri.yml", "extri.yml")
    )
    names = intri.getNode("names")
    assert [names.at(n).string() for n in range(names.size())] == list(rig.names)
    for camera in rig.cameras:
        name = camera.name
        assert (intri.getNode(f"W_{name}").real(), intri.getNode(f"H_{name}").real()) == (800, 600)
        dist = intri.getNode(f"dist_{name}").mat()
        rotation, translation = extri.getNode(f"R_{name}").mat(), extri.getNode(f"T_{name}").mat()
        assert (dist.shape, rotation.shape, translation.shape) == ((1, 5), (3, 1), (3, 1))
        np.testing.assert_allclose(cv2.Rodrigues(rotation)[0], extri.getNode(f"Rot_{name}").mat(), atol=1e-12)
        found = pixels(intri.getNode(f"K_{name}").mat(), dist, rotation, translation)
        np.testing.assert_allclose(found, expected(camera), atol=EXACT_PX)


@pytest.mark.filterwarnings("default")
def test_easymocap_has_no_time_offsets(tmp_path: Path) -> None:
    rig = made_rig().with_time_offsets(np.array([0.0, 0.25, 0.0]))
    with pytest.warns(UserWarning, match=r"no time offsets; left out: view2 0\.2500 s"):
        save_rig(rig, tmp_path / "rig", "easymocap")
    assert not load_rig(tmp_path / "rig").time_offsets_s.any()


def test_what_easymocap_cannot_hold(tmp_path: Path) -> None:
    fisheye = made_rig(distortion=(0.05, -0.01, 0.002, -0.001), lens="fisheye")
    with pytest.raises(ValueError, match="rig: camera view3: EasyMocap's format has no fisheye lens"):
        save_rig(fisheye, tmp_path / "rig", "easymocap")
    camera = made_rig(1).cameras[0]
    spaced = CameraRig((Camera("my camera", camera.size_px, camera.K, camera.world_T_camera, camera.distortion),))
    with pytest.raises(ValueError, match="camera my camera: in EasyMocap's format a name has letters"):
        save_rig(spaced, tmp_path / "rig", "easymocap")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "file_format", "message"),
    [
        ("rig.yml", "auto", r"rig\.yml: a rig is written as \.npz or \.toml; for other formats name it"),
        ("rig.npz", "caliscope", r"rig\.npz: caliscope is written into a \.toml file"),
        ("rig.toml", "easymocap", r"rig\.toml: easymocap is written into a folder with two files"),
        ("rig.toml", "npz", r"rig\.toml: npz is written into a \.npz file"),
    ],
)
def test_an_extension_that_does_not_fit_the_format(tmp_path: Path, name: str, file_format: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        save_rig(made_rig(), tmp_path / name, file_format)
