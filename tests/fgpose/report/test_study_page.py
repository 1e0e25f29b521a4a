"""The page of a study."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from finished_walk import finished_walk
from test_report_page import LOADS

from fgpose.geometry.camera import CameraRig
from fgpose.io.tables import write_table
from fgpose.io.trajectories import save_trajectory
from fgpose.report import FinishedRecording, StudyRecording, thumbnail, write_study_report
from fgpose.report.study_results import is_study, load_study, study_name
from fgpose.skeleton import Skeleton

pytest.importorskip("bokeh")


@pytest.fixture(scope="module")
def walk(rig: CameraRig, skeleton: Skeleton) -> FinishedRecording:
    return finished_walk(rig, skeleton)


def study(walk: FinishedRecording, folder: Path, name: str = "") -> None:
    """As fgpose study leaves it: one recording done, one damaged, one failed."""
    for trial in ("good", "damaged"):
        own = folder / "recordings" / "S01" / "first" / trial
        own.mkdir(parents=True)
        save_trajectory(walk.main, own / "motion.parquet")
    (own / "motion.parquet").write_bytes(b"PAR1")
    numbers = {"duration_s": [9.97, 9.97, None], "reprojection_px": [4.7, 4.7, None], "sigma_mm": [10.0, 10.0, None]}
    columns = {
        "recording": ["S01/first/good", "S01/first/damaged", "S02/first/gone"],
        "status": ["done", "done", "failed"],
        "reason": ["", "", "there is no calibration"],
        "suspicions": ["camera ring_2 is late", "", ""],
    }
    table = pa.table({**columns, **numbers})
    write_table(folder / "quality.parquet", table.replace_schema_metadata({"fgpose.study": name} if name else None))


def test_the_legend_is_not_over_the_outliers(tmp_path: Path) -> None:
    recordings = [StudyRecording(f"S{n}", {"reprojection_px": 5.0 + n % 3, "sigma_mm": 9.0 + n % 2}) for n in range(9)]
    recordings.append(StudyRecording("S9", {"reprojection_px": 40.0, "sigma_mm": 90.0}))
    write_study_report(recordings, tmp_path / "study.html")
    (model,) = re.findall(r'class="plot-data"[^>]*>(.*?)</script>', (tmp_path / "study.html").read_text())
    (figure,) = json.loads(model)["doc"]["roots"]
    of_sides = {side: [each["name"] for each in figure["attributes"].get(side, [])] for side in ("below", "center")}
    assert "Legend" in of_sides["below"]
    assert "Legend" not in of_sides["center"]


@pytest.mark.slow
def test_a_study_links_the_reports_of_its_recordings(walk: FinishedRecording, tmp_path: Path) -> None:
    study(walk, tmp_path)
    assert is_study(tmp_path)
    assert not is_study(tmp_path / "recordings")
    progress: list[tuple[int, int]] = []
    recordings = load_study(tmp_path, progress=lambda done, total: progress.append((done, total)))
    assert progress[-1] == (3, 3)
    good, damaged, gone = recordings
    assert good.report == "recordings/S01/first/good/report.html"
    assert (tmp_path / good.report).is_file()
    assert good.picture.startswith("<svg")
    assert damaged.status == "failed"
    assert "motion.parquet" in damaged.reason
    assert gone.reason == "there is no calibration"
    before = (tmp_path / good.report).stat().st_mtime_ns
    load_study(tmp_path)
    assert (tmp_path / good.report).stat().st_mtime_ns == before  # nothing was new


def test_a_study_has_its_name(walk: FinishedRecording, tmp_path: Path) -> None:
    for folder, name in (("results", "Balance 2026"), ("older", "")):
        study(walk, tmp_path / folder, name)
    assert study_name(tmp_path / "results") == "Balance 2026"
    assert study_name(tmp_path / "older") == "older"


def test_small_pictures_are_filled_by_the_way(walk: FinishedRecording) -> None:
    for metres, words in ((0.002, "cm"), (2.0, "m"), (40.0, "m")):
        place_m = metres * np.linspace(0, 1, walk.main.n_frames)[:, None, None] * (0.6, 0.8, 0)
        still_m = np.broadcast_to(walk.main.positions_m[:1], walk.main.positions_m.shape)
        svg = thumbnail(replace(walk, people={0: replace(walk.main, positions_m=still_m + place_m)}))
        (points,) = re.findall(r'points="([^"]+)"', svg)
        x, y = np.array([point.split(",") for point in points.split()], dtype=float).T
        # Of 72 x 40 pixels, three around; a straight way lies in the middle.
        assert np.ptp(x) == pytest.approx(66, abs=0.2)
        np.testing.assert_allclose(y, 20, atol=0.2)
        assert re.search(rf"<text[^>]*>[\d.]+ {words}</text>", svg)


def test_a_study_begins_with_failures_and_outliers(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    recordings = [
        StudyRecording(f"S{n:02}", {"reprojection_px": float(rng.normal(5, 0.3)), "sigma_mm": 9.0, "n_suspicions": 0.0})
        for n in range(12)
    ]
    recordings[7] = replace(recordings[7], numbers={"reprojection_px": 30.0, "sigma_mm": 9.0, "n_suspicions": 1.0})
    recordings.append(StudyRecording("S99", status="failed", reason="<b>no</b> calibration"))
    write_study_report(recordings, tmp_path / "study.html", "balance")
    page = (tmp_path / "study.html").read_text(encoding="utf-8")
    order = re.findall(r'<th scope="row">(S\d\d)', page)
    assert order[:2] == ["S99", "S07"]
    assert len(order) == 13
    assert "&lt;b&gt;no&lt;/b&gt; calibration" in page
    assert "Reprojection unlike the others" in page
    assert not LOADS.search(page)
    with pytest.raises(ValueError, match="at least one recording"):
        write_study_report([], tmp_path / "none.html")
    assert not (tmp_path / "none.html").exists()


@pytest.mark.parametrize("name", ["../../elsewhere", "/tmp", "S01/../../../elsewhere"])
def test_a_table_names_no_folder_outside_of_its_study(name: str, walk: FinishedRecording, tmp_path: Path) -> None:
    """A study of somebody else had reports written wherever its table said."""
    folder, elsewhere = tmp_path / "a" / "results", tmp_path / "a" / "elsewhere"
    study(walk, folder)
    elsewhere.mkdir()
    save_trajectory(walk.main, elsewhere / "motion.parquet")
    write_table(folder / "quality.parquet", pa.table({"recording": [name], "status": ["done"]}))
    with pytest.raises(ValueError, match=r"quality\.parquet: the recording .* is outside of"):
        load_study(folder)
    assert [path.name for path in elsewhere.iterdir()] == ["motion.parquet"]
    (folder / "recordings" / "S01" / "link").symlink_to(elsewhere)
    with pytest.raises(OSError, match=rf"S01/link is a link, to {elsewhere}: results of a study are neither read nor"):
        load_study(folder)


def test_a_name_is_no_address_that_runs(tmp_path: Path) -> None:
    recording = StudyRecording("javascript:alert(1)//a", report="javascript:alert(1)//a b/report.html")
    write_study_report([recording], tmp_path / "report.html")
    assert 'href="javascript%3Aalert%281%29//a%20b/report.html"' in (tmp_path / "report.html").read_text()
