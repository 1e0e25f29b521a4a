"""A small study: two subjects with two trials each, of ten frames, seen by four cameras."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from fgpose.geometry.camera import CameraRig
from fgpose.io.calibration import save_rig
from fgpose.io.keypoints import save_observations
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, simulate, walking

STUDY = """
output = "results"
[data]
keypoints = "{subject}/{session}/{trial}.npz"
calibration = "{subject}/{session}/Calib.toml"
skeleton = "h36m_17"
[steps]
angles = false
formats = []
"""
N_FRAMES = 10


@pytest.fixture(scope="session")
def study_source(tmp_path_factory: pytest.TempPathFactory, rig: CameraRig, skeleton: Skeleton) -> Path:
    folder = tmp_path_factory.mktemp("study")
    motion_m = walking(4 * N_FRAMES, 30.0, skeleton)
    for number, (subject, trial) in enumerate((s, t) for s in ("S01", "S02") for t in ("run", "walk")):
        save_rig(rig, folder / subject / "A" / "Calib.toml")
        part_m = motion_m[number * N_FRAMES :][:N_FRAMES]
        scene = simulate(part_m, skeleton, rig, 30.0, DetectionNoise(), NO_OCCLUSION, seed=number)
        save_observations(scene.observations, folder / subject / "A" / f"{trial}.npz")
    (folder / "study.toml").write_text(STUDY)
    return folder


@pytest.fixture
def study_file(study_source: Path, tmp_path: Path) -> Path:
    """The study file of a copy."""
    shutil.copytree(study_source, tmp_path / "data")
    return tmp_path / "data" / "study.toml"


@pytest.fixture
def edited(study_file: Path) -> Callable[[str, str], Path]:
    """The study file with a text replaced."""

    def edit(old: str, new: str) -> Path:
        text = study_file.read_text()
        assert old in text
        study_file.write_text(text.replace(old, new))
        return study_file

    return edit
