from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgpose.benchmark.people.report import write_report
from fgpose.benchmark.people.scores import PeopleScore
from fgpose.benchmark.scores import Score, load_scores, save_scores

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
)
OURS = replace(PERFECT, method="fgpose batch", group="ours", idf1=0.98, switches=0.5, mpjpe_mm=23.0)
OTHER = replace(OURS, method="Chen-like", group="baseline", idf1=0.9, switches=1.5, mpjpe_mm=46.0)


def lines(path: Path) -> list[str]:
    return path.read_text(encoding="utf-8").splitlines()


def cells(path: Path, method: str, table: int = 0) -> dict[str, str]:
    """Of one method in the table of this number."""
    start = [n for n, line in enumerate(lines(path)) if line.startswith("| method ")][table]
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in lines(path)[start:] if line.startswith("|")
    ]
    row = next(row for row in rows if row[0] == method)
    return dict(zip(rows[0], row, strict=True))


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
