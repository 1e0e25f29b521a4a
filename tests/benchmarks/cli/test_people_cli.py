from __future__ import annotations

import pickle
from pathlib import Path

import pytest
import tyro

from fgpose_benchmarks.cli import people as command
from fgpose_benchmarks.cli.benchmark import Benchmark
from fgpose_benchmarks.cli.people import People
from fgpose_benchmarks.comparison.scores import load_scores
from fgpose_benchmarks.people.ablation import ablations
from fgpose_benchmarks.people.benchmark import PEOPLE
from fgpose_benchmarks.people.methods import METHODS
from fgpose_benchmarks.people.scores import PeopleScore

VARIANT = "2_people_3_cameras"


def people(*arguments: str) -> People:
    action = tyro.cli(Benchmark, args=["people", *arguments]).action
    assert isinstance(action, People)
    return action


@pytest.fixture
def _tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "_QUICK_S", 0.7)


@pytest.mark.usefixtures("_tiny")
def test_quick_from_arguments_to_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    chosen = ["--variants", VARIANT, "--methods", "greedy triangulation", "told who is who", "--workers", "0"]
    people("--quick", "--clips", "tuning", "--output", str(tmp_path), *chosen).run()
    greedy, told = load_scores(tmp_path / "scores.json", PeopleScore)
    assert [(s.variant, s.clip, s.method) for s in (greedy, told)] == [
        (VARIANT, "tuning_1", "greedy triangulation"),
        (VARIANT, "tuning_1", "told who is who"),
    ]
    # Of two people, told who is who: everybody, and nobody else.
    assert (told.recall, told.n_identities, told.switches) == (1.0, told.n_people, 0.0)
    assert told.mpjpe_mm < greedy.mpjpe_mm
    report = (tmp_path / "report.md").read_text(encoding="utf-8")
    assert (
        "    fgpose benchmark people --quick --clips tuning --variants 2_people_3_cameras "
        "--methods 'greedy triangulation' 'told who is who'\n"
    ) in report
    assert f"wrote {tmp_path / 'report.md'}" in capsys.readouterr().out
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "cache").iterdir()}
    assert len(kept) == 2
    people("--quick", "--clips", "tuning", "--output", str(tmp_path), *chosen).run()
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "cache").iterdir()} == kept


def test_other_processes_can_be_given_the_work():
    methods = [*METHODS, *ablations()]
    sent = pickle.loads(pickle.dumps((PEOPLE, methods)))
    assert [method.name for method in sent[1]] == [method.name for method in methods]
    assert sent[0].score is PEOPLE.score


@pytest.mark.usefixtures("_tiny")
def test_the_ablation_has_methods_of_its_own(tmp_path: Path):
    chosen = ["--variants", VARIANT, "--methods", "no hand-over of joints", "--workers", "0", "--no-cache"]
    people("--quick", "--ablation", "--output", str(tmp_path), *chosen).run()
    (score,) = load_scores(tmp_path / "scores.json", PeopleScore)
    assert score.method == "no hand-over of joints"
    assert not (tmp_path / "cache").exists()
    with pytest.raises(ValueError, match="no method RapidPose-like; there is as it is; fixed gates"):
        people("--ablation", "--methods", "RapidPose-like").run()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--variants", "none"), "no variant 'none'"),
        (("--methods", "magic"), "no method magic"),
        (("--workers", "-1"), "--workers must not be negative, got -1"),
    ],
)
def test_a_wrong_name_or_number_is_refused_before_any_work(arguments: tuple[str, ...], message: str, tmp_path: Path):
    with pytest.raises(ValueError, match=message):
        people("--output", str(tmp_path / "results"), *arguments).run()
    assert not (tmp_path / "results").exists()
