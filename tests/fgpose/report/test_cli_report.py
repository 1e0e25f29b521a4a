"""fgpose report: files in, a file and words out."""

from __future__ import annotations

from pathlib import Path

import pytest
from finished_walk import finished_walk
from test_quality import late_camera, other_camera

from fgpose.cli import main
from fgpose.geometry.camera import CameraRig
from fgpose.io.calibration import save_rig
from fgpose.io.keypoints import save_observations
from fgpose.io.origin import Origin
from fgpose.io.trajectories import save_trajectory
from fgpose.report import FinishedRecording
from fgpose.skeleton import Skeleton

pytest.importorskip("bokeh")


@pytest.fixture(scope="module")
def walk(rig: CameraRig, skeleton: Skeleton) -> FinishedRecording:
    return finished_walk(rig, skeleton)


def written(recording: FinishedRecording, folder: Path) -> tuple[str, str]:
    """Calibration and keypoints of a recording, whose trajectory is in the folder out."""
    assert recording.rig is not None
    save_trajectory(recording.main, folder / "out" / "walk.parquet")
    save_rig(recording.rig, folder / "rig.toml")
    save_observations(recording.observations[0], folder / "seen.npz")
    return str(folder / "rig.toml"), str(folder / "seen.npz")


@pytest.mark.slow
def test_the_suspicions_are_printed(
    walk: FinishedRecording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig, seen = written(late_camera(walk), tmp_path)
    assert main(["report", str(tmp_path / "out"), "--rig", rig, "--keypoints", seen]) == 0
    printed = capsys.readouterr().out
    assert "1. ring_1 takes its images 1.0 frames (3" in printed
    assert f"wrote {tmp_path / 'out' / 'report.html'}" in printed
    # Beside its results the page is no result.
    assert main(["report", str(tmp_path / "out"), "-o", str(tmp_path / "second.html")]) == 0
    assert "nothing is suspicious" in capsys.readouterr().out
    assert (tmp_path / "second.html").is_file()


@pytest.mark.slow
def test_a_file_can_be_named(walk: FinishedRecording, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    written(other_camera(walk), tmp_path)
    assert main(["report", str(tmp_path / "out" / "walk.parquet")]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith(f"{tmp_path / 'out' / 'walk.parquet'}\n")
    assert "camera ring_2 disagrees" in printed


@pytest.mark.slow
def test_results_of_one_folder_have_reports_of_their_own(
    walk: FinishedRecording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "out").mkdir()
    save_trajectory(walk.main, tmp_path / "out" / "a.parquet", origin=Origin(step="smooth"))
    save_trajectory(walk.main, tmp_path / "out" / "b.parquet", origin=Origin(step="refine"))
    assert main(["report", str(tmp_path / "out")]) == 2
    assert "results of a (fgpose smooth), b (fgpose refine): say which (--name NAME)" in capsys.readouterr().err
    assert main(["report", str(tmp_path / "out"), "--name", "b"]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith(f"{tmp_path / 'out' / 'b.parquet'}, made by fgpose refine\n")
    assert f"wrote {tmp_path / 'out' / 'report_b.html'}" in printed


def test_what_a_marker_file_does_not_tell_is_said(
    walk: FinishedRecording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_trajectory(walk.main, tmp_path / "walk.trc")
    assert main(["report", str(tmp_path / "walk.trc")]) == 0
    unknown = "cameras, detections, reprojection errors, covariances and bones are not known"
    printed = capsys.readouterr().out
    assert f"nothing is suspicious in what was judged\nonly the motion itself was judged: {unknown}\n" in printed
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Nothing is suspicious in the motion itself" in page
    assert f"Only the motion itself was judged: {unknown}." in page
    assert "TRC and C3D files hold none: report the parquet or npz of the same result" in page


def test_a_report_is_not_written_through_a_link_that_nobody_named(
    walk: FinishedRecording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A result of somebody else could have a link to any file where its report would be."""
    (tmp_path / "out").mkdir()
    save_trajectory(walk.main, tmp_path / "out" / "walk.parquet", origin=Origin(step="smooth"))
    (tmp_path / "thesis.txt").write_text("all my work")
    link = tmp_path / "out" / "report.html"
    link.symlink_to(tmp_path / "thesis.txt")
    assert main(["report", str(tmp_path / "out")]) == 2
    assert f"{link} is a link, to {tmp_path / 'thesis.txt'}: name it with --output" in capsys.readouterr().err
    assert (tmp_path / "thesis.txt").read_text() == "all my work"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "nowhere: there is no such file or folder"),
        (["."], "no result of fgpose"),
        (["out", "--name", "other"], "out: there is no result other, only walk"),
        (["out", "--keypoints", "seen.npz"], "keypoints are shown with a calibration"),
        (["out", "--rig", "rig.toml", "--videos", "out"], "out: no videos"),
        (["out", "--rig", "out/walk.parquet"], "walk.parquet"),
    ],
)
def test_bad_input_is_one_line(
    walk: FinishedRecording,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    message: str,
) -> None:
    written(walk, tmp_path)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "seen.npz").rename(tmp_path / "out" / "seen.npz")
    assert main(["report", *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("fgpose: error") == 1
    assert not (tmp_path / "out" / "report.html").exists()
