from __future__ import annotations

import sys
from pathlib import Path

import pytest
import tyro

from fgpose.benchmark.recording import Method
from fgpose.benchmark.scores import Score, load_scores
from fgpose.benchmark.variants import Variant
from fgpose.cli import benchmark
from fgpose.cli.benchmark import Benchmark, Open, Report, with_action


def parsed(*arguments: str) -> Benchmark:
    return tyro.cli(Benchmark, args=with_action(["benchmark", *arguments])[1:])


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmark, "_QUICK_FRAMES", 12)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "results"


def test_open_is_meant_where_nothing_is_named():
    assert parsed().action == parsed("open").action == Open()
    assert parsed("--quick", "-o", "there").action == Open(quick=True, output=Path("there"))
    assert parsed("open", "--no-cache", "--variants", "clean", "lost").action == Open(
        cache=False, variants=("clean", "lost")
    )
    assert parsed("report", "there").action == Report(folder=Path("there"))


@pytest.mark.parametrize("arguments", [["smooth", "--quick"], ["benchmark", "--help"], ["benchmark", "report"], []])
def test_other_arguments_stay_as_they_are(arguments):
    assert with_action(arguments) == arguments


def test_quick_from_arguments_to_report(tiny, folder, capsys):
    chosen = ("--variants", "clean", "--methods", "DLT", "fgpose batch", "--workers", "1")
    parsed("--quick", "--output", str(folder), *chosen).run()
    scores = load_scores(folder / "scores.json")
    assert [(score.method, score.variant) for score in scores] == [("DLT", "clean"), ("fgpose batch", "clean")] * 2
    assert all(0 < score.mpjpe_mm < 50 for score in scores)
    report = (folder / "report.md").read_text(encoding="utf-8")
    assert "fgpose benchmark --quick --variants clean --methods DLT 'fgpose batch'" in report
    assert f"wrote {folder / 'report.md'}" in capsys.readouterr().out
    assert len(list((folder / "cache").iterdir())) == 4
    (folder / "report.md").unlink()
    parsed("report", str(folder)).run()
    assert (folder / "report.md").exists()


def test_aniposelib_is_missed_where_it_is_not(folder, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    asked: list[str] = []

    def nothing(self: Open, variants: list[Variant], methods: list[Method]) -> list[Score]:
        asked.extend(method.group for method in methods)
        return []

    monkeypatch.setattr(Open, "_scores", nothing)
    monkeypatch.setattr(benchmark, "_report", lambda folder, command: None)
    parsed("--output", str(folder)).run()
    assert "aniposelib was left out" in capsys.readouterr().out
    assert "peer" not in asked
    parsed("--output", str(folder), "--aniposelib", sys.executable).run()
    assert "left out" not in capsys.readouterr().out
    assert "peer" in asked


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--variants", "dirty"), "no variant 'dirty'"),
        (("--methods", "magic"), "no method magic"),
        (("--workers", "0"), "--workers must be at least 1, got 0"),
    ],
)
def test_a_wrong_name_or_number_is_refused_before_any_work(arguments, message, folder):
    with pytest.raises(ValueError, match=message):
        parsed("--output", str(folder), *arguments).run()
    assert not folder.exists()


def test_a_missing_environment_is_refused_before_any_work(folder):
    with pytest.raises(OSError, match="no Python for aniposelib at nowhere"):
        parsed("--output", str(folder), "--aniposelib", "nowhere").run()
    assert not folder.exists()
