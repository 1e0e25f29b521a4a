from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from fgpose_benchmarks.accuracy.report import TOLERANCE, check_against, store_intervals, write_report
from fgpose_benchmarks.accuracy.variants import VERSION
from fgpose_benchmarks.comparison.scores import Score
from fgpose_benchmarks.comparison.summary import summarise
from fgpose_benchmarks.comparison.tables import (
    absolute_errors,
    all_numbers,
    calibration,
    comparison,
    of_family,
    time_offsets,
)
from tests.benchmarks.comparison.made_up_scores import made_up, over_clips

NONE = (np.nan,) * 3


@pytest.fixture
def scores() -> list[Score]:
    others = {"coverage": NONE, "coverage_occluded": NONE, "nees": np.nan}
    return [
        *over_clips([50.0, 70.0], method="RANSAC", group="per-frame", p95_mm=90.0, **others),
        *over_clips([50.0, 50.0], method="DLT + Butterworth", group="linear", acceleration_mm_per_frame2=2.0, **others),
        *over_clips([40.0, 40.0], method="aniposelib", group="peer", p95_mm=140.0, **others),
        *over_clips([10.0, 30.0], method="fgpose batch", group="ours", p95_mm=45.0, coverage=(0.47, 0.9, 0.97)),
        *over_clips([10.0, 15.0], method="oracle", group="oracle"),
    ]


def rows_of(table: str) -> dict[str, dict[str, str]]:
    """The cells of a Markdown table by the names of row and column."""
    lines = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in table.splitlines()]
    header, _, *rows = lines
    assert all(len(row) == len(header) for row in rows), "a row of another length is no table on GitHub"
    return {row[0]: dict(zip(header, row, strict=True)) for row in rows}


def test_the_best_is_bold_and_never_the_oracle(scores):
    column = {method: row["occluded"] for method, row in rows_of(absolute_errors(summarise(scores))).items()}
    # Two recordings: the interval reaches from one to the other.
    assert column["fgpose batch"] == "**20.0** ±10.0"
    assert column["oracle"] == "12.5 ±2.5"
    assert column["aniposelib"] == "40.0 ±0.0"
    assert [method for method, cell in column.items() if "**" in cell] == ["fgpose batch"]


def test_who_shows_the_digits_of_the_best_is_as_good(scores):
    equal = over_clips([19.99, 20.01], method="fgpose online", group="ours")
    column = rows_of(absolute_errors(summarise([*scores, *equal])))
    assert column["fgpose online"]["occluded"].startswith("**20.0**")
    assert column["fgpose batch"]["occluded"].startswith("**20.0**")


def test_methods_stand_under_their_groups(scores):
    rows = list(rows_of(absolute_errors(summarise(scores))))
    assert rows == [
        "*per-frame*",
        "RANSAC",
        "*linear*",
        "DLT + Butterworth",
        "*peer*",
        "aniposelib",
        "*ours*",
        "fgpose batch",
        "oracle",
    ]


def test_means_over_fewer_recordings_are_marked_and_missing_ones_are_a_dash(scores):
    fewer = [
        made_up(clip="a", method="half", group="file", mpjpe_mm=60.0),
        made_up(clip="b", method="half", group="file", mpjpe_mm=np.nan),
        made_up(variant="clean", clip="a", method="clean only", group="file", mpjpe_mm=5.0),
    ]
    rows = rows_of(absolute_errors(summarise([*scores, *fewer])))
    assert rows["half"]["occluded"] == "60.0†"
    assert rows["clean only"]["occluded"] == "–"
    assert rows["clean only"]["clean"] == "**5.0**"


def test_many_variants_are_put_into_narrow_tables():
    tables = absolute_errors(summarise([made_up(variant=f"variant_{number}") for number in range(8)])).split("\n\n")
    columns = [list(rows_of(table)["fgpose batch"])[1:] for table in tables]
    assert columns == [[f"variant {number}" for number in range(6)], ["variant 6", "variant 7"]]


def test_every_number_is_in_the_table_of_a_variant(scores):
    row = rows_of(all_numbers(summarise(scores), "occluded"))["fgpose batch"]
    assert row == {
        "method": "fgpose batch",
        "absolute": "**20.0** ±10.0",
        "relative": "**30.0**",
        "median": "**25.0**",
        "95 %": "**45.0**",
        "PCK": "**97.5**",
        "missing": "0.0",
        "accel.": "2.50",
        "bones": "**6.0**",
        "ms": "4.00",
        "50/90/99 %": "47/90/97",
        "NEES": "1.10",
    }
    assert rows_of(all_numbers(summarise(scores), "occluded"))["RANSAC"]["50/90/99 %"] == "–"


def test_more_correct_keypoints_are_better():
    scores = [made_up(pck_150mm=0.9), made_up(method="DLT", group="per-frame", pck_150mm=0.8)]
    rows = rows_of(all_numbers(summarise(scores), "occluded"))
    assert (rows["fgpose batch"]["PCK"], rows["DLT"]["PCK"]) == ("**90.0**", "80.0")


def test_ratios_are_to_the_best_in_that_very_number(scores):
    row = rows_of(comparison(summarise(scores), "fgpose batch"))["occluded"]
    assert row["best other"] == "aniposelib, 40.0"
    assert row["ours"] == "20.0"
    assert row["ours / best other"] == "0.50 (0.25–0.75)"
    assert row["at 95 %"] == "0.56 (0.56–0.56)"  # 45 mm, and 80 mm of the linear smoother
    assert row["ours / oracle"] == "1.60 (1.00–2.00)"  # 20 mm of 12.5 mm; on the clips 10/10 and 30/15
    assert row["acceleration / linear"] == "1.25 (1.25–1.25)"


def test_where_there_is_nobody_to_compare_with_there_is_no_ratio():
    row = rows_of(comparison(summarise([made_up()]), "fgpose batch"))["occluded"]
    assert [row[name] for name in ("best other", "ours / best other", "ours / oracle")] == ["–", "–", "–"]


@pytest.fixture
def other_family() -> list[Score]:
    online = "fgpose online, lag 0.2 s"
    return [
        *over_clips([30.0, 50.0], variant="snapping", method="fgpose batch", group="ours", p95_mm=70.0),
        *over_clips([60.0, 60.0], variant="snapping", method=online, group="ours", p95_mm=90.0),
        *over_clips([20.0, 20.0], variant="snapping", method="oracle", group="oracle", p95_mm=35.0),
        *over_clips([80.0, 90.0], variant="snapping", method="MSAC", group="per-frame", p95_mm=150.0),
    ]


def test_a_family_is_held_against_its_oracle(other_family):
    row = rows_of(of_family(summarise(other_family), ["snapping"]))["snapping"]
    assert row == {
        "variant": "snapping",
        "best per frame": "85.0, 150.0",
        "online, lag 0.2 s": "60.0, 90.0",
        "batch": "40.0, 70.0",
        "oracle": "20.0, 35.0",
        "batch / oracle": "2.00 (1.50–2.50)",
        "online / batch": "1.50 (1.20–2.00)",
    }
    without = [score for score in other_family if score.group != "oracle"]
    row = rows_of(of_family(summarise(without), ["snapping"]))["snapping"]
    assert (row["oracle"], row["batch / oracle"]) == ("–", "–")


@pytest.mark.slow
def test_the_standard_family_keeps_its_tables(tmp_path, scores, other_family):
    before, *_ = write_report(scores, tmp_path / "before")
    after, *_ = write_report([*scores, *other_family], tmp_path / "after")
    before, after = (path.read_text(encoding="utf-8") for path in (before, after))
    for title in ("## Absolute MPJPE (mm)", "### fgpose batch", "### All joints"):
        assert before.split(title)[1].split("\n\n")[1] in after
    assert "### Family: snapping" in after
    assert "### Family" not in before
    # On its own a family has all tables.
    alone = write_report(other_family, tmp_path / "alone")[0].read_text(encoding="utf-8")
    assert "## Absolute MPJPE (mm)\n\n| method | snapping |" in alone


def test_calibration_states_the_largest_deviation(scores):
    # 43 of 50 % on another variant: seven points, more than the three of this one.
    more = made_up(variant="clean", coverage=(0.43, 0.91, 0.99), coverage_occluded=NONE)
    summaries = summarise([*scores, more])
    every, occluded = (calibration(summaries, number) for number in ("coverage", "coverage_occluded"))
    assert every is not None
    assert occluded is not None
    column = {variant: row["fgpose batch"] for variant, row in rows_of(every).items()}
    assert column == {"occluded": "47/90/97", "clean": "43/91/99", "*largest deviation*": "*7.0*"}
    # No joint is occluded there.
    assert "clean" not in rows_of(occluded)
    assert "RANSAC" not in every


def test_time_offsets_are_those_of_methods_that_estimate_them(scores):
    assert time_offsets(summarise(scores)) is None
    errors = [made_up(clip=clip, method="batch", offset_error_frames=e) for clip, e in (("a", 0.04), ("b", 0.12))]
    table = time_offsets(summarise([*scores, *errors]))
    assert table is not None
    assert rows_of(table) == {"occluded": {"variant": "occluded", "batch": "0.08 (0.12)"}}


def test_a_bar_in_a_name_does_not_break_the_table():
    assert "this \\| that" in absolute_errors(summarise([made_up(method="this | that")]))


def test_the_report_says_what_it_is_of_and_shows_its_pictures(tmp_path, scores):
    report, *figures = write_report(scores, tmp_path / "new", command="fgpose benchmark --quick")
    text = report.read_text(encoding="utf-8")
    assert report.name == "report.md"
    assert f"Version {VERSION}. Variants: 1; recordings of each: 2; methods: 5." in text
    assert "    fgpose benchmark --quick" in text
    # Two recordings are not enough.
    assert "there is no such confidence" in text
    assert {path.name for path in figures} == {"joints.png", "calibration.png"}
    assert re.findall(r"\]\((.*?)\)", text) == [path.name for path in figures]
    assert all(path.stat().st_size > 0 for path in figures)
    assert "## Estimated time offsets" not in text
    # What the open benchmark says of its variant.
    assert "Occluders in three of the four views" in text


def test_every_table_of_the_report_is_one_on_github(tmp_path, scores):
    more = [made_up(variant=name, clip="a", offset_error_frames=0.1) for name in ("clean", "S9 Greeting")]
    text = write_report([*scores, *more], tmp_path)[0].read_text(encoding="utf-8")
    blocks = [block for block in text.split("\n\n") if block.startswith("|")]
    # Errors, one comparison, twice calibration, offsets, three variants.
    assert len(blocks) == 8
    assert all(rows_of(block) for block in blocks)
    assert "recordings of each: 1 to 2" in text


@pytest.fixture
def stored(tmp_path: Path, scores: list[Score]) -> Path:
    path = tmp_path / "intervals.json"
    store_intervals(scores, path)
    return path


def with_batch(scores: list[Score], errors_mm: list[float]) -> list[Score]:
    return [s for s in scores if s.method != "fgpose batch"] + over_clips(errors_mm)


def test_the_stored_scores_violate_nothing(stored, scores):
    assert check_against(stored, scores) == []
    intervals = json.loads(stored.read_text(encoding="utf-8"))["intervals"]
    batch = next(interval for interval in intervals if interval["method"] == "fgpose batch")
    assert (batch["mean_mm"], batch["low_mm"], batch["high_mm"]) == (20.0, 10.0, 30.0)


def test_an_error_outside_the_widened_interval_is_a_violation(stored, scores):
    # Stored: 10 to 30 mm around 20 mm.
    margin_mm = 20.0 * TOLERANCE
    assert check_against(stored, with_batch(scores, [30.0 + 0.9 * margin_mm])) == []
    (worse,) = check_against(stored, with_batch(scores, [30.0 + 1.1 * margin_mm]))
    assert worse == "occluded, fgpose batch: MPJPE 30.44 mm is worse than stored, 9.60 to 30.40 mm"
    (better,) = check_against(stored, with_batch(scores, [10.0 - 1.1 * margin_mm]))
    assert "better than stored" in better
    (missing,) = check_against(stored, with_batch(scores, [np.nan]))
    assert "fgpose batch: MPJPE nan" in missing


def test_a_margin_holds_runs_on_the_same_recordings_closer(tmp_path, scores):
    path = tmp_path / "margin.json"
    store_intervals(scores, path, margin=0.05)
    assert check_against(path, scores) == []
    # 5 % of 20 mm, and the tolerance of 2 %.
    assert check_against(path, with_batch(scores, [21.39])) == []
    assert len(check_against(path, with_batch(scores, [21.41]))) == 1


def test_what_is_on_one_side_only_is_a_violation(stored, scores):
    fewer = [score for score in scores if score.method != "RANSAC"]
    assert check_against(stored, fewer) == ["occluded, RANSAC: stored, but there is no score"]
    assert check_against(stored, [*scores, made_up(method="new")]) == ["occluded, new: no stored interval"]


def test_one_recording_is_held_against_its_mean(tmp_path):
    path = tmp_path / "one.json"
    store_intervals([made_up(mpjpe_mm=20.0)], path)
    assert check_against(path, [made_up(mpjpe_mm=20.39)]) == []
    assert len(check_against(path, [made_up(mpjpe_mm=20.41)])) == 1


def test_intervals_of_another_version_cannot_be_compared(stored, scores):
    content = json.loads(stored.read_text(encoding="utf-8"))
    stored.write_text(json.dumps(content | {"version": VERSION + 1}), encoding="utf-8")
    (violation,) = check_against(stored, scores)
    assert f"version {VERSION + 1}" in violation
    assert str(stored) in violation


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"intervals": [1], "version": 1}', '{"intervals": [{"variant": "v", "method": "m"}]}']
)
def test_a_file_of_something_else_is_an_error_that_names_it(tmp_path, scores, text):
    path = tmp_path / "other.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=r"other\.json does not hold stored intervals"):
        check_against(path, scores)


def test_an_error_that_is_not_there_cannot_be_stored(tmp_path):
    with pytest.raises(ValueError, match="variant occluded: fgpose batch has no finite MPJPE"):
        store_intervals([made_up(mpjpe_mm=np.nan)], tmp_path / "intervals.json")
    assert list(tmp_path.iterdir()) == []
