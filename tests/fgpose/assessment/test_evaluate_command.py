from __future__ import annotations

import inspect
from pathlib import Path

import pytest
from made_up_people import FPS, People, make, people, standing

from fgpose.assessment.people import MATCH_M
from fgpose.association.track import TrackEvent
from fgpose.cli import main
from fgpose.cli.commands.evaluate import Evaluate
from fgpose.io.origin import Origin
from fgpose.io.trajectories import save_people, save_trajectory

OFF_M = 0.01


def estimated() -> People:
    """Two people 1 cm from where they are, the second under another number from frame 5 on; and one who is not."""
    second_m, ghost_m, time_s = standing(1 + OFF_M), standing(9), make(standing(0)).time_s
    return {
        4: make(standing(OFF_M)),
        7: make(second_m[:5]),
        9: make(second_m[5:], time_s[5:]),
        12: make(ghost_m[:5]),
    }


@pytest.fixture
def truth(tmp_path: Path) -> Path:
    (path,) = save_people(people(standing(0), standing(1)), tmp_path / "truth.parquet")
    return path


def evaluated(arguments: list[str | Path], capsys: pytest.CaptureFixture[str]) -> dict[str, list[str]]:
    """The numbers of each line by its label: the words before the first number."""
    assert main(["evaluate", *map(str, arguments)]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines() if line.strip()]
    first = [next((n for n, word in enumerate(line) if word[0].isdigit() or word == "-"), len(line)) for line in lines]
    return {" ".join(line[:n]): line[n:] for line, n in zip(lines, first, strict=True) if n} | {
        f"person {line[0]}": line[1:] for line, n in zip(lines, first, strict=True) if n == 0 and len(line) == 7
    }


def test_revised_numbers(truth: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Who is called 9 until frame 5 is recognised as 7: those frames count for nobody else by the final numbers."""
    origin = Origin(events=(TrackEvent(0.1, 9, "recognised", "by the bones", became=7),))
    (estimate,) = save_people(estimated(), tmp_path / "estimate.parquet", origin=origin)
    printed = evaluated([estimate, truth], capsys)
    # 20 true people in all frames, 25 estimated: 15 with their one number, or 20.
    assert printed["IDF1 [%]"] == [f"{100 * 2 * 15 / 45:.1f}"]
    assert printed["IDF1 by the revised numbers [%]"] == [f"{100 * 2 * 20 / 45:.1f}"]


def test_several_people(truth: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (estimate,) = save_people(estimated(), tmp_path / "estimate.parquet")
    printed = evaluated([estimate, truth], capsys)
    # 20 true people in all frames, all matched; 25 estimated.
    assert printed["recall [%]"] == ["100.0"]
    assert printed["precision [%]"] == ["80.0"]
    assert printed["F1 [%]"] == ["88.9"]
    assert printed["MOTA [%]"] == ["70.0"]
    assert printed["ID switches"] == ["1"]
    assert printed["fragmentations"] == ["0"]
    # 10 + 5 are of the identities that fit best: 2 * 15 / (20 + 25).
    assert printed["IDF1 [%]"] == ["66.7"]
    assert printed["MPJPE, absolute [mm]"] == ["10.0"]
    assert printed["PCP [%]"] == ["100.0"]
    assert printed["joints on the wrong person [%]"] == ["0.0"]
    assert 0 < float(printed["HOTA [%]"][0]) < 100
    assert printed["person 1"] == ["10", "100.0", "0", "0", "10.0", "100.0"]
    assert printed["person 2"] == ["10", "100.0", "1", "0", "10.0", "100.0"]


def test_one_person_against_several_and_the_other_way_round(
    truth: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_trajectory(make(standing(OFF_M)), tmp_path / "one.trc")
    found_one = evaluated([tmp_path / "one.trc", truth], capsys)
    assert (found_one["recall [%]"], found_one["precision [%]"]) == (["50.0"], ["100.0"])
    assert found_one["person 2"] == ["10", "0.0", "0", "0", "-", "0.0"]
    found_two = evaluated([truth, tmp_path / "one.trc"], capsys)
    assert (found_two["recall [%]"], found_two["precision [%]"]) == (["100.0"], ["50.0"])
    # A marker file has no bones.
    assert found_two["PCP [%]"] == ["-"]


def test_one_person_in_both_is_compared_as_ever(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (estimate,) = save_people({3: make(standing(OFF_M))}, tmp_path / "estimate.parquet")
    save_trajectory(make(standing(0)), tmp_path / "one.trc")
    printed = evaluated([estimate, tmp_path / "one.trc"], capsys)
    assert printed["MPJPE, absolute [mm]"] == ["10.0"]
    assert "PA-MPJPE, after Procrustes alignment [mm]" in printed


def test_distance_and_clock_are_options(truth: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    later = {number: make(each.positions_m, each.time_s + 2 / FPS) for number, each in estimated().items()}
    (estimate,) = save_people(later, tmp_path / "estimate.parquet")
    assert evaluated([estimate, truth, "--offset-s", str(2 / FPS)], capsys)["recall [%]"] == ["100.0"]
    assert evaluated([estimate, truth], capsys)["recall [%]"] == ["80.0"]
    assert evaluated([estimate, truth, "--match-m", str(OFF_M / 2)], capsys)["recall [%]"] == ["0.0"]
    assert main(["evaluate", str(estimate), str(truth), "--match-m", "0"]) == 2
    assert "match_m must be positive" in capsys.readouterr().err
    assert inspect.signature(Evaluate).parameters["match_m"].default == MATCH_M
