"""The commands on data that the user brings."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import tyro

from fgpose.io.skeletons import load_skeleton
from fgpose.io.trajectories import save_trajectory
from fgpose.observations import Observations
from fgpose.trajectory import Status, Trajectory
from fgpose_benchmarks.cli.data import Human36M, OccludeImages, Workcell
from fgpose_benchmarks.human36m.labels import image_path, load_labels
from fgpose_benchmarks.human36m.predictions import SequencePrediction, load_predictions, save_predictions
from tests.benchmarks.human36m.human36m_files import (
    h36m_rig,
    labels,
    motion_of_32,
    truth_of,
    write_annotation,
    write_camera_parameters,
    write_views,
)

RIGS = {"S9": h36m_rig(), "S11": h36m_rig(0.3)}
# Every fifth frame is labelled, as in theirs: of these 0 and 65 are scored.
ACTIONS = {key: np.arange(0, 70, 5) for key in (("S9", "Walking-1"), ("S11", "Walking-1"))}


@pytest.fixture(scope="module")
def labels_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("h36m") / "labels.npy"
    np.save(path, np.array(labels(ACTIONS, RIGS), dtype=object), allow_pickle=True)
    return path


def write_predictions(path: Path, error_m: float) -> Path:
    truth_m = {key: truth_of(motion_of_32(len(frames))) for key, frames in ACTIONS.items()}
    moved = {
        key: SequencePrediction(ACTIONS[key], positions_m + np.array([error_m, 0.0, 0.0]))
        for key, positions_m in truth_m.items()
    }
    save_predictions(moved, path)
    return path


@pytest.mark.parametrize("command", [Human36M, OccludeImages, Workcell])
def test_help_explains_and_gives_an_example(command: type, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as end:
        tyro.cli(command, args=["--help"])
    assert end.value.code == 0
    assert "Example: fgpose benchmark " in capsys.readouterr().out


def test_human36m_scores_files_and_its_own_poses_equally(
    labels_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    adafuse = write_predictions(tmp_path / "adafuse.npz", 0.02)
    sequences = load_labels(labels_path)
    seen = {
        each.key: Observations(
            skeleton=load_skeleton("h36m_17"),
            time_s=each.frames / 50.0,
            points2d_px=np.stack([camera.distort(camera.project(each.truth_m)) for camera in each.rig.cameras], axis=1),
            camera_names=each.rig.names,
        )
        for each in sequences
    }
    write_views(seen, tmp_path / "views")
    command = Human36M(
        labels=labels_path,
        predictions=(adafuse,),
        views=tmp_path / "views",
        estimation="refine",
        output=tmp_path / "out",
    )
    command.run()
    printed = capsys.readouterr().out
    written = (tmp_path / "out" / "human36m.md").read_text()
    assert written.strip() == printed.strip()
    lines = [line for line in written.splitlines() if line.startswith("| adafuse")]
    assert lines[0].endswith("| 20.0 | – | 20.0 | 4 | 0.0 |")
    assert lines[1].endswith("| 0.0 | – | 0.0 | 4 | 0.0 |")
    assert sum(line.startswith("| fgpose refine") for line in written.splitlines()) == 2
    own = load_predictions(tmp_path / "out" / "fgpose_refine.npz")
    for each in sequences:
        # points without noise; single precision of the files
        np.testing.assert_allclose(own[each.key].positions_m, each.truth_m, atol=1e-3)


def test_human36m_reads_the_folders_of_h36m_fetch(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    for (subject, action), frames in ACTIONS.items():
        write_annotation(tmp_path / "processed", subject, action, frames, RIGS[subject])
    write_camera_parameters(tmp_path / "cameras.json", RIGS)
    mine = write_predictions(tmp_path / "mine.npz", 0.03)
    command = Human36M(labels=tmp_path / "processed", cameras=tmp_path / "cameras.json", predictions=(mine,))
    command.run()
    assert "30.0 | 4 | 0.0 |" in capsys.readouterr().out
    with pytest.raises(ValueError, match="have no extrinsics; give --cameras"):
        replace(command, cameras=None).run()


def test_human36m_says_what_is_missing(labels_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(ValueError, match="nothing to score: give --predictions, --views or both"):
        Human36M(labels=labels_path).run()
    mine = write_predictions(tmp_path / "mine.npz", 0.03)
    part = load_predictions(mine)
    del part["S11", "Walking-1"]
    save_predictions(part, mine)
    with pytest.raises(ValueError, match="mine: predictions are missing: S11/Walking-1 lacks 2 of 2 frames"):
        Human36M(labels=labels_path, predictions=(mine,)).run()
    Human36M(labels=labels_path, predictions=(mine,), allow_missing=True).run()
    assert "| 4 | 50.0 |" in capsys.readouterr().out
    Human36M(labels=labels_path, predictions=(mine,), subjects=("S9",)).run()
    assert "| 2 | 0.0 |" in capsys.readouterr().out
    with pytest.raises(ValueError, match="need different names"):
        Human36M(labels=labels_path, predictions=(mine, tmp_path / "other" / "mine.npz")).run()


def test_occlude_makes_the_images_of_the_protocol(
    labels_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    for each in load_labels(labels_path):
        for frame in (0, 65):
            for camera in each.rig.cameras:
                path = image_path(tmp_path / "processed", each, camera.name, frame)
                path.parent.mkdir(parents=True, exist_ok=True)
                cv2.imwrite(str(path), np.full((*camera.size_px[::-1], 3), 90, np.uint8))
    (tmp_path / "cutouts").mkdir()
    cv2.imwrite(str(tmp_path / "cutouts" / "box.png"), np.full((5, 5, 4), 255, np.uint8))
    OccludeImages(
        labels=labels_path, images=tmp_path / "processed", cutouts=tmp_path / "cutouts", output=tmp_path / "occluded"
    ).run()
    assert "4 frames, 1 cut-outs" in capsys.readouterr().out
    described = json.loads((tmp_path / "occluded" / "occluders.json").read_text())
    assert [sum(bool(view["occluders"]) for view in frame) for frame in described["frames"]] == [3, 3, 3, 3]
    assert len(list((tmp_path / "occluded").rglob("*.jpg"))) == 16


def test_workcell_prints_the_table_of_the_joints(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    skeleton, truth_m = load_skeleton("h36m_17"), truth_of(motion_of_32(30))
    status = np.full((30, 17), int(Status.OBSERVED))
    result = Trajectory(skeleton=skeleton, time_s=np.arange(30) / 15.0, positions_m=truth_m, status=status)
    drift_m = np.linspace(0.0, 1.0, 30)[:, None, None] * np.ones(3)
    save_trajectory(result, tmp_path / "result.parquet")
    save_trajectory(replace(result, positions_m=truth_m + drift_m), tmp_path / "suit.npz")
    Workcell(estimate=tmp_path / "result.parquet", reference=tmp_path / "suit.npz").run()
    printed = capsys.readouterr().out
    assert "at the result's own neck" in printed
    assert "left_wrist" in printed
    anchored = Workcell(
        estimate=tmp_path / "result.parquet", reference=tmp_path / "suit.npz", anchor=tmp_path / "result.parquet"
    )
    anchored.run()
    assert "at the result's own neck" not in capsys.readouterr().out
