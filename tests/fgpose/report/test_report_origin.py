"""fgpose report with nothing but a result: what its file says of its origin is on the page."""

from __future__ import annotations

from pathlib import Path

import pytest

from fgpose.association.track import TrackEvent
from fgpose.cli import main
from fgpose.io.calibration import save_rig
from fgpose.io.keypoints import save_observations
from fgpose.io.origin import CalibrationOrigin, Origin, Reason
from fgpose.io.recordings import load_recording
from fgpose.io.trajectories import load_trajectory, save_people

pytest.importorskip("bokeh")


@pytest.fixture(scope="module")
def smoothed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of two seconds, the clocks estimated; the calibration beside it is taken away."""
    folder = tmp_path_factory.mktemp("origin")
    rig, observations = load_recording("balance_openpose")
    save_rig(rig, folder / "Calib.toml")
    save_observations(observations.frames(slice(0, 120)), folder / "seen.npz")
    given = [str(folder / "seen.npz"), "--rig", str(folder / "Calib.toml"), "--skeleton", "body_25b"]
    options = ["--estimate-time-offsets", "--formats", "parquet", "-o", str(folder / "out")]
    assert main(["smooth", *given, *options]) == 0
    (folder / "out" / "seen_calibration.toml").unlink()
    return folder / "out" / "seen.parquet"


@pytest.mark.slow
def test_smooth_then_report(smoothed: Path) -> None:
    assert main(["report", str(smoothed)]) == 0
    page = (smoothed.parent / "report.html").read_text()
    assert str(smoothed.parent.parent / "seen.npz") in page
    assert "fgpose smooth" in page
    assert " ± " in page
    assert "Cameras in the world" in page
    for missing in ("No calibration was given", "they were not estimated from this motion"):
        assert missing not in page


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
