"""Which recordings a study has."""

from __future__ import annotations

import os
import shutil
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import pytest

from fgpose.cli import main
from fgpose.study import Plan, StudyDescription, load_study, process
from fgpose.study.study import study_of


def keys(study: StudyDescription, only: str = "") -> list[str]:
    return [recording.key for recording in Plan(study, only)]


def test_recordings_and_their_calibrations(study_file: Path) -> None:
    recordings = list(Plan(load_study(study_file)))
    assert [recording.key for recording in recordings] == ["S01/A/run", "S01/A/walk", "S02/A/run", "S02/A/walk"]
    assert recordings[2].calibration == study_file.parent / "S02" / "A" / "Calib.toml"
    assert not any(recording.problem for recording in recordings)


def test_a_calibration_beside_the_trials_is_no_recording(edited: Callable[[str, str], Path]) -> None:
    study = load_study(edited("{trial}.npz", "{trial}"))
    assert keys(study) == ["S01/A/run.npz", "S01/A/walk.npz", "S02/A/run.npz", "S02/A/walk.npz"]


def test_some_are_excluded_or_chosen(edited: Callable[[str, str], Path]) -> None:
    study = load_study(edited("[steps]", 'exclude = ["S02/*/*", "*/*/r?n"]\n[steps]'))
    assert keys(study) == ["S01/A/walk"]
    assert keys(study, "S02/*") == []
    with pytest.raises(ValueError, match=r"no recording matches 'S02/\*'"):
        Plan(study, "S02/*").counted()


def test_excluding_all_is_an_error(edited: Callable[[str, str], Path]) -> None:
    with pytest.raises(ValueError, match=r"data\.exclude leaves out every recording"):
        Plan(load_study(edited("[steps]", 'exclude = ["*"]\n[steps]'))).counted()


def test_a_pattern_that_matches_nothing_says_what_is_there(edited: Callable[[str, str], Path]) -> None:
    study = load_study(edited("{trial}.npz", "{trial}.parquet"))
    with pytest.raises(ValueError, match=r"no recording matches .*\.parquet' in .*which holds S01, S02, study.toml"):
        Plan(study).counted()


def test_of_several_patterns_the_one_that_matches_nothing_is_named(edited: Callable[[str, str], Path]) -> None:
    pattern = '"{subject}/{session}/{trial}.npz"'
    study = load_study(
        edited(f"keypoints = {pattern}", f'keypoints = [{pattern}, "{{subject}}/{{session}}/{{trial}}.json"]')
    )
    *found, nothing = Plan(study)
    assert len(found) == 4
    assert ".json' matches nothing" in nothing.problem


@pytest.mark.parametrize("layout", ["folders", "pose2sim"])
def test_a_folder_that_cannot_be_read_stops_no_other(
    study_file: Path, layout: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if layout == "pose2sim":
        for trial in ("S01/walk", "S02/walk"):
            (study_file.parent / trial / "pose").mkdir(parents=True)
            (study_file.parent / trial / "calibration").mkdir()
            (study_file.parent / trial / "calibration" / "Calib.toml").touch()
        study_file.write_text('[data]\nlayout = "pose2sim"\nskeleton = "h36m_17"\n')
    locked, listed = study_file.parent / "S02", os.listdir

    def listdir(path: Path) -> list[str]:
        if Path(path) == locked:
            raise PermissionError(13, "Permission denied", str(path))
        return listed(path)

    monkeypatch.setattr(os, "listdir", listdir)
    *others, last = Plan(load_study(study_file))
    assert {recording.subject for recording in others} == {"walk" if layout == "pose2sim" else "S01"}
    assert not any(recording.problem for recording in others)
    assert (last.trial, last.problem) == ("", f"{locked}: Permission denied")


def test_a_missing_root_is_named(edited: Callable[[str, str], Path]) -> None:
    with pytest.raises(ValueError, match=r"data\.root: there is no folder .*nowhere"):
        Plan(load_study(edited("[data]", '[data]\nroot = "nowhere"'))).counted()


def test_without_a_calibration_or_with_two(study_file: Path, edited: Callable[[str, str], Path]) -> None:
    (study_file.parent / "S01" / "A" / "Calib.toml").unlink()
    first, *_ = Plan(load_study(study_file))
    assert first.problem.startswith("it has no calibration: there is no S01/A/Calib.toml")
    shutil.copy(study_file.parent / "S02" / "A" / "Calib.toml", study_file.parent / "S02" / "A" / "Calib_old.toml")
    last = list(Plan(load_study(edited("Calib.toml", "Calib*.toml"))))[-1]
    assert last.problem.startswith("it has several calibrations: Calib.toml, Calib_old.toml")


def test_one_that_is_there_twice_is_named(study_file: Path, edited: Callable[[str, str], Path]) -> None:
    folder = study_file.parent / "S01" / "A"
    shutil.copy(folder / "walk.npz", folder / "walk.copy")
    problems = [recording.problem for recording in Plan(load_study(edited("{trial}.npz", "{trial}.*")))]
    assert sum("it is there twice" in problem for problem in problems) == 1


def test_results_are_no_recordings(edited: Callable[[str, str], Path]) -> None:
    study = load_study(edited('output = "results"', 'output = "S09"'))
    (study.output / "A").mkdir(parents=True)
    (study.output / "A" / "walk.npz").touch()
    assert not any(key.startswith("S09") for key in keys(study))


@pytest.mark.parametrize("output", ["out/gait", "S01/gait", "gait"])
@pytest.mark.parametrize("written", ["quality.parquet", ".lock"])
def test_results_of_other_studies_are_no_recordings(
    edited: Callable[[str, str], Path], output: str, written: str
) -> None:
    study = load_study(edited("{trial}.npz", "{trial}"))
    before = keys(study)
    results = study.root / output
    for folder in ("recordings/S01/A/walk", "motion/subject=S01", "angles/subject=S01"):
        (results / folder).mkdir(parents=True)
    (results / written).touch()
    assert keys(study) == before
    # A pattern may name them.
    (results / "recordings" / "S01" / "A" / "walk" / "seen.npz").touch()
    named = edited("{subject}/{session}/{trial}", f"{output}/recordings/{{subject}}/{{session}}/{{trial}}/seen.npz")
    assert keys(load_study(named)) == ["S01/A/walk"]


def test_a_folder_of_nothing_but_results_is_no_recording(tmp_path: Path) -> None:
    data = {"keypoints": ["{trial}"], "calibration": "Calib.toml", "skeleton": "h36m_17"}
    study = study_of({"data": data}, tmp_path / "study.toml")
    make(tmp_path, "walk", "Calib.toml")
    for name in ("gait", "jumps"):
        make(tmp_path / "out" / name, "recordings", "quality.parquet")
    assert keys(study) == ["all/all/walk"]
    make(tmp_path, "out/cam01_json")
    assert keys(study) == ["all/all/out", "all/all/walk"]


def pose2sim_study(root: Path, **data: object) -> StudyDescription:
    return study_of({"data": {"layout": "pose2sim", "skeleton": "body_25b", **data}}, root / "study.toml")


def make(root: Path, *names: str) -> None:
    for name in names:
        path = root / name
        (path if not path.suffix else path.parent).mkdir(parents=True, exist_ok=True)
        if path.suffix:
            path.touch()


def test_a_session_of_pose2sim(tmp_path: Path) -> None:
    make(tmp_path, "calibration/Calib_scene.toml", "Trial_1/pose/cam01_json", "Trial_2/videos", "Trial_2/pose-sync")
    make(tmp_path, "Trial_2/pose/cam01_json", "Trial_1/pose-3d")
    recordings = list(Plan(pose2sim_study(tmp_path)))
    name = tmp_path.name
    assert [recording.key for recording in recordings] == [f"{name}/{name}/Trial_1", f"{name}/{name}/Trial_2"]
    assert [recording.source.name for recording in recordings] == ["pose", "pose-sync"]
    assert all(recording.calibration == tmp_path / "calibration" / "Calib_scene.toml" for recording in recordings)
    (videos,) = Plan(pose2sim_study(tmp_path, videos=["videos"]))
    assert (videos.kind, videos.trial) == ("videos", "Trial_2")


def test_pipes_in_a_study_do_not_keep_it_waiting(study_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study = load_study(study_file)
    walk = study.root / "S01" / "A" / "walk.npz"
    walk.unlink()
    os.mkfifo(walk)
    main(["study", str(study_file), "--dry-run"])
    assert "S01/A/walk" in capsys.readouterr().out
    (recording,) = Plan(study, "S01/A/walk")
    assert "no plain file but a pipe" in process(study, recording).reason


def test_links_in_a_circle_are_followed_once(tmp_path: Path) -> None:
    """Two of them double the folders of each level, forty levels deep."""
    (tmp_path / "S01" / "walk" / "pose").mkdir(parents=True)
    (tmp_path / "S01" / "calibration").mkdir()
    for name in ("a", "b"):
        (tmp_path / name).symlink_to(".")
        (tmp_path / "S01" / name).symlink_to(tmp_path)
    assert [recording.trial for recording in Plan(pose2sim_study(tmp_path))] == ["walk"]


def test_sessions_with_participants_of_pose2sim(tmp_path: Path) -> None:
    make(
        tmp_path, "S00/S00_Calibration/Calib.toml", "S00/S00_P00/T00/pose/cam01_json", "S01/S01_P00/T01/pose/cam01_json"
    )
    first, second = Plan(pose2sim_study(tmp_path))
    assert (first.subject, first.session, first.trial) == ("S00_P00", "S00", "T00")
    assert second.problem.startswith("it has no calibration: no folder above")


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """10,000 recordings, of which there are names only."""
    root = tmp_path_factory.mktemp("large")
    for subject in range(100):
        folder = root / f"S{subject:03}" / "A"
        folder.mkdir(parents=True)
        for trial in range(100):
            (folder / f"{trial:03}.npz").touch()
        (folder / "Calib.toml").touch()
    return root


@pytest.mark.slow
def test_ten_thousand_are_planned_without_holding_them(large: Path) -> None:
    data = {
        "keypoints": "{subject}/{session}/{trial}.npz",
        "calibration": "{subject}/{session}/Calib.toml",
        "skeleton": "h36m_17",
    }
    study = study_of({"data": data}, large / "study.toml")
    tracemalloc.start()
    try:
        n_found = sum(1 for _ in Plan(study))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert n_found == 10_000
    # 16 bytes of each in a set are 100 bytes in Python; a list of the recordings takes 6 MB.
    assert peak < 2_000_000
