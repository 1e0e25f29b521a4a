from __future__ import annotations

import pickle
from pathlib import Path

import pytest
import tyro

from fgpose_benchmarks.calibration.benchmark import CALIBRATION
from fgpose_benchmarks.calibration.methods import ABLATIONS, METHODS
from fgpose_benchmarks.calibration.scores import CalibrationScore
from fgpose_benchmarks.cli import calibrate as calibrate_command
from fgpose_benchmarks.cli.benchmark import Benchmark
from fgpose_benchmarks.cli.calibrate import Calibrate
from fgpose_benchmarks.comparison.scores import load_scores


def calibrate(*arguments: str) -> Calibrate:
    action = tyro.cli(Benchmark, args=["calibrate", *arguments]).action
    assert isinstance(action, Calibrate)
    return action


def test_quick_from_arguments_to_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(calibrate_command, "_QUICK_S", 1.5)
    chosen = ["--variants", "walk_corners_3", "--methods", "Procrustes of 3D", "--workers", "0"]
    calibrate("--quick", "--clips", "tuning", "--output", str(tmp_path), *chosen).run()
    (score,) = load_scores(tmp_path / "scores.json", CalibrationScore)
    assert (score.variant, score.clip, score.method) == ("walk_corners_3", "tuning_1", "Procrustes of 3D")
    assert len(score.position_mm) == 3
    assert score.outcome == "unjudged"
    report = (tmp_path / "report.md").read_text(encoding="utf-8")
    command = "fgpose benchmark calibrate --quick --clips tuning --variants walk_corners_3 --methods 'Procrustes of 3D'"
    assert f"    {command}\n" in report
    assert f"wrote {tmp_path / 'report.md'}" in capsys.readouterr().out
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "cache").iterdir()}
    assert len(kept) == 1
    calibrate("--quick", "--clips", "tuning", "--output", str(tmp_path), *chosen).run()
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "cache").iterdir()} == kept


def test_other_processes_can_be_given_the_work():
    methods = [*METHODS, *ABLATIONS]
    sent = pickle.loads(pickle.dumps((CALIBRATION, methods)))
    assert [method.name for method in sent[1]] == [method.name for method in methods]
    assert sent[0].score is CALIBRATION.score


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--variants", "none"), "no variant 'none'"),
        (("--methods", "magic"), "no method magic"),
        (("--workers", "-1"), "--workers must not be negative, got -1"),
        (("--draws", "6"), "--draws must be 1 to 5, got 6"),
        (("--ablation", "--methods", "fgpose"), "no method fgpose; there is as it is; no referee"),
    ],
)
def test_a_wrong_name_or_number_is_refused_before_any_work(arguments: tuple[str, ...], message: str, tmp_path: Path):
    with pytest.raises(ValueError, match=message):
        calibrate("--output", str(tmp_path / "results"), *arguments).run()
    assert not (tmp_path / "results").exists()
