"""fgpose study as a user runs it."""

from __future__ import annotations

from pathlib import Path

import pytest

from fgpose.cli import main
from fgpose.io.calibration import save_rig
from fgpose.io.keypoints import save_observations
from fgpose_benchmarks.synthetic import Scene

STUDY = """
output = "results"
[data]
keypoints = "{subject}/{trial}.npz"
calibration = "{subject}/Calib.toml"
skeleton = "h36m_17"
[steps]
angles = false
formats = []
"""


@pytest.fixture
def study(walking_scene: Scene, tmp_path: Path) -> Path:
    """Two recordings, of which one is empty."""
    save_rig(walking_scene.rig, tmp_path / "S01" / "Calib.toml")
    save_observations(walking_scene.observations.frames(slice(0, 10)), tmp_path / "S01" / "walk.npz")
    (tmp_path / "S01" / "void.npz").touch()
    file = tmp_path / "study.toml"
    file.write_text(STUDY)
    return file


def test_a_study_is_run_and_summed_up(study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["study", str(study), "--workers", "1"]) == 1
    printed = capsys.readouterr()
    assert "1 done, 0 unchanged, 1 failed" in printed.out
    assert "failed: S01/all/void: " in printed.out
    assert "quality.csv" in printed.out
    assert "study: 2 of 2 recordings (100 %) in " in printed.err
    assert main(["study", str(study), "--dry-run"]) == 0
    plan = capsys.readouterr().out
    assert "S01/all/walk" in plan
    assert "2 recordings: 1 to be done, 0 cannot be, 1 unchanged." in plan


def test_the_plan_names_what_cannot_be_done(study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (study.parent / "S01" / "Calib.toml").unlink()
    assert main(["study", str(study), "--dry-run", "--only", "*/walk"]) == 1
    plan = " ".join(capsys.readouterr().out.split())
    assert "it has no calibration" in plan
    assert "1 recordings: 0 to be done, 1 cannot be, 0 unchanged." in plan
    assert not (study.parent / "results").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--only", "S09/*"], "no recording matches 'S09/*'"),
        (["--workers", "0"], "--workers must be at least 1, got 0"),
    ],
)
def test_what_cannot_be_is_one_line(
    study: Path, options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["study", str(study), *options]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_a_study_that_is_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["study", str(tmp_path / "none.toml")]) == 2
    assert "none.toml --init writes one" in capsys.readouterr().err


@pytest.mark.slow
def test_the_demonstration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    import fgpose_benchmarks.demo_study as demo_data

    # As it is, but short.
    whole = demo_data.write_demo_study
    monkeypatch.setattr(
        demo_data, "write_demo_study", lambda folder: whole(folder, 0.2, sessions=("evening",), report=False)
    )
    monkeypatch.setattr(demo_data, "_SIZES", {"S03": 1.06})
    assert main(["demo", "--study", "--output", str(tmp_path)]) == 0
    assert "1 done, 0 unchanged, 1 failed" in capsys.readouterr().out
    assert (tmp_path / "demo_study" / "results" / "report.html").stat().st_size > 100_000
