"""What a result was made from, in its file."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_files import N_FRAMES, origin, trajectory

from fgpose.io.origin import input_file, origin_from_json, origin_to_json
from fgpose.io.trajectories import load_origin, load_trajectory, save_trajectory
from fgpose.io.trajectories.parquet import write_parquet


def test_everything_comes_back(tmp_path: Path) -> None:
    save_trajectory(trajectory(), tmp_path / "result.parquet", origin=origin())
    found, expected = load_origin(tmp_path / "result.parquet"), origin()
    assert found is not None
    for name in ("inputs", "calibration", "events", "fps", "command", "fgpose"):
        assert getattr(found, name) == getattr(expected, name)
    assert found.rig is not None
    assert expected.rig is not None
    for one, other in zip(found.rig.cameras, expected.rig.cameras, strict=True):
        # The file has the rotation as a vector: rounding of double precision.
        np.testing.assert_allclose(one.camera_T_world, other.camera_T_world, atol=1e-12)
        np.testing.assert_array_equal(one.K, other.K)


def test_inputs_move_with_the_result_and_are_known_by_their_size(tmp_path: Path) -> None:
    before = tmp_path / "before"
    (before / "out").mkdir(parents=True)
    (before / "seen.npz").write_bytes(b"12345")
    made = replace(origin(), inputs=(input_file("Keypoints", before / "seen.npz"),))
    text = origin_to_json(made, before / "out")
    assert str(tmp_path) not in text
    shutil.move(before, tmp_path / "after")
    found = origin_from_json(text, tmp_path / "after" / "out")
    assert found is not None
    assert Path(found.inputs[0].path) == tmp_path / "after" / "seen.npz"
    assert found.inputs[0].is_there
    (tmp_path / "after" / "seen.npz").write_bytes(b"123456")
    assert not found.inputs[0].is_there


def test_an_older_file_and_a_later_version_say_nothing(tmp_path: Path) -> None:
    save_trajectory(trajectory(), tmp_path / "old.parquet")
    save_trajectory(trajectory(), tmp_path / "old.trc")
    assert load_origin(tmp_path / "old.parquet") is None
    assert load_origin(tmp_path / "old.trc") is None
    assert origin_from_json('{"version": 99, "new": 1}', tmp_path) is None


def valid() -> dict[str, object]:
    return json.loads(origin_to_json(origin(), Path("/nowhere")))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "its origin is damaged"),
        ("[]", "a table with a version is needed"),
        ("[" * 100_000, "nested too deeply"),
        (json.dumps(valid() | {"rig": "x = 1"}), "no camera in it"),
        (json.dumps(valid() | {"rig": 1}), "rig: a text is needed"),
        (json.dumps(valid() | {"events": [{"time_s": 1}]}), "origin.events: something is missing"),
        (json.dumps(valid() | {"fps": "fast"}), "origin.fps: it has 'fast'"),
        (json.dumps(valid() | {"fps": 10**400}), "origin.fps"),
        (json.dumps(valid() | {"other": 1}), "origin: a table of"),
        (json.dumps(valid() | {"calibration": {"offset_sigma_s": {"cam_1": None}}}), "origin.calibration.offset"),
    ],
)
def test_damage_names_the_file(text: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fgpose.io.trajectories.parquet.origin_to_json", lambda origin, folder: text)
    path = tmp_path / "result.parquet"
    write_parquet({0: trajectory()}, {0: np.arange(N_FRAMES)}, path, origin())
    with pytest.raises(ValueError, match="its origin is damaged") as error:
        load_origin(path)
    assert str(error.value).startswith(f"{path}: ")
    assert message in str(error.value)
    # The numbers stay readable.
    assert load_trajectory(path).n_frames == N_FRAMES
