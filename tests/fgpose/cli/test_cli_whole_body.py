"""Bodies with hands and a face from the command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import fgpose
from fgpose.cli import main
from fgpose.io.keypoints import save_observations
from fgpose_benchmarks.synthetic import DetectionNoise, Scene, embedded_motion, ring_rig
from fgpose_benchmarks.synthetic.whole_body import simulate_whole_body, whole_body_of

SMOOTHED = ["--formats", "parquet", "trc"]


def recording(folder: Path, name: str, n_frames: int) -> tuple[Scene, list[str]]:
    """A recording, and the arguments that say what it is."""
    skeleton, (motion_m, fps) = fgpose.load_skeleton(name), embedded_motion("cmu_02_05")
    truth_m = whole_body_of(motion_m[:n_frames], fps, skeleton)
    scene = simulate_whole_body(truth_m, skeleton, ring_rig(), fps, DetectionNoise())
    save_observations(scene.observations, folder / "pose.npz")
    fgpose.save_rig(scene.rig, folder / "Calib.toml")
    given = [str(folder / "pose.npz"), "--rig", str(folder / "Calib.toml"), "--skeleton", name]
    return scene, [*given, "--output", str(folder / "out")]


@pytest.mark.usefixtures("without_search_for_faults")
@pytest.mark.parametrize("name", ["holistic_75", pytest.param("openpose_137", marks=pytest.mark.slow)])
def test_smooth(tmp_path: Path, name: str):
    scene, given = recording(tmp_path, name, 20)
    assert main(["smooth", *given, *SMOOTHED]) == 0
    found = fgpose.load_trajectory(tmp_path / "out" / "pose.parquet")
    assert found.skeleton == scene.observations.skeleton
    # The body has 12 mm, hands and face have less.
    assert np.mean(np.linalg.norm(found.positions_m - scene.truth_m, axis=-1)) < 0.015


@pytest.mark.slow
@pytest.mark.usefixtures("without_search_for_faults")
def test_track(tmp_path: Path):
    scene, given = recording(tmp_path, "holistic_75", 20)
    assert main(["track", *given, *SMOOTHED]) == 0
    (path,) = (path for path in (tmp_path / "out").glob("*.parquet") if "smoothed" not in path.name)
    found = fgpose.load_trajectory(path)
    assert np.mean(np.linalg.norm(found.positions_m[10:] - scene.truth_m[10:], axis=-1)) < 0.025
