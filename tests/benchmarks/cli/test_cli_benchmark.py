from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest
import tyro

from fgpose_benchmarks.accuracy.variants import Variant
from fgpose_benchmarks.cli import benchmark
from fgpose_benchmarks.cli.benchmark import Benchmark, Open, Report
from fgpose_benchmarks.comparison.recording import BenchmarkRecording, Method
from fgpose_benchmarks.comparison.scores import Score, load_scores


def parsed(*arguments: str) -> Benchmark:
    return tyro.cli(Benchmark, args=Benchmark.completed([*arguments]))


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


@pytest.mark.parametrize("arguments", [["--help"], ["report"], ["people", "--quick"]])
def test_a_named_benchmark_stays_as_it_is(arguments):
    assert Benchmark.completed(arguments) == arguments


@pytest.mark.slow
def test_quick_from_arguments_to_report(tiny, folder, capsys):
    chosen = ("--variants", "clean", "--methods", "DLT", "fgpose batch", "--workers", "1")
    parsed("--quick", "--output", str(folder), *chosen).run()
    scores = load_scores(folder / "scores.json", Score)
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


@pytest.mark.slow
def test_errors_are_held_against_those_that_are_stored(tiny, tmp_path, capsys):
    stored = tmp_path / "stored.json"
    chosen = ("--quick", "--variants", "clean", "--methods", "DLT", "--workers", "1")
    here = ("--output", str(tmp_path / "results"))
    parsed(*chosen, *here, "--store", str(stored)).run()
    assert f"wrote {stored}" in capsys.readouterr().out
    parsed(*chosen, *here, "--check", str(stored)).run()
    assert "the errors are those stored in" in capsys.readouterr().out
    content = json.loads(stored.read_text())
    for name in ("mean_mm", "low_mm", "high_mm"):
        content["intervals"][0][name] /= 2
    stored.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=r"1 errors are not those stored in .*stored\.json"):
        parsed(*chosen, *here, "--check", str(stored)).run()
    assert "! clean, DLT: MPJPE" in capsys.readouterr().out


def test_a_missing_file_of_errors_is_named_before_any_work(tmp_path):
    with pytest.raises(FileNotFoundError) as error:
        parsed("--quick", "--output", str(tmp_path / "results"), "--check", str(tmp_path / "absent.json")).run()
    assert error.value.filename == str(tmp_path / "absent.json")
    assert list((tmp_path / "results").iterdir()) == []


@pytest.mark.parametrize("option", ["--check", "--store"])
def test_errors_that_are_kept_do_not_depend_on_aniposelib(option, tmp_path):
    options = Open(aniposelib=Path(sys.executable), **{option[2:]: tmp_path / "stored.json"})
    assert not any(method.group == "peer" for method in options._methods())
    assert any(method.group == "peer" for method in Open(aniposelib=Path(sys.executable))._methods())


def test_quick_leaves_out_the_slowest_method_unless_it_is_named():
    slow = "fgpose batch, self-calibrated"
    assert slow not in [method.name for method in Open(quick=True)._methods()]
    assert slow in [method.name for method in Open()._methods()]
    assert [method.name for method in Open(quick=True, methods=(slow,))._methods()] == [slow]


def test_the_other_families_run_few_methods_unless_more_are_named(folder, monkeypatch):
    asked: list[tuple[list[str], list[str]]] = []

    def nothing(_: object, recordings: Iterable[BenchmarkRecording], methods: list[Method], *__: object) -> list[Score]:
        names = sorted({recording.variant for recording in recordings})
        asked.append((names, [method.name for method in methods]))
        return []

    monkeypatch.setattr("fgpose_benchmarks.comparison.runner.run", nothing)
    monkeypatch.setattr(benchmark, "_QUICK_FRAMES", 2)
    few = ["MSAC by confidence", "fgpose online, lag 0.2 s", "fgpose batch", "oracle"]
    for methods in ((), ("DLT", "oracle")):
        options = Open(quick=True, variants=("clean", "lost", "snapping", "real"), methods=methods, output=folder)
        options._scores(options._variants(), options._methods())
    (standard, every), (others, fewer), (all_four, named) = asked
    assert (standard, others) == (["clean", "lost"], ["real", "snapping"])
    assert (len(every) > 10, fewer) == (True, few)
    assert (all_four, named) == (["clean", "lost", "real", "snapping"], ["DLT", "oracle"])


def test_an_ablation_is_of_the_standard_family():
    assert {variant.family for variant in Open(ablation=True)._variants()} == {"standard"}
    assert len(Open()._variants()) > len(Open(ablation=True)._variants()) == 12


@pytest.mark.slow
def test_the_ablation_removes_one_ingredient_at_a_time(tiny, folder):
    chosen = ("--variants", "clean", "--methods", "as it is", "no motion model", "--workers", "1")
    parsed("--ablation", "--quick", "--output", str(folder), *chosen).run()
    whole, without = (score for score in load_scores(folder / "scores.json", Score) if score.clip == "cmu_01_01_a")
    assert (whole.method, without.method) == ("as it is", "no motion model")
    # Without a motion model every frame keeps its noise: several times the acceleration error, on 12 frames too.
    assert without.acceleration_mm_per_frame2 > 2 * whole.acceleration_mm_per_frame2


def test_every_benchmark_is_known_by_its_name(capsys):
    for action in benchmark.ACTIONS:
        with pytest.raises(SystemExit) as end:
            parsed(action, "--help")
        assert end.value.code == 0
        assert "Example: fgpose benchmark " in capsys.readouterr().out
