"""Which pages of recordings `fgpose report` writes again."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from finished_walk import finished_walk

from fgpose.cli import main
from fgpose.geometry.camera import CameraRig
from fgpose.io.studies.results import write_rows
from fgpose.io.trajectories import save_trajectory
from fgpose.report.study_results import load_study
from fgpose.skeleton import Skeleton

pytest.importorskip("bokeh")
pytestmark = pytest.mark.usefixtures("without_search_for_faults")
TRIALS = ("run", "walk")


def write_events(folder: Path, **time_s: float) -> None:
    rows = [{"recording": f"S01/A/{trial}", "event": "stumble", "time_s": at_s} for trial, at_s in time_s.items()]
    write_rows(rows, folder / "events.parquet")


def written(folder: Path) -> dict[str, str]:
    """The pages that are written now."""
    pages = {trial: folder / "recordings" / "S01" / "A" / trial / "report.html" for trial in TRIALS}
    before = {trial: page.stat().st_ino if page.exists() else 0 for trial, page in pages.items()}
    load_study(folder)
    return {trial: page.read_text() for trial, page in pages.items() if page.stat().st_ino != before[trial]}


def test_a_page_is_written_again_for_events_of_its_recording(
    rig: CameraRig, skeleton: Skeleton, tmp_path: Path
) -> None:
    rows = [{"recording": f"S01/A/{trial}", "status": "done"} for trial in TRIALS]
    write_rows(rows, tmp_path / "quality.parquet")
    for trial in TRIALS:
        save_trajectory(
            finished_walk(rig, skeleton).main, tmp_path / "recordings" / "S01" / "A" / trial / "motion.parquet"
        )
    write_events(tmp_path, run=1.25, walk=2.5)
    assert written(tmp_path).keys() == set(TRIALS)
    # Written anew with the same content, as by every run of a study.
    write_events(tmp_path, run=1.25, walk=2.5)
    assert not written(tmp_path)
    write_events(tmp_path, run=1.25, walk=3.75)
    found = written(tmp_path)
    assert found.keys() == {"walk"}
    assert ">3.75<" in found["walk"]
    assert ">2.50<" not in found["walk"]
    os.unlink(tmp_path / "events.parquet")
    found = written(tmp_path)
    assert found.keys() == set(TRIALS)
    assert all("stumble" not in page for page in found.values())


@pytest.mark.parametrize("option", [("--rig", "rig.toml"), ("--name", "walk"), ("--fps", "50")])
def test_what_a_study_says_itself_is_no_option_of_its_report(
    option: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_rows([{"recording": "S01/A/walk", "status": "done"}], tmp_path / "quality.parquet")
    assert main(["report", str(tmp_path), *option]) == 2
    assert f"{option[0]} is of a single result; {tmp_path} is a study" in capsys.readouterr().err.replace("\n", " ")
    assert [path.name for path in tmp_path.iterdir()] == ["quality.parquet"]
