"""How the cameras of a calibration became what they are, in its file."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from fgpose.geometry.camera import CameraRig
from fgpose.io.arrays import write_arrays
from fgpose.io.calibration import CalibrationOrigin, load_calibration_origin, load_rig, save_rig
from fgpose.io.calibration.calibration_origin import MovedCamera, Reason, table_of
from fgpose.io.calibration.npz_format import rig_arrays
from fgpose.io.calibration.rig_files import RigFormat
from fgpose.pipeline.origin import origin_of

KNOWN = CalibrationOrigin(
    offset_sigma_s={"ring_1": 0.002, "ring_2": 1e-17},
    moved=(MovedCamera("ring_0", 0.25, 0.012, 0.08, 0.004), MovedCamera("ring_1", 0.0, 0.0)),
    grade="coarse",
    findings=(
        Reason("", "coarse", "few people", "walk longer"),
        Reason("ring_1", "coarse", 'the "focal" length ‒ unknown', "walk closer"),
    ),
    method="with a board",
    coverage={"ring_0": ((0, 3), (12, 0)), "ring_2": ((1, 1), (0, 0))},
)
KEEPING: tuple[tuple[RigFormat, str], ...] = (("pose2sim", "toml"), ("aniposelib", "toml"), ("npz", "npz"))


@pytest.mark.parametrize(("file_format", "extension"), KEEPING)
def test_it_comes_back(rig: CameraRig, tmp_path: Path, file_format: RigFormat, extension: str) -> None:
    path = tmp_path / f"rig.{extension}"
    save_rig(rig, path, file_format, KNOWN)
    assert load_calibration_origin(path) == KNOWN
    save_rig(rig, tmp_path / f"plain.{extension}", file_format)
    for one, other in zip(load_rig(path).cameras, load_rig(tmp_path / f"plain.{extension}").cameras, strict=True):
        np.testing.assert_array_equal(one.world_T_camera, other.world_T_camera)


@pytest.mark.parametrize(("file_format", "extension"), KEEPING)
def test_a_file_about_which_nothing_is_known_is_as_before(
    rig: CameraRig, tmp_path: Path, file_format: RigFormat, extension: str
) -> None:
    one, other = (tmp_path / f"{name}.{extension}" for name in ("one", "other"))
    save_rig(rig, one, file_format)
    save_rig(rig, other, file_format, CalibrationOrigin())
    assert one.read_bytes() == other.read_bytes()
    assert load_calibration_origin(one) == CalibrationOrigin()


def test_pose2sim_finds_its_metadata(rig: CameraRig, tmp_path: Path) -> None:
    save_rig(rig, tmp_path / "rig.toml", origin=KNOWN)
    document = tomllib.loads((tmp_path / "rig.toml").read_text())
    assert (document["metadata"]["adjusted"], document["metadata"]["error"]) == (False, 0.0)
    assert document.keys() == {*rig.names, "metadata"}


def test_formats_without_it_say_nothing(rig: CameraRig, tmp_path: Path) -> None:
    save_rig(rig, tmp_path / "cameras.toml", "caliscope", KNOWN)
    save_rig(rig, tmp_path / "yaml", "easymocap", KNOWN)
    for path in (tmp_path / "cameras.toml", tmp_path / "yaml"):
        assert load_calibration_origin(path) == CalibrationOrigin()


def edit(path: Path, change: Any) -> None:
    document = tomllib.loads(path.read_text())
    change(document)
    path.write_text(tomli_w.dumps(document))


def test_it_is_not_of_other_cameras(rig: CameraRig, tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    save_rig(rig, path, origin=KNOWN)
    # Written anew by a program that keeps what it does not know: still the same cameras.
    edit(path, lambda document: document["metadata"].update(adjusted=True))
    assert load_calibration_origin(path) == KNOWN
    edit(path, lambda document: document["ring_1"]["translation"].__setitem__(0, 0.5))
    assert load_calibration_origin(path) == CalibrationOrigin()


def test_what_a_later_version_knows_is_ignored(rig: CameraRig, tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    save_rig(rig, path, origin=KNOWN)
    edit(path, lambda document: document["metadata"]["fgpose"].update(version=99, moved="other"))
    assert load_calibration_origin(path) == CalibrationOrigin()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": "one"}, "a table with a version is needed"),
        ({"grade": 1}, "fgpose.grade: it has '1'"),
        ({"offset_sigma_s": {"ring_1": "small"}}, "fgpose.offset_sigma_s: it has 'small'"),
        ({"moved": [{"camera": "ring_0"}]}, "fgpose.moved: something is missing"),
        ({"findings": 3}, "fgpose.findings: it has '3'"),
        ({"other": 1}, "fgpose: a table of offset_sigma_s"),
    ],
)
def test_damage_names_the_file(rig: CameraRig, tmp_path: Path, change: dict[str, Any], message: str) -> None:
    path = tmp_path / "rig.toml"
    save_rig(rig, path, origin=KNOWN)
    edit(path, lambda document: document["metadata"]["fgpose"].update(change))
    with pytest.raises(ValueError, match="what it says of its origin is damaged") as error:
        load_calibration_origin(path)
    assert str(error.value).startswith(f"{path}: ")
    assert message in str(error.value)
    with pytest.raises(ValueError, match="is damaged"):
        origin_of(rig, Calibration=path)
    assert load_rig(path).names == rig.names


@pytest.mark.parametrize("text", ["{", "[]", "[" * 100_000, json.dumps(table_of(KNOWN) | {"grade": 1})])
def test_damage_in_an_npz(rig: CameraRig, tmp_path: Path, text: str) -> None:
    write_arrays(tmp_path / "rig.npz", rig_arrays(rig) | {"origin": np.array(text)})
    with pytest.raises(ValueError, match="what it says of its origin is damaged") as error:
        load_calibration_origin(tmp_path / "rig.npz")
    assert str(error.value).startswith(str(tmp_path / "rig.npz"))


def test_a_result_takes_over_what_holds_of_its_cameras(rig: CameraRig, tmp_path: Path) -> None:
    save_rig(rig, tmp_path / "rig.toml", origin=KNOWN)
    assert origin_of(rig, Calibration=tmp_path / "rig.toml").calibration == KNOWN
    known = origin_of(rig.subset(("ring_0", "ring_2")), Calibration=tmp_path / "rig.toml").calibration
    assert known.offset_sigma_s.keys() == {"ring_2"}
    assert [each.camera for each in known.moved] == ["ring_0"]
    assert [each.camera for each in known.findings] == [""]
    assert known.grade == "coarse"
