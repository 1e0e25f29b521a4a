"""fgpose report with nothing but a result: what its file says of its origin is on the page."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgpose.association.track import TrackEvent
from fgpose.cli import main
from fgpose.io.calibration import save_rig
from fgpose.io.keypoints import save_observations
from fgpose.io.origin import CalibrationOrigin, Origin, Reason
from fgpose.io.recordings import load_recording
from fgpose.io.trajectories import load_origin, load_trajectory, save_people
from fgpose.report import load_finished
from fgpose.report.sections.origin import without_home

pytest.importorskip("bokeh")

FINDING = Reason("", "coarse", "the focal length is a guess", "walk towards the camera")


@pytest.fixture(scope="module")
def smoothed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of one second, the clocks estimated; the calibration beside it is taken away."""
    folder = tmp_path_factory.mktemp("origin")
    rig, observations = load_recording("balance_openpose")
    save_rig(rig, folder / "Calib.toml")
    save_observations(observations.frames(slice(0, 60)), folder / "seen.npz")
    given = [str(folder / "seen.npz"), "--rig", str(folder / "Calib.toml"), "--skeleton", "body_25b"]
    options = ["--estimate-time-offsets", "--formats", "parquet", "-o", str(folder / "out")]
    assert main(["smooth", *given, *options]) == 0
    (folder / "out" / "seen_calibration.toml").unlink()
    return folder / "out" / "seen.parquet"


@pytest.mark.slow
def test_smooth_then_report(smoothed: Path) -> None:
    assert main(["report", str(smoothed)]) == 0
    page = (smoothed.parent / "report.html").read_text()
    assert "../seen.npz" in page  # from the report, not from somebody's home
    assert "fgpose smooth" in page
    assert " ± " in page
    assert "Cameras in the world" in page
    for missing in ("No calibration was given", "they were not estimated from this motion"):
        assert missing not in page


@pytest.mark.slow
def test_keypoints_are_read_where_they_still_are(smoothed: Path, tmp_path: Path) -> None:
    shutil.copytree(smoothed.parent.parent, tmp_path / "moved")
    moved = tmp_path / "moved" / "out" / smoothed.name
    seen = load_finished(moved).observations[0]
    used = load_recording("balance_openpose")[1].points2d_px[: seen.n_frames]
    known = seen.seen
    np.testing.assert_allclose(seen.points2d_px[known], used[known], atol=1e-3)  # single precision
    assert not load_finished(moved, observed=False).observations
    for change in (b"another", None):
        keypoints = tmp_path / "moved" / "seen.npz"
        keypoints.write_bytes(change) if change else keypoints.unlink()
        recording = load_finished(moved)
        assert not recording.observations
        assert "They are not there any more, or others" in recording.made_from["Keypoints"]
    assert main(["report", str(moved)]) == 0
    assert "nothing that needs them is judged" in (moved.parent / "report.html").read_text()


@pytest.mark.slow
def test_damaged_keypoints_are_a_note(smoothed: Path, tmp_path: Path) -> None:
    shutil.copytree(smoothed.parent.parent, tmp_path / "moved")
    keypoints = tmp_path / "moved" / "seen.npz"
    keypoints.write_bytes(bytes(keypoints.stat().st_size))
    recording = load_finished(tmp_path / "moved" / "out" / smoothed.name)
    assert not recording.observations
    assert "cannot be read any more" in recording.made_from["Keypoints"]


@pytest.mark.slow
def test_the_calibration_tells_a_later_result(smoothed: Path, tmp_path: Path) -> None:
    """Of its own, and of a rig that is given to the report instead of the one that was used."""
    rig = load_origin(smoothed)
    assert rig is not None
    assert rig.rig is not None
    assert rig.calibration.offset_sigma_s.keys() == set(rig.rig.names[1:])
    save_rig(rig.rig, tmp_path / "rig.toml", origin=replace(rig.calibration, grade="coarse", findings=(FINDING,)))
    arguments = [
        str(smoothed.parent.parent / "seen.npz"),
        "--rig",
        str(tmp_path / "rig.toml"),
        "--skeleton",
        "body_25b",
    ]
    assert main(["smooth", *arguments, "--frames", "20", "--formats", "parquet", "-o", str(tmp_path)]) == 0
    for given in (None, tmp_path / "rig.toml"):
        recording = load_finished(tmp_path / "seen.parquet", rig=given)
        assert recording.offset_sigma_s == rig.calibration.offset_sigma_s
        assert [each.reason for each in recording.findings] == [FINDING.reason]
        assert recording.made_from["Calibration from people"] == "coarse"
    assert not load_finished(tmp_path / "seen.parquet", rig=smoothed.parent.parent / "Calib.toml").findings


@pytest.mark.slow
def test_verdict_and_events(smoothed: Path, tmp_path: Path) -> None:
    one = load_trajectory(smoothed)
    reason = Reason(one.camera_names[0], "coarse", "the focal length is a guess", "walk towards the camera")
    rig, _ = load_recording("balance_openpose")
    origin = Origin(
        rig=rig,
        calibration=CalibrationOrigin(grade="coarse", findings=(reason,)),
        events=(TrackEvent(0.5, 1, "recognised", "by the lengths of the bones"),),
    )
    save_people({0: one, 1: one}, tmp_path / "room.parquet", origin=origin)
    assert main(["report", str(tmp_path)]) == 0
    page = (tmp_path / "report.html").read_text()
    for text in ("the focal length is a guess", "walk towards the camera", "by the lengths of the bones"):
        assert text in page


def test_paths_in_a_report_do_not_say_whose_home_they_are_in(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "home", lambda: Path("/home/ada"))
    study = Path("/home/ada/study/results/walk")
    for said, shown in {
        "/home/ada/study/results/walk/motion.parquet": "motion.parquet",
        "/home/ada/study/raw/walk.npz, 12.0 kB": "../../raw/walk.npz, 12.0 kB",
        "/home/ada/rigs/a.toml": "~/rigs/a.toml",
        "no longer read (/home/ada/study/raw/walk.npz: damaged)": "no longer read (../../raw/walk.npz: damaged)",
        "/data/home/ada/x, walk.npz": "/data/home/ada/x, walk.npz",
        "fgpose smooth /home/ada/x": "fgpose smooth ~/x",
    }.items():
        assert without_home(said, study) == shown
    assert without_home("/mnt/lab/rigs/a.toml, /home/ada/b", Path("/mnt/lab/study")) == "../rigs/a.toml, ~/b"
