from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgpose_benchmarks.comparison.scores import Score, load_scores, save_scores
from fgpose_benchmarks.people.report import write_report
from fgpose_benchmarks.people.scores import PeopleScore

VARIANT = "4_people_5_cameras"
PERFECT = PeopleScore(
    variant=VARIANT,
    clip="test_1",
    method="told who is who",
    group="oracle",
    recall=1.0,
    precision=1.0,
    f1=1.0,
    mota=1.0,
    idf1=1.0,
    idf1_revised=1.0,
    hota=1.0,
    switches=0.0,
    fragmentations=0.0,
    mpjpe_mm=20.0,
    pcp=1.0,
    wrong_person=0.0,
    missing=0.0,
    n_identities=4,
    n_people=4,
    ms_per_frame=5.0,
    minutes=0.5,
    person_minutes=2.0,
    n_short_returns=2,
    n_short_recognised=2,
    n_long_returns=0,
    n_long_recognised=0,
    n_arrivals=3,
    n_mistaken=0,
    n_passes=6,
    pass_switches=0,
    n_close_passes=1,
    close_switches=0,
    confirmed_s=(0.0, 0.0, 0.0),
    n_unconfirmed=0,
    false_tracks_s=(),
)
OURS = replace(PERFECT, method="fgpose batch", group="ours", idf1=0.98, switches=0.5, mpjpe_mm=23.0)
OTHER = replace(OURS, method="Chen-like", group="baseline", idf1=0.9, switches=1.5, mpjpe_mm=46.0)


def lines(path: Path) -> list[str]:
    return path.read_text(encoding="utf-8").splitlines()


def cells(path: Path, method: str, table: int = 0) -> dict[str, str]:
    """Of one method in the three tables of this number."""
    starts = [n for n, line in enumerate(lines(path)) if line.startswith("| method ")][3 * table : 3 * table + 3]
    found: dict[str, str] = {}
    for start in starts:
        rows = [
            [cell.strip() for cell in line.strip("|").split("|")]
            for line in lines(path)[start:]
            if line.startswith("|")
        ]
        row = next(row for row in rows if row[0] == method)
        found |= dict(zip(rows[0], row, strict=True))
    return found


def test_every_method_stands_beside_the_one_that_is_told(tmp_path: Path):
    path = write_report([OTHER, OURS, PERFECT], tmp_path, "fgpose benchmark people")
    assert path == tmp_path / "report.md"
    ours, other, told = (cells(path, method) for method in ("fgpose batch", "Chen-like", "told who is who"))
    assert (ours["/ told"], other["/ told"], told["/ told"]) == ("1.15", "2.30", "1.00")
    # The best are bold, where more and where less is better; never the one that is told.
    assert (ours["IDF1"], other["IDF1"], told["IDF1"]) == ("**98.0**", "90.0", "100.0")
    assert (ours["switches"], other["switches"], told["switches"]) == ("**0.50**", "1.50", "0.00")
    assert "    fgpose benchmark people" in lines(path)
    assert "4 people, 5 cameras at 2.7 m, 30 Hz." in lines(path)


def test_what_is_counted_is_counted_over_all_recordings(tmp_path: Path):
    first = replace(OURS, n_short_recognised=1, n_mistaken=1, pass_switches=1, confirmed_s=(0.1, 0.2, 0.3))
    second = replace(first, clip="test_2", confirmed_s=(0.2, 1.0), n_unconfirmed=1, false_tracks_s=(0.4, 0.1))
    path = write_report([first, second, PERFECT], tmp_path, "")
    ours, told = cells(path, "fgpose batch"), cells(path, "told who is who")
    # The median of 0.1, 0.2, 0.2, 0.3 and 1 s; 95 % lie below 0.3 + 0.8 x 0.7 s.
    assert (ours["found after"], ours["95 %"], ours["never"]) == ("**200**", "**860**", "**1**")
    # Two in 2 x 0.5 minutes.
    assert (ours["false tracks"], ours["longest"]) == ("**20.0**", "0.40")
    assert (told["false tracks"], told["longest"]) == ("0.0", "–")
    assert (ours["back in 5 s"], ours["back later"], ours["mistaken"]) == ("**2 of 4**", "–", "**2 of 6**")
    # Two in 2 x 2 minutes of people, at twelve encounters.
    assert (ours["at 0.5–1 m"], ours["nearer"]) == ("**0.50** (12)", "**0.00** (2)")


def test_without_it_there_is_no_ratio(tmp_path: Path):
    assert cells(write_report([OURS], tmp_path, ""), "fgpose batch")["/ told"] == "–"


def test_variants_of_a_group_are_also_taken_together(tmp_path: Path):
    harder = replace(OURS, variant="6_people_3_cameras", idf1=0.9)
    low = replace(OURS, variant="4_people_5_cameras_low", idf1=0.5)
    path = write_report([OURS, harder, low], tmp_path, "")
    headings = [line for line in lines(path) if line.startswith("##")]
    assert headings == [
        "## High cameras",
        "### 4 people 5 cameras",
        "### 6 people 3 cameras",
        "## Low cameras",
        "### 4 people 5 cameras low",
    ]
    assert [cells(path, "fgpose batch", table)["IDF1"].strip("*") for table in range(4)] == [
        "94.0",
        "98.0",
        "90.0",
        "50.0",
    ]


def test_a_report_is_written_whole_or_not_at_all(tmp_path: Path):
    path = write_report([OURS], tmp_path, "first")
    with pytest.raises(ValueError, match="two scores of the method fgpose batch"):
        write_report([OURS, OURS], tmp_path, "second")
    assert "    first" in lines(path)
    assert [each.name for each in tmp_path.iterdir()] == ["report.md"]


def test_scores_survive_the_disk_and_are_not_taken_for_others(tmp_path: Path):
    path = tmp_path / "scores.json"
    before = [OURS, replace(OURS, clip="test_2", mpjpe_mm=np.nan)]
    save_scores(before, path)
    first, second = load_scores(path, PeopleScore)
    assert first == OURS
    assert np.isnan(second.mpjpe_mm)
    with pytest.raises(ValueError, match=r"scores\.json: not a list of scores"):
        load_scores(path, Score)
