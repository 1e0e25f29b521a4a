"""Intrinsics of cameras whose poses are not known, from the files of others."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tomli_w

import fgpose
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.intrinsics import guessed_intrinsics, is_of_another_size
from fgpose.io.calibration import load_intrinsics, load_rig, save_rig

DATA = Path(__file__).parents[2] / "data"
QCA = DATA / "qualisys" / "Calib.qca.txt"
POSE2SIM = DATA / "qualisys" / "Calib_qualisys.toml"
K = np.array([[900.0, 0.0, 630.0], [0.0, 905.0, 365.0], [0.0, 0.0, 1.0]])
DISTORTION = np.array([-0.1, 0.02, 1e-3, -1e-3, 0.01])
SIZE = (1280, 720)


def same_intrinsics(rig: CameraRig, names: tuple[str, ...], expected: np.ndarray = K) -> bool:
    """Whether all have these, at the origin of their own frames."""
    assert rig.names == names
    return all(
        camera.size_px == SIZE
        and np.array_equal(camera.world_T_camera, np.eye(4))
        # Text files of OpenCV have 16 digits.
        and np.allclose(camera.K, expected, rtol=1e-12)
        and np.allclose(camera.distortion, DISTORTION, rtol=1e-12)
        for camera in rig.cameras
    )


def opencv_file(path: Path, **more: Any) -> Path:
    """As OpenCV's calibration program writes it: YAML or JSON by the extension."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in {"nframes": 20, **more}.items():
        storage.write(key, value)
    storage.write("camera_matrix", K)
    storage.write("distortion_coefficients", DISTORTION[:, None])
    storage.release()
    return path


@pytest.mark.parametrize("name", ["lens.yml", "lens.yaml", "lens.json"])
def test_one_board_of_opencv_is_for_all_cameras(tmp_path: Path, name: str) -> None:
    path = opencv_file(tmp_path / name, image_width=SIZE[0], image_height=SIZE[1])
    assert same_intrinsics(load_intrinsics(path, ["left", "right"]), ("left", "right"))


def test_opencv_s_own_names_of_older_versions_and_a_fisheye(tmp_path: Path) -> None:
    path = tmp_path / "lens.yml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in {"image_Width": 1280, "image_Height": 720, "fisheye_model": 1, "Camera_Matrix": K}.items():
        storage.write(key, value)
    storage.write("Distortion_Coefficients", DISTORTION[:4, None])
    storage.release()
    (camera,) = load_intrinsics(path, ["a"]).cameras
    assert (camera.lens, camera.size_px) == ("fisheye", SIZE)


def test_camera_info_of_ros(tmp_path: Path) -> None:
    path = tmp_path / "ost.yaml"
    path.write_text(
        "image_width: 1280\nimage_height: 720\ncamera_name: narrow\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
        f"  data: {K.ravel().tolist()}\ndistortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n"
        f"  data: {DISTORTION.tolist()}\n"
    )
    assert same_intrinsics(load_intrinsics(path, ["a", "b"]), ("a", "b"))


def test_json_and_npz_of_python_scripts(tmp_path: Path) -> None:
    of_each = {"camera_matrix": K.tolist(), "dist_coeff": [DISTORTION.tolist()], "image_size": list(SIZE)}
    (tmp_path / "lenses.json").write_text(json.dumps({"cam_1": of_each, "cam_2": of_each}))
    # Names of the recording are kept.
    assert same_intrinsics(load_intrinsics(tmp_path / "lenses.json", ["cam2", "cam1"]), ("cam2", "cam1"))
    np.savez(tmp_path / "lens.npz", mtx=K, dist=DISTORTION[None])
    assert same_intrinsics(load_intrinsics(tmp_path / "lens.npz", ["a"], [SIZE]), ("a",))


def test_a_folder_has_a_file_for_each_camera(tmp_path: Path) -> None:
    for name in ("cam1.yml", "cam2.json"):
        opencv_file(tmp_path / name, image_width=SIZE[0], image_height=SIZE[1])
    assert same_intrinsics(load_intrinsics(tmp_path, ["cam_2", "cam_1"]), ("cam_2", "cam_1"))
    with pytest.raises(ValueError, match=r"it has no camera cam_3, only cam1, cam2"):
        load_intrinsics(tmp_path, ["cam_1", "cam_3"])
    (tmp_path / "cam2.json").write_text("{}")
    with pytest.raises(ValueError, match=r"cam2\.json: no intrinsics in it"):
        load_intrinsics(tmp_path, ["cam_1"])


@pytest.mark.parametrize("source", [QCA, POSE2SIM, "npz"])
def test_poses_and_clocks_of_a_calibration_are_dropped(tmp_path: Path, source: Path | str) -> None:
    rig = load_rig(POSE2SIM)
    if source == "npz":
        save_rig(rig.with_time_offsets(np.full(4, 0.1)), tmp_path / "rig.npz")
    path = source if isinstance(source, Path) else tmp_path / "rig.npz"
    found = load_intrinsics(path, ["cam02", "cam_01"])
    assert not found.time_offsets_s.any()
    for camera, of_rig in zip(found.cameras, (rig.cameras[1], rig.cameras[0]), strict=True):
        np.testing.assert_array_equal(camera.world_T_camera, np.eye(4))
        np.testing.assert_allclose(camera.K, of_rig.K, rtol=1e-9)
        # Pose2Sim, which has converted the file of Qualisys, divides these by 64.
        np.testing.assert_allclose(camera.distortion, (64 if source == QCA else 1) * of_rig.distortion, atol=1e-9)


@pytest.mark.parametrize("layout", ["pose2sim", "caliscope", "anipose"])
def test_toml_cameras_without_a_pose(tmp_path: Path, layout: str) -> None:
    """Pose2Sim and caliscope leave rotation and translation out until the extrinsics are calibrated."""
    table = {"size": [1280.0, 720.0], "matrix": K.tolist(), "distortions": DISTORTION.tolist()}
    documents = {
        "pose2sim": {f"int_cam0{n}_img": table | {"name": f"int_cam0{n}_img", "fisheye": False} for n in (1, 2)},
        "caliscope": {"cameras": {"1": table | {"cam_id": 1}, "2": table | {"cam_id": 2}}},
        "anipose": {f"cam_{n}": table | {"name": f"cam0{n}", "rotation": [0.1, 0, 0]} for n in (1, 2)},
    }
    path = tmp_path / "intrinsics.toml"
    path.write_text(tomli_w.dumps(documents[layout]))
    names = ("cam_1", "cam_2") if layout == "caliscope" else ("cam01", "cam02")
    assert same_intrinsics(load_intrinsics(path, names), names)
    with pytest.raises(ValueError, match=r"no rotation and translation|translation is missing|no camera has a pose"):
        load_rig(path)


def test_intri_yml_needs_no_extri_yml(tmp_path: Path) -> None:
    cameras = load_rig(POSE2SIM).subset(["cam_01", "cam_02"])
    save_rig(cameras, tmp_path / "easy", "easymocap")
    (tmp_path / "easy" / "extri.yml").unlink()
    for path in (tmp_path / "easy", tmp_path / "easy" / "intri.yml"):
        found = load_intrinsics(path, ["cam_02"])
        np.testing.assert_allclose(found.cameras[0].K, cameras.cameras[1].K, rtol=1e-12)
        assert found.cameras[0].size_px == (1088, 1920)


@pytest.mark.filterwarnings("default")
def test_images_of_another_size(tmp_path: Path) -> None:
    path = opencv_file(tmp_path / "lens.yml", image_width=SIZE[0], image_height=SIZE[1])
    with pytest.warns(UserWarning, match=r"camera a: .*taken to be resized by 1\.5 x 1\.5"):
        camera = load_intrinsics(path, ["a"], [(1920, 1080)]).cameras[0]
    assert camera.K[0, 0] == pytest.approx(1.5 * K[0, 0])
    with pytest.raises(ValueError, match=r"lens\.yml, camera a: the images are 1000 x 1000"):
        load_intrinsics(path, ["a"], [(1000, 1000)])


def test_a_file_that_does_not_say_for_which_images_it_is(tmp_path: Path) -> None:
    path = opencv_file(tmp_path / "lens.yml")
    assert same_intrinsics(load_intrinsics(path, ["a"], [SIZE]), ("a",))
    with pytest.raises(ValueError, match=r"lens\.yml: camera lens: it does not say .*--size"):
        load_intrinsics(path, ["a"])
    # (630, 365) is the middle of 1280 x 720, not of this.
    with pytest.raises(ValueError, match=r"lens\.yml: .*principal point \(630, 365\) is far from the middle"):
        load_intrinsics(path, ["a"], [(3840, 2160)])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.yml", "", "the file is empty"),
        ("a.yml", "%YAML:1.0\n---\nx: 1\n", "no intrinsics in it"),
        ("a.yml", "%YAML:1.0\n---\nK: [1, 2\n", "damaged"),
        ("a.json", "{", "not JSON"),
        ("a.json", "{" + '"a":{' * 100_000, "not JSON"),
        ("a.json", '{"K": [[1, 0], [0, 1]], "D": []}', "camera a: the camera matrix must have 3 x 3 numbers"),
        ("a.json", '{"K": "x", "size": [1, 2]}', "camera a: 'x' is not a number"),
        ("a.json", '{"K": [[1%s,0,0],[0,1,0],[0,0,1]]}' % ("0" * 400), "camera a: 1000+.* is not a number"),
        ("a.json", '{"K": [[1,0,0],[0,NaN,0],[0,0,1]]}', "camera a: the camera matrix contains a number that is not"),
        ("a.json", '{"K": [[1,0,0],[0,1,0],[0,0,1]], "size": 3}', "camera a: the image size must have 2 numbers"),
        ("a.toml", "x = 1\n", "no intrinsics in it"),
        ("a.toml", "x = [", "no intrinsics, or a damaged file"),
        ("a.bin", "prose", "no intrinsics, or a damaged file"),
    ],
)
def test_a_damaged_file_is_one_clear_error(tmp_path: Path, name: str, content: str, message: str) -> None:
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(ValueError, match=re.escape(f"{path}: ") + f".*{message}"):
        load_intrinsics(path, ["cam1"])


def test_a_folder_without_intrinsics(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no intrinsics in this folder"):
        load_intrinsics(tmp_path, ["cam1"])


def test_guessed_intrinsics() -> None:
    rig = guessed_intrinsics(["a", "b"], [(1920, 1080), (1080, 1920)])
    # Upright and lying images of one camera have the same focal length.
    assert rig.focal_px[0] == rig.focal_px[1] == pytest.approx(0.85 * 1920)
    np.testing.assert_array_equal(rig.cameras[0].K[:2, 2], [959.5, 539.5])
    np.testing.assert_array_equal(rig.cameras[1].world_T_camera, np.eye(4))
    assert guessed_intrinsics(["a"], [(1920, 1080)], 1200.0).focal_px[0] == pytest.approx(1200)
    with pytest.raises(ValueError, match="2 cameras need as many image sizes, got 1"):
        guessed_intrinsics(["a", "b"], [(1920, 1080)])
    with pytest.raises(ValueError, match="the focal length must be a positive number of pixels, got -1"):
        guessed_intrinsics(["a"], [(1920, 1080)], -1.0)


def test_the_guess_is_within_40_per_cent_of_the_recordings_that_come_with_fgpose() -> None:
    for rig in (fgpose.files.load_recording("balance_blazepose")[0], load_rig(POSE2SIM)):
        guess = guessed_intrinsics(rig.names, [camera.size_px for camera in rig.cameras])
        np.testing.assert_allclose(guess.focal_px, rig.focal_px, rtol=0.4)


@pytest.mark.parametrize(
    ("principal_point", "is_of_another"),
    [
        ((959.5, 539.5), False),
        ((1020.0, 560.0), False),  # 3 % of the width
        ((640.0, 360.0), True),  # of 1280 x 720
        ((1439.0, 809.0), True),  # of 2880 x 1620
        ((960.0, 240.0), True),  # of a part of the image
        ((1170.0, 400.0), False),  # aside, but not to the right and down, as a lens with a shift
    ],
)
def test_k_of_another_size(principal_point: tuple[float, float], is_of_another: bool) -> None:
    camera = guessed_intrinsics(["a"], [(1920, 1080)]).cameras[0]
    K = camera.K.copy()
    K[:2, 2] = principal_point
    assert is_of_another_size(replace(camera, K=K)) == is_of_another
