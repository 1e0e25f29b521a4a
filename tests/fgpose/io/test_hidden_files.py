"""What begins with a dot is never an input: macOS and programs that are killed leave such files anywhere."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from small_files import FORMATS, recording, rig, trajectory

from fgpose.io.calibration import load_intrinsics, save_rig
from fgpose.io.keypoints import save_observations
from fgpose.io.names import files_below
from fgpose.io.origin import size_bytes
from fgpose.io.trajectories import save_trajectory
from fgpose.report.results import find_result
from fgpose.study.chain import contents_of, stamp_of


def hide_files(folder: Path) -> None:
    """Beside each file half of it, and a folder with all of it."""
    for file in [Path(inside, name) for inside, _, names in os.walk(folder) for name in names]:
        half = file.read_bytes()[: file.stat().st_size // 2]
        (file.parent / f"._{file.name}").write_bytes(half)
        (file.parent / f".fgpose-0123abcd{file.suffix}").write_bytes(half)
        (file.parent / ".trash").mkdir(exist_ok=True)
        (file.parent / ".trash" / file.name).write_bytes(file.read_bytes())


RIGS = ("rig yaml", "rig opencap", "rig biocv")
KEYPOINTS = ("openpose", "mmpose images", "mmpose", "mmpose frames", "coco", "deeplabcut", "freemocap", "metrabs json")


@pytest.mark.parametrize("name", [*RIGS, *KEYPOINTS])
def test_readers_of_folders(tmp_path: Path, name: str) -> None:
    FORMATS[name].make(tmp_path)
    before = FORMATS[name].read(tmp_path)
    hide_files(tmp_path)
    after = FORMATS[name].read(tmp_path)
    if name in RIGS:
        assert after.names == before.names
    else:
        assert after.camera_names == before.camera_names
        assert after.n_frames == before.n_frames


def test_lenses_of_a_folder(tmp_path: Path) -> None:
    lenses = tmp_path / "lenses"
    for camera in rig().cameras:
        save_rig(rig().subset([camera.name]), lenses / f"{camera.name}.toml")
    hide_files(lenses)
    assert load_intrinsics(lenses, rig().names).names == rig().names


def test_the_result_of_a_folder(tmp_path: Path) -> None:
    save_observations(recording(), tmp_path / "observations.npz")
    save_trajectory(trajectory(), tmp_path / "walk.parquet")
    hide_files(tmp_path)
    assert find_result(tmp_path, "walk") == tmp_path / "walk.parquet"
    (tmp_path / "observations.npz").unlink()
    assert find_result(tmp_path) == tmp_path / "walk.parquet"


def stamp(folder: Path) -> object:
    return stamp_of({"keypoints": folder})


def contents(folder: Path) -> object:
    return contents_of({"keypoints": folder})


@pytest.mark.parametrize("of", [size_bytes, stamp, contents, lambda folder: list(files_below(folder))])
def test_inputs_have_not_changed(tmp_path: Path, of: Callable[[Path], object]) -> None:
    FORMATS["openpose"].make(tmp_path)
    before = of(tmp_path)
    hide_files(tmp_path)
    assert of(tmp_path) == before
