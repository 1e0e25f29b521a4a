"""What was noted while it was recorded, on the page."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pytest
from finished_walk import finished_walk

from fgpose.diagnosis.finished import Mark
from fgpose.geometry.camera import CameraRig
from fgpose.io.tables import write_table
from fgpose.io.trajectories import save_trajectory
from fgpose.report import FinishedRecording
from fgpose.report.blocks import Section
from fgpose.report.plots import TIME_AXIS
from fgpose.report.sections import sections
from fgpose.report.study_results import load_study
from fgpose.skeleton import Skeleton

pytest.importorskip("bokeh")
NAME = "S01/first/walk"


@pytest.fixture(scope="module")
def walk(rig: CameraRig, skeleton: Skeleton) -> FinishedRecording:
    return finished_walk(rig, skeleton)


def lines_over_time(made: list[Section]) -> list[list[float]]:
    """Times of the lines of each figure over time."""
    plots = [plot.model for section in made for plot in section.plots]
    return [
        [
            time_s
            for each in plot.renderers
            if type(each.glyph).__name__ == "VSpan"
            for time_s in each.data_source.data["x"]
        ]
        for plot in plots
        if TIME_AXIS in plot.tags
    ]


def test_they_are_in_every_figure_over_time(walk: FinishedRecording) -> None:
    made = sections(replace(walk, marks=(Mark(2.0, "stumble"), Mark(3.5, "<b>turn</b>"), Mark(99.0, "end"))))
    drawn = lines_over_time(made)
    assert len(drawn) > 4
    assert all(times_s == [2.0, 3.5] for times_s in drawn)
    assert [section.title for section in made].count("Events") == 1


@pytest.mark.slow
def test_many_are_in_the_table_only(walk: FinishedRecording) -> None:
    made = sections(replace(walk, marks=tuple(Mark(n / 10, f"step {n}") for n in range(90))))
    assert not any(lines_over_time(made))
    (section,) = (section for section in made if section.title == "Events")
    assert "Vertical lines" not in section.intro


@pytest.mark.slow
def test_the_page_of_a_study_has_them(walk: FinishedRecording, tmp_path: Path) -> None:
    own = tmp_path / "recordings" / NAME
    own.mkdir(parents=True)
    save_trajectory(walk.main, own / "motion.parquet")
    write_table(tmp_path / "quality.parquet", pa.table({"recording": [NAME], "status": ["done"]}))
    events = {
        "recording": [NAME, NAME, "S02/first/walk"],
        "time_s": [3.0, 1.5, 2.0],
        "event": ["turn", "go", "tumbling"],
    }
    write_table(tmp_path / "events.parquet", pa.table(events))
    load_study(tmp_path)
    page = (own / "report.html").read_text()
    assert page.index(">go<") < page.index(">turn<")
    assert "tumbling" not in page
    write_table(tmp_path / "events.parquet", pa.table({"recording": [NAME]}))
    with pytest.raises(ValueError, match=r"events\.parquet: no table of events"):
        load_study(tmp_path)
