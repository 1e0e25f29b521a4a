"""The file of a report: whole, self-contained, and honest about what it lacks."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pytest
from finished_walk import FPS, finished_walk

from fgpose.association.track import TrackEvent
from fgpose.calibration.from_people.calibrated import Finding, Grade
from fgpose.geometry.camera import CameraRig
from fgpose.io.calibration import save_rig
from fgpose.io.tables import write_table
from fgpose.io.trajectories import save_trajectory
from fgpose.report import (
    FinishedRecording,
    StudyRecording,
    find_result,
    load_finished,
    write_report,
    write_study_report,
)
from fgpose.report.moments import worst_moments
from fgpose.report.study_results import is_study, load_study
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Trajectory

pytest.importorskip("bokeh")
# What makes a browser load something: neither the program of Bokeh, which names addresses, nor data: inside.
LOADS = re.compile(r"""<(?:script|link|img|iframe|source)[^>]*\s(?:src|href)=["'](?!data:)|@import|url\(\s*["']?http""")


@pytest.fixture(scope="module")
def walk(rig: CameraRig, skeleton: Skeleton) -> FinishedRecording:
    return finished_walk(rig, skeleton)


def text_of(page: str) -> str:
    """What is to be read, without programs and data."""
    return re.sub(r"<[^>]+>", " ", re.sub(r"<(script|style).*?</\1>", "", page, flags=re.DOTALL))


def test_a_report_has_all_sections_and_loads_nothing(walk: FinishedRecording, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    judged = write_report(walk, path)
    page = path.read_text(encoding="utf-8")
    assert judged.suspicions == ()
    assert "Nothing is suspicious" in page
    for heading in (
        "What the cameras saw", "Reprojection errors", "Uncertainty", "Bone lengths", "Joint angles",
        "Cameras, calibration and clocks", "Worst moments", "What was recorded, and with what",
    ):  # fmt: skip
        assert f"<h2>{heading}</h2>" in page
    assert not LOADS.search(page)
    assert "default-src 'none'" in page
    # Tables are tables, and figures are valid JSON.
    assert page.count("<caption>") >= 5
    data = re.findall(
        r'<script type="application/json" class="plot-data" data-for="([^"]+)">(.*?)</script>', page, re.S
    )
    assert len(data) > 10
    assert all(json.loads(text)["doc"] and f'id="{target}"' in page for target, text in data)


def test_names_are_texts_and_not_programs(walk: FinishedRecording, tmp_path: Path) -> None:
    bad = "</script><img src=x onerror=alert(1)>"
    rig = walk.rig
    assert rig is not None
    cameras = CameraRig((replace(rig.cameras[0], name=bad), *rig.cameras[1:]))
    person = replace(walk.main, camera_names=cameras.names)
    write_report(FinishedRecording(bad, {0: person}, cameras, made_from={bad: bad}), tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<img src=x" not in page
    assert "&lt;img src=x" in page
    # Every script ends where it should.
    assert page.count("</script>") == page.count("<script")


def test_what_is_missing_is_said_in_a_line(walk: FinishedRecording, tmp_path: Path) -> None:
    full = walk.main
    bare = Trajectory(full.skeleton, full.time_s, full.positions_m, full.status)
    write_report(FinishedRecording("bare", {0: bare}), tmp_path / "report.html")
    text = text_of((tmp_path / "report.html").read_text(encoding="utf-8"))
    for words in (
        "The result has no reprojection errors", "The result has no covariance", "No calibration was given",
        "No pictures: the videos were not given", "The settings were not stored with the result",
    ):  # fmt: skip
        assert words in text


def test_people_clocks_and_the_verdict_are_shown(walk: FinishedRecording, tmp_path: Path) -> None:
    recording = replace(
        walk,
        people={0: walk.main, 3: walk.main},
        observations={},
        events=(TrackEvent(1.0, 3, "recognised", "the same bones as person 3"),),
        offset_sigma_s={"ring_1": 0.0012},
        findings=(Finding("ring_1", Grade.COARSE, "the focal length is not determined", "walk away from it"),),
    )
    write_report(recording, tmp_path / "report.html")
    text = " ".join(text_of((tmp_path / "report.html").read_text(encoding="utf-8")).split())
    assert "People and identities" in text
    assert "person 3 recognised the same bones as person 3" in text
    assert "+0.0 ± 1.2" in text
    assert "ring_1 coarse the focal length is not determined walk away from it" in text


def test_worst_moments_are_where_it_is_worst(walk: FinishedRecording) -> None:
    covariance_m2 = np.array(walk.main.covariance_m2)
    covariance_m2[200:204] *= 100
    moments = worst_moments(replace(walk, people={0: replace(walk.main, covariance_m2=covariance_m2)}))
    assert len(moments) == 5
    (worst,) = [moment for moment in moments if 200 <= moment.frame < 204]
    assert worst.reason.startswith("sigma of ")
    assert worst.reason.endswith("4 of 4 cameras see " + worst.joints[0])
    # Apart by a second, in the order of time.
    assert (np.diff([moment.time_s for moment in moments]) >= 1.0).all()


def test_pictures_show_the_images_of_the_moment(walk: FinishedRecording, tmp_path: Path) -> None:
    from fgpose.report.pictures import pictures

    assert walk.rig is not None
    moments = worst_moments(walk)[:2]
    for name in walk.rig.names:
        folder = tmp_path / name
        folder.mkdir()
        for frame in range(max(moment.frame for moment in moments) + 1):
            cv2.imwrite(str(folder / f"{frame:04}.png"), np.full((1000, 1000, 3), frame % 250, np.uint8))
    with pytest.raises(ValueError, match="frames per second"):
        pictures(replace(walk, videos=tmp_path), moments)
    found = pictures(replace(walk, videos=tmp_path, images_hz=FPS), moments)
    assert [len(of_moment) for of_moment in found.values()] == [4, 4]
    for moment in moments:
        content = np.frombuffer(base64.b64decode(found[moment][0].source.partition(",")[2]), np.uint8)
        image = cv2.imdecode(content, cv2.IMREAD_COLOR)
        assert image is not None
        # The corner has no drawing; JPEG moves an even area by no more than this.
        assert abs(int(image[2, 2, 0]) - moment.frame % 250) <= 2


def test_results_are_found_with_what_stands_beside_them(walk: FinishedRecording, tmp_path: Path) -> None:
    assert walk.rig is not None
    save_trajectory(walk.main, tmp_path / "walk_online.parquet")
    save_trajectory(walk.main, tmp_path / "walk_smoothed.parquet")
    save_rig(walk.rig, tmp_path / "walk_calibration.toml")
    found = find_result(tmp_path)
    assert found.name == "walk_smoothed.parquet"
    recording = load_finished(found)
    assert recording.rig is not None
    assert recording.rig.names == walk.camera_names
    assert recording.made_from["Calibration"].endswith("walk_calibration.toml")
    save_trajectory(walk.main, tmp_path / "other.npz")
    with pytest.raises(ValueError, match=r"results of walk, other: say which|results of other, walk: say which"):
        find_result(tmp_path)
    assert find_result(tmp_path, "other").name == "other.npz"
    with pytest.raises(ValueError, match="no result third"):
        find_result(tmp_path, "third")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="no result of fgpose"):
        find_result(tmp_path / "empty")


def test_a_calibration_of_other_cameras_is_refused(walk: FinishedRecording, tmp_path: Path) -> None:
    assert walk.rig is not None
    save_trajectory(walk.main, tmp_path / "walk.parquet")
    save_rig(walk.rig.subset(walk.camera_names[:3]), tmp_path / "three.toml")
    with pytest.raises(ValueError, match=r"three\.toml: camera ring_3 of the result is not in this calibration"):
        load_finished(tmp_path / "walk.parquet", rig=tmp_path / "three.toml")


def study(walk: FinishedRecording, folder: Path) -> None:
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
    write_table(folder / "quality.parquet", pa.table({**columns, **numbers}))


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
