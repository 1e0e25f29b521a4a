"""One recording through the chain: what is done, what is not done again, and what fails."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from fgpose.estimation.smoother import smooth
from fgpose.io import atomic
from fgpose.io.calibration import CalibrationOrigin, load_rig, save_rig
from fgpose.io.calibration.calibration_origin import Reason
from fgpose.io.keypoints import load_observations
from fgpose.io.studies.state import load_state
from fgpose.io.trajectories import load_trajectory
from fgpose.report import load_finished
from fgpose.study import Plan, RecordingOutcome, Trial, load_study, process, steps
from fgpose.study.process import due

ALL = ("estimate", "judge")
pytestmark = pytest.mark.usefixtures("without_search_for_faults")


def first(file: Path) -> Trial:
    return next(iter(Plan(load_study(file))))


def run(file: Path) -> RecordingOutcome:
    return process(load_study(file), first(file))


def content(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def test_the_motion_is_that_of_the_smoother(study_file: Path) -> None:
    outcome = run(study_file)
    assert (outcome.status, outcome.ran) == ("done", ALL)
    folder = outcome.recording.folder(load_study(study_file).output)
    rig = load_rig(study_file.parent / "S01" / "A" / "Calib.toml")
    expected = smooth(load_observations(outcome.recording.source, rig, "h36m_17"), rig)
    np.testing.assert_array_equal(load_trajectory(folder / "motion.parquet").positions_m, expected.positions_m)
    state = load_state(folder)
    assert state is not None
    assert state.row["n_frames"] == expected.n_frames
    assert sorted(file.name for file in folder.iterdir()) == ["motion.parquet", "state.json"]


def test_what_is_done_is_not_done_again(study_file: Path) -> None:
    run(study_file)
    assert run(study_file).status == "unchanged"
    # The time of a file says nothing where it was copied from another machine.
    os.utime(first(study_file).source, (0, 0))
    assert run(study_file).status == "unchanged"


def test_nor_on_another_machine(study_file: Path, tmp_path: Path) -> None:
    run(study_file)
    shutil.copytree(study_file.parent, tmp_path / "elsewhere")
    assert run(tmp_path / "elsewhere" / "study.toml").status == "unchanged"


def test_only_what_depends_on_a_change_is_done_again(study_file: Path, edited: Callable[[str, str], Path]) -> None:
    run(study_file)
    motion = first(study_file).folder(load_study(study_file).output) / "motion.parquet"
    before = motion.stat().st_ino
    assert run(edited("formats = []", 'formats = ["trc"]')).ran == ("export",)
    assert motion.stat().st_ino == before
    assert motion.with_suffix(".trc").exists()
    assert run(edited('formats = ["trc"]', "formats = []")).status == "unchanged"
    assert not motion.with_suffix(".trc").exists()
    assert run(edited("formats = []", "formats = []\n[parameters.motion]\nmax_unseen_s = 2")).ran == (
        "estimate",
        "judge",
    )


def test_changed_keypoints_are_estimated_again(study_file: Path) -> None:
    run(study_file)
    shutil.copy(study_file.parent / "S02" / "A" / "walk.npz", first(study_file).source)
    assert run(study_file).ran == ALL


def test_a_result_that_was_deleted_is_made_again(study_file: Path) -> None:
    run(study_file)
    folder = first(study_file).folder(load_study(study_file).output)
    before = content(folder)
    (folder / "motion.parquet").unlink()
    assert run(study_file).ran == ("estimate",)
    assert content(folder) == before
    (folder / "state.json").write_text("{")
    assert run(study_file).ran == ALL
    assert content(folder) == before


def test_leftovers_of_a_killed_process_are_removed(study_file: Path) -> None:
    folder = first(study_file).folder(load_study(study_file).output)
    leftover = folder.with_name(".run.0123abcd")
    leftover.mkdir(parents=True)
    of_another = folder.with_name(".run.two.0123abcd")
    of_another.mkdir()
    assert run(study_file).status == "done"
    assert not leftover.exists()
    assert of_another.exists()


def test_calibrations_are_refined_on_the_recording(edited: Callable[[str, str], Path]) -> None:
    file = edited("[steps]", '[steps]\ncalibrate = "refine-poses"')
    outcome = run(file)
    assert outcome.ran == ("calibrate", *ALL)
    folder = outcome.recording.folder(load_study(file).output)
    before = content(folder)
    assert {"calibration.toml", "seen.parquet"} <= set(before)
    # From files that were kept the same motion follows as in one go.
    (folder / "motion.parquet").unlink()
    assert run(file).ran == ("estimate",)
    assert content(folder) == before


def test_what_is_known_of_a_calibration_reaches_the_motion(
    study_file: Path, edited: Callable[[str, str], Path]
) -> None:
    calibration = study_file.parent / "S01" / "A" / "Calib.toml"
    reason = Reason("ring_1", "coarse", "few people", "walk longer")
    save_rig(load_rig(calibration), calibration, origin=CalibrationOrigin(grade="coarse", findings=(reason,)))
    file = edited("[steps]", '[steps]\ncalibrate = "refine-poses"')
    outcome = run(file)
    folder = outcome.recording.folder(load_study(file).output)
    recording = load_finished(folder / "motion.parquet")
    assert [each.reason for each in recording.findings] == ["few people"]
    made_from = recording.made_from
    # Paths are those from the result, not from somebody's home.
    for what, path in (
        ("Keypoints", folder / "seen.parquet"),
        ("Keypoints as recorded", outcome.recording.source),
        ("Calibration as given", calibration),
    ):
        assert (folder / made_from[what].split(", ")[0]).resolve() == path.resolve(), what
    assert made_from["Calibration from people"] == "coarse"
    assert all(f"Camera {name} moved by" in made_from for name in recording.camera_names)
    assert made_from["Command"] == "fgpose study study.toml --only S01/A/run"
    # What each camera saw is found again, so the row knows what the page does.
    assert recording.observations
    state = load_state(folder)
    assert state is not None
    assert "few people" in str(state.row["suspicions"])


def test_a_calibration_that_says_nonsense_of_itself_fails(study_file: Path) -> None:
    calibration = study_file.parent / "S01" / "A" / "Calib.toml"
    save_rig(load_rig(calibration), calibration, origin=CalibrationOrigin(grade="coarse"))
    calibration.write_text(calibration.read_text().replace('grade = "coarse"', "grade = 3"))
    outcome = run(study_file)
    assert outcome.status == "failed"
    assert outcome.reason.startswith(f"{calibration}: what it says of its origin is damaged")


EVENTS = "subject,trial,event,time_s\nS01,run,stumble,0.25\nS01,run,start,0.1\nS02,run,tumbling,0.2\n"


@pytest.mark.slow
def test_events_are_on_the_page_of_their_recording(edited: Callable[[str, str], Path]) -> None:
    pytest.importorskip("bokeh")
    edited("[steps]", 'events = "events.csv"\n[steps]')
    file = edited("angles = false", "angles = false\nreport = true")
    events = file.parent / "events.csv"
    events.write_text(EVENTS)
    outcome = run(file)
    assert outcome.ran == (*ALL, "report"), outcome.reason
    page = (outcome.recording.folder(load_study(file).output) / "report.html").read_text()
    # In the table in order, and over the lines in the figures.
    assert page.index(">start<") < page.index(">stumble<")
    assert '"stumble"' in page
    assert "tumbling" not in page
    events.write_text(EVENTS.replace("tumbling", "jump"))
    assert run(file).status == "unchanged"
    events.write_text(EVENTS.replace("0.25", "0.2"))
    assert run(file).ran == ("report",)


def empty(path: Path) -> None:
    path.write_bytes(b"")


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def missing(path: Path) -> None:
    path.unlink()
    path.symlink_to("nowhere.npz")


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (empty, "run.npz"),
        pytest.param(truncated, "run.npz: a damaged npz", marks=pytest.mark.slow),
        (missing, "run.npz: No such file or directory"),
    ],
)
def test_bad_keypoints_fail_with_their_reason(study_file: Path, spoil: Callable[[Path], None], reason: str) -> None:
    spoilt = first(study_file).source
    spoil(spoilt)
    outcome = run(study_file)
    assert outcome.status == "failed"
    assert reason in outcome.reason
    note = outcome.recording.failure(load_study(study_file).output)
    assert note.read_text() == outcome.reason + "\n"
    assert not outcome.recording.folder(load_study(study_file).output).exists()
    # Nothing else is left, and once it is mended the note goes.
    assert os.listdir(note.parent) == [note.name]
    spoilt.unlink()
    shutil.copy(study_file.parent / "S01" / "A" / "walk.npz", spoilt)
    assert run(study_file).status == "done"
    assert not note.exists()


def test_another_skeleton_fails(edited: Callable[[str, str], Path]) -> None:
    outcome = run(edited("h36m_17", "coco_17"))
    assert outcome.status == "failed"
    assert "its joints are not those of skeleton coco_17" in outcome.reason


def test_keypoints_that_say_what_their_joints_are(edited: Callable[[str, str], Path]) -> None:
    file = edited('skeleton = "h36m_17"', "")
    outcome = run(file)
    assert outcome.status == "done"
    motion = load_trajectory(outcome.recording.folder(load_study(file).output) / "motion.parquet")
    assert motion.skeleton.name == "h36m_17"


def test_keypoints_that_do_not_say_it_need_a_skeleton(edited: Callable[[str, str], Path]) -> None:
    file = edited('skeleton = "h36m_17"', "")
    source = first(file).source
    with np.load(source) as arrays:
        told: dict[str, Any] = {name: array for name, array in arrays.items() if name != "skeleton"}
    np.savez(source, **(told | {"joints": np.array([f"point_{number}" for number in range(17)])}))
    outcome = run(file)
    assert outcome.status == "failed"
    assert outcome.reason.startswith("data.skeleton is missing, and ")


def test_other_cameras_fail(study_file: Path) -> None:
    calibration = study_file.parent / "S01" / "A" / "Calib.toml"
    calibration.write_text(calibration.read_text().replace("ring_3", "ring_7"))
    outcome = run(study_file)
    assert outcome.status == "failed"
    assert "ring_7" in outcome.reason


def test_messages_name_what_the_study_file_has(study_file: Path) -> None:
    calibration = study_file.parent / "S01" / "A" / "Calib.toml"
    rig = load_rig(calibration)
    save_rig(rig.subset(rig.names[:3]), calibration)
    assert "Use only those with data.cameras ring_0 ring_1 ring_2" in run(study_file).reason


def test_where_an_error_of_ours_was_raised_is_kept(study_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError("of ours")

    monkeypatch.setattr(steps, "run_smooth", fail)
    outcome = run(study_file)
    assert outcome.reason == "ZeroDivisionError: of ours"
    note = outcome.recording.failure(load_study(study_file).output)
    assert "Traceback" in note.read_text()


def test_a_damaged_calibration_fails(study_file: Path) -> None:
    (study_file.parent / "S01" / "A" / "Calib.toml").write_text("[ring_0]\n")
    outcome = run(study_file)
    assert outcome.status == "failed"
    assert "Calib.toml" in outcome.reason


def test_a_full_disk_keeps_older_results(
    study_file: Path, edited: Callable[[str, str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    run(study_file)
    folder = first(study_file).folder(load_study(study_file).output)
    before = content(folder)

    def full(path: Path) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    file = edited("[steps]", "[parameters.motion]\nmax_unseen_s = 2\n[steps]")
    with monkeypatch.context() as patch:
        patch.setattr(atomic, "_flush", full)
        outcome = run(file)
    assert outcome.status == "failed"
    assert outcome.reason.startswith(f"cannot write {folder / 'motion.parquet'}: No space left on device")
    assert "not written beside its results" in outcome.reason
    assert content(folder) == before
    assert os.listdir(folder.parent) == ["run"]
    assert run(file).ran == ALL


def test_a_problem_of_the_plan_is_a_failure(study_file: Path) -> None:
    (study_file.parent / "S01" / "A" / "Calib.toml").unlink()
    outcome = run(study_file)
    assert (outcome.status, outcome.ran) == ("failed", ())
    assert outcome.reason.startswith("it has no calibration")


def test_due_says_what_process_does(study_file: Path) -> None:
    study, recording = load_study(study_file), first(study_file)
    assert due(study, recording) == ALL
    process(study, recording)
    assert due(study, recording) == ()


@pytest.mark.slow
def test_joint_angles(edited: Callable[[str, str], Path]) -> None:
    file = edited("angles = false", "angles = true")
    outcome = run(file)
    assert outcome.ran == ("estimate", "angles", "judge")
    part = load_study(file).output / "angles" / "subject=S01" / "session=A" / "run.parquet"
    table = pq.ParquetFile(part).read()
    assert {"recording", "trial", "time_s", "person", "name", "value", "sigma", "unit"} <= set(table.column_names)
    assert "left_knee_flexion" in table["name"].to_pylist()
