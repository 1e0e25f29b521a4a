"""Lenses and poses under the names that other programs give them; what is not read is an error, never a guess."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.io.calibration import load_intrinsics, load_rig
from fgpose_benchmarks.synthetic import ring_rig

COEFFICIENTS = [-0.1, 0.03, 0.001, -0.002, 0.002]
NAMED = dict(zip(("k1", "k2", "p1", "p2", "k3"), COEFFICIENTS, strict=True))
K = np.array([[1500.0, 0, 955], [0, 1510, 548], [0, 0, 1]])
POSES = [camera.camera_T_world for camera in ring_rig(2).cameras]


def table(number: int, **more: Any) -> dict[str, Any]:
    """Of a camera without its distortion."""
    pose = POSES[number]
    return {"K": K.tolist(), "R": pose[:3, :3].tolist(), "t": pose[:3, 3].tolist(), "size": [1920, 1080], **more}


def written(tmp_path: Path, document: Any, name: str = "rig.json") -> Path:
    path = tmp_path / name
    path.write_text(json.dumps(document))
    return path


def of_both(tmp_path: Path, *without: str, **more: Any) -> CameraRig:
    """Two cameras that have the same entries."""
    tables = {f"cam{n}": {k: v for k, v in table(n, **more).items() if k not in without} for n in (0, 1)}
    return load_rig(written(tmp_path, tables))


def lens_of(camera: Camera) -> tuple[str, list[float]]:
    return camera.lens, camera.distortion.tolist()


@pytest.mark.parametrize(
    "stated",
    [
        *({name: COEFFICIENTS} for name in ("dist", "kc", "distortion_params", "distortion-coefficients")),
        {"lens distortion": COEFFICIENTS},
        {"distortion": NAMED},
        NAMED,
        {"dist": [*COEFFICIENTS, *[0.0] * 7]},
        {"dist": [*COEFFICIENTS, *[0.0] * 9]},
        {"intrinsics": {"dist": COEFFICIENTS}},
    ],
    ids=str,
)
def test_a_distortion_is_read_under_any_of_its_names(tmp_path: Path, stated: dict[str, Any]) -> None:
    assert lens_of(of_both(tmp_path, **stated).cameras[1]) == ("pinhole", COEFFICIENTS)


def test_the_eight_of_the_rational_model_by_name_and_among_fourteen(tmp_path: Path) -> None:
    eight = [*COEFFICIENTS, 0.1, 0.2, 0.3]
    assert lens_of(of_both(tmp_path, **NAMED, k4=0.1, k5=0.2, k6=0.3).cameras[0]) == ("pinhole", eight)
    assert lens_of(of_both(tmp_path, dist=[*eight, *[0.0] * 6]).cameras[0]) == ("pinhole", eight)


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ({"Lens dist": COEFFICIENTS}, "Lens dist looks like a distortion .* and is not read"),
        ({"radial_distortion": [0.1, 0.2]}, "radial_distortion looks like a distortion"),
        ({"dist": [0.0] * 4, "k1": 0.1}, "dist and k1 are more than one distortion"),
        ({"distortion": {"k1": 0.1, "model": "x"}}, "model is no coefficient of a pinhole lens"),
        ({"dist": [*COEFFICIENTS, 0, 0, 0, 0.001, 0, 0, 0]}, "thin prisms and tilted sensors.* are not supported"),
        ({"dist": [], "distortion_model": "fov"}, "distortion_model 'fov' is no lens that is known"),
        ({"dist": [], "model": "omni"}, "model 'omni' is no lens that is known"),
        ({"dist": [], "fisheye": "maybe"}, "fisheye 'maybe' is no lens that is known"),
        ({"dist": [0.0] * 4, "model": "fisheye", "distortion_model": "plumb_bob"}, "contradict each other"),
        ({"dist": [], "intrinsics": {"K": K.tolist()}}, "K is given twice"),
        ({"dist": [], "t": None}, "it has a rotation, and no translation"),
        ({"dist": [], "extrinsics": POSES[0].T.tolist()}, "the last row .* is not 0 0 0 1: it is transposed"),
        ({"dist": [], "K": np.diag([8.0, 8.0, 1.0]).tolist()}, "a focal length of 8 for images 1920 px wide is not in"),
    ],
    ids=str,
)
def test_what_is_not_understood_names_file_camera_and_key(tmp_path: Path, stated: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=rf"rig\.json: camera cam0: .*{message}"):
        of_both(tmp_path, **stated)


@pytest.mark.parametrize("key", ["model", "camera_model", "lens", "lens_model", "type", "distortion_model"])
@pytest.mark.parametrize(
    ("value", "lens"),
    [
        *((name, "fisheye") for name in ("fisheye", "equidistant", "equi", "kannala_brandt4", "OPENCV_FISHEYE", "KB4")),
        *((name, "pinhole") for name in ("plumb_bob", "radtan", "rational_polynomial", "perspective", "brown-conrady")),
    ],
)
def test_a_lens_is_what_it_is_called(tmp_path: Path, key: str, value: str, lens: str) -> None:
    assert of_both(tmp_path, dist=[0.05, -0.01, 0.004, -0.001], **{key: value}).cameras[0].lens == lens


def test_a_flag_says_that_it_is_a_fisheye_and_a_device_says_nothing(tmp_path: Path) -> None:
    four: Any = [0.05, -0.01, 0.004, -0.001]
    assert of_both(tmp_path, dist=four, is_fisheye=True).cameras[0].lens == "fisheye"
    assert of_both(tmp_path, dist=four, fisheye=False, type="hd", model="GoPro HERO 9").cameras[0].lens == "pinhole"
    assert lens_of(of_both(tmp_path, **NAMED | {"p1": 0, "p2": 0}).cameras[0])[0] == "pinhole"


def test_silence_about_distortion_is_said_once_and_none_that_is_stated_is_not(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match=r"rig\.json: nothing is said of the distortion of cam0, cam1") as caught:
        of_both(tmp_path)
    assert len(caught) == 1
    path = written(tmp_path, {"K": K.tolist(), "size": [1920, 1080]}, "lens.json")
    with pytest.warns(UserWarning, match=r"lens\.json: nothing is said of the distortion of lens"):
        load_intrinsics(path, ["a"])
    for none in ([], [0.0] * 5):
        of_both(tmp_path, dist=none)


def test_focal_lengths_and_centre_by_name(tmp_path: Path) -> None:
    four = {"fx": 1500.0, "fy": 1510.0, "cx": 955.0, "cy": 548.0}
    for stated in (four, {"intrinsics": four}, {"intrinsics": list(four.values())}):
        assert of_both(tmp_path, "K", dist=[], **stated).cameras[1].K.tolist() == K.tolist()


def test_a_camera_without_a_pose_is_left_out_with_a_warning(tmp_path: Path) -> None:
    path = written(tmp_path, {"cam0": table(0, dist=[]), "cam1": table(1, dist=[]) | {"R": None}})
    with pytest.warns(UserWarning, match=r"rig\.json: cam1 left out: no pose"):
        assert load_rig(path).names == ("cam0",)


def test_a_camera_that_is_in_it_twice_is_an_error(tmp_path: Path) -> None:
    path, own = tmp_path / "rig.json", json.dumps(table(0, dist=[]))
    path.write_text(f'{{"cam0": {own}, "cam0": {own}}}')
    with pytest.raises(ValueError, match=r"rig\.json: .*cam0 is in it twice"):
        load_rig(path)


def test_a_text_that_is_not_utf_8_says_so(tmp_path: Path) -> None:
    path = tmp_path / "rig.json"
    path.write_bytes(json.dumps({"Höhe": table(0, dist=[])}, ensure_ascii=False).encode("latin-1"))
    with pytest.raises(ValueError, match=r"rig\.json: it is not UTF-8 \(byte 3\)"):
        load_rig(path)


@pytest.mark.parametrize(("unit", "scale"), [("cm", 100.0), ("Millimeters", 1000.0), ("dm", 10.0), ("metre", 1.0)])
def test_the_unit_that_a_file_states_counts(tmp_path: Path, unit: str, scale: float) -> None:
    tables = [table(n, dist=[], name=f"cam{n}", t=(scale * POSES[n][:3, 3]).tolist()) for n in (0, 1)]
    for document in ([own | {"unit": unit} for own in tables], {"units": unit, "cameras": tables}):
        found = load_rig(written(tmp_path, document))
        np.testing.assert_allclose(found.cameras[1].camera_T_world, POSES[1], atol=1e-9)
    with pytest.raises(ValueError, match=r"rig\.json: its units contradict each other: m, mm"):
        load_rig(written(tmp_path, [tables[0] | {"unit": "m"}, tables[1] | {"unit": "mm"}]))
    with pytest.raises(ValueError, match=r"rig\.json: the unit 'parsec' is none of m, dm, cm"):
        load_rig(written(tmp_path, {"unit": "parsec", "cameras": tables}))


def test_centimetres_are_not_taken_for_millimetres(tmp_path: Path) -> None:
    """Of CMU's Panoptic studio: 10 m in centimetres would be a rig of 1 m, and a person of 0.2 m, in millimetres."""
    tables = {f"cam{n}": table(n, dist=[], t=(100 * POSES[n][:3, 3]).tolist()) for n in (0, 1)}
    with pytest.raises(ValueError, match=r"does not say its unit of length, .* give --unit m, cm or mm"):
        load_rig(written(tmp_path, tables))
    np.testing.assert_allclose(load_rig(written(tmp_path, tables), "cm").cameras[0].camera_T_world, POSES[0], atol=1e-9)


KALIBR = """cam0:
  camera_model: pinhole
  intrinsics: [1500, 1510, 955, 548]
  distortion_model: radtan
  distortion_coeffs: [-0.1, 0.03, 0.001, -0.002]
  resolution: [1920, 1080]
cam1:
  T_cn_cnm1:
  - [1, 0, 0, 0.1]
  - [0, 1, 0, 0]
  - [0, 0, 1, 0]
  - [0, 0, 0, 1]
  camera_model: pinhole
  intrinsics: [1500, 1510, 955, 548]
  distortion_model: equidistant
  distortion_coeffs: [0.05, -0.01, 0.004, -0.001]
  resolution: [1920, 1080]
"""


def test_lenses_of_kalibr(tmp_path: Path) -> None:
    path = tmp_path / "camchain.yaml"
    path.write_text(KALIBR)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = load_intrinsics(path, ["cam0", "cam1"])
    assert [lens_of(camera) for camera in found.cameras] == [
        ("pinhole", [-0.1, 0.03, 0.001, -0.002]),
        ("fisheye", [0.05, -0.01, 0.004, -0.001]),
    ]
    assert found.cameras[1].K.tolist() == K.tolist()
    with pytest.raises(ValueError, match=r"camchain\.yaml: no camera with a pose .*of Kalibr\) are not read"):
        load_rig(path)


def test_a_yaml_with_tables_as_in_json_is_a_rig(tmp_path: Path) -> None:
    path = written(tmp_path, {f"cam{n}": table(n, dist=COEFFICIENTS) for n in (0, 1)}, "rig.yaml")  # JSON is YAML
    path.write_text("# ours\n" + path.read_text())
    found = load_rig(path)
    assert lens_of(found.cameras[0]) == ("pinhole", COEFFICIENTS)
    np.testing.assert_allclose(found.cameras[1].camera_T_world, POSES[1], atol=1e-9)
