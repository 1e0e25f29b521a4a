"""The file of a report: whole, self-contained, and honest about what it lacks."""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest
from finished_walk import FPS, changed, finished_walk

from fgpose.association.track import TrackEvent
from fgpose.calibration.from_people.calibrated import CalibrationFinding, Grade
from fgpose.geometry.camera import CameraRig
from fgpose.io.calibration import save_rig
from fgpose.io.origin import Origin
from fgpose.io.trajectories import save_trajectory
from fgpose.kinematics.angles import joint_angles
from fgpose.monocular.sources import open_sources
from fgpose.report import (
    FinishedRecording,
    find_result,
    load_finished,
    write_report,
)
from fgpose.report.blocks import Block, Folded, JpegPicture, Note, PicturedMoment, Plot, Section, Table
from fgpose.report.page import Page, html
from fgpose.report.plots import TIME_AXIS, share_time
from fgpose.report.sections import sections
from fgpose.report.sections.angles import angle_section
from fgpose.report.sections.body import sigma_section
from fgpose.report.sections.cameras import camera_section, reprojection_section, seen_section
from fgpose.report.sections.moments import moment_section, pictures
from fgpose.report.sections.worst_moments import WorstMoment
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status, Trajectory

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
        assert re.search(f'<h2 id="[a-z]+-title">{heading}</h2>', page)
    assert ">Events</h2>" not in page  # nothing was noted
    assert not LOADS.search(page)
    assert "default-src 'none'" in page
    # Tables are tables, and figures are valid JSON.
    assert page.count("<caption>") >= 4
    assert page.count("</table>") >= 7
    data = re.findall(
        r'<script type="application/json" class="plot-data" data-for="([^"]+)">(.*?)</script>', page, re.S
    )
    assert len(data) > 10
    assert all(json.loads(text)["doc"] and f'id="{target}"' in page for target, text in data)


@pytest.mark.slow
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


@pytest.mark.slow
def test_people_clocks_and_the_verdict_are_shown(walk: FinishedRecording, tmp_path: Path) -> None:
    recording = replace(
        walk,
        people={0: walk.main, 3: walk.main},
        observations={},
        events=(TrackEvent(1.0, 3, "recognised", "the same bones as person 3"),),
        offset_sigma_s={"ring_1": 0.0012},
        findings=(
            CalibrationFinding("ring_1", Grade.COARSE, "the focal length is not determined", "walk away from it"),
        ),
    )
    write_report(recording, tmp_path / "report.html")
    text = " ".join(text_of((tmp_path / "report.html").read_text(encoding="utf-8")).split())
    assert "People and identities" in text
    assert "person 3 recognised the same bones as person 3" in text
    assert "+0.0 ± 1.2" in text
    assert "ring_1 coarse the focal length is not determined walk away from it" in text


def test_a_calibration_with_a_board_is_called_so_and_shows_what_was_covered(walk: FinishedRecording) -> None:
    finding = CalibrationFinding("ring_1", Grade.COARSE, "the board is used in 4 of its images only", "take more")
    half = tuple(8 * (count,) for count in (0, 0, 0, 1, 7, 90))
    recording = replace(walk, findings=(finding,), calibrated="with a board", board_coverage={"ring_1": half})
    page = html(Page("walk", "Recording", "", [camera_section(recording)]))
    assert "Verdict of the calibration with a board" in page
    assert "from people" not in page
    assert "50 % of the image covered" in page
    # A frame, and the parts that were seen: those with most corners are darkest.
    opacity = [float(each) for each in re.findall(r'fill-opacity="([^"]+)"', page)]
    assert len(opacity) == 24
    assert opacity[0] == 0.25 < opacity[8] < opacity[-1] == 1.0
    praised = replace(recording, findings=())
    assert "calibrated with a board; nothing was said against" in html(Page("w", "R", "", [camera_section(praised)]))


def test_one_person_is_shown_at_a_time(walk: FinishedRecording) -> None:
    # The second is seen less.
    status = walk.main.status.copy()
    status[::2] = Status.PREDICTED
    recording = replace(walk, people={4: replace(walk.main, status=status), 7: walk.main}, observations={})
    made = [seen_section(recording), reprojection_section(recording)]
    page = html(Page("two", "Recording", "", made))
    assert re.findall(r'<option value="([^"]+)"( selected)?>', page) == [("person 4", ""), ("person 7", " selected")]
    shown = re.findall(r'<div class="blocks of-person" data-person="([^"]+)"( hidden)?>', page)
    assert shown == 2 * [("person 4", " hidden"), ("person 7", "")]
    # Tables and figures of everybody stand outside.
    assert "Cameras, all people" in page
    assert [len(section.plots) for section in made] == [4, 3]
    alone = html(Page("one", "Recording", "", [seen_section(walk)]))
    assert "<select" not in alone
    assert "data-person=" not in alone


def folded(section: Section) -> dict[str, tuple[Block, ...]]:
    return {block.title: block.blocks for block in section.blocks if isinstance(block, Folded)}


def test_maps_that_say_nothing_are_folded_with_a_line_that_says_so(walk: FinishedRecording) -> None:
    said = list(folded(seen_section(walk)))
    assert said == [
        "Share of the joints that each camera sees: all of them",
        "Number of cameras that see each joint: 4 in 100 % of all frames",
    ]
    (sigma,) = [title for title in folded(sigma_section(walk)) if "over time" in title]
    assert sigma.endswith("0.0 % of it is more than twice the median")
    # One camera sees nobody for half of the time: that is shown.
    residual_px = np.array(walk.main.residual_px)
    residual_px[150:, 2] = np.nan
    (of_joints,) = folded(seen_section(changed(walk, residual_px=residual_px)))
    assert of_joints == "Number of cameras that see each joint: 3 in 50 % of all frames"
    # A joint that two cameras miss for a moment is a line.
    residual_px = np.array(walk.main.residual_px)
    residual_px[150:165, :2, walk.main.skeleton.index("left_wrist")] = np.nan
    _, of_joints = folded(seen_section(changed(walk, residual_px=residual_px)))
    assert of_joints.endswith(" % of all frames, of left_wrist in 95 %")
    covariance_m2 = np.array(walk.main.covariance_m2)
    covariance_m2[30:60] *= 25
    (sigma,) = [
        title for title in folded(sigma_section(changed(walk, covariance_m2=covariance_m2))) if "over time" in title
    ]
    assert sigma.endswith("10.0 % of it is more than twice the median")


@pytest.mark.slow
def test_what_is_shown_first_is_short(walk: FinishedRecording) -> None:
    made = sections(walk)
    assert [section.anchor for section in made[:2]] == ["worst", "seen"]
    shown = [block for section in made for block in section.blocks]
    tables = [block for block in shown if isinstance(block, Table)]
    n_joints = walk.main.skeleton.n_joints
    assert all(len(table.rows) < n_joints for table in tables if table.caption != "Recording")
    assert sum(isinstance(block, Plot) for block in shown) < 12
    assert sum(isinstance(block, PicturedMoment) for block in shown) == 2
    # Nothing is lost: what is folded is on the page, and its figures are drawn when they are asked for.
    page = html(Page("walk", "Recording", "", made))
    n_plots = sum(len(section.plots) for section in made)
    assert n_plots > 20
    assert page.count('class="plot-data"') == n_plots
    for section in made:
        for title in folded(section):
            assert f"<details><summary>{title}</summary>" in page.replace("&#39;", "'")


@pytest.mark.slow
def test_figures_over_time_have_one_axis(walk: FinishedRecording) -> None:
    late = replace(walk.main, time_s=walk.main.time_s + 5)
    recording = replace(walk, people={0: walk.main, 1: late}, observations={})
    plots = [plot for section in sections(recording) for plot in section.plots if TIME_AXIS in plot.model.tags]
    share_time(plots)
    assert len(plots) > 20
    for plot in plots:
        assert plot.model.x_range.start == 0
        # Until the last frame ends.
        assert plot.model.x_range.end == pytest.approx(5 + len(late.time_s) / FPS)


def test_bands_hold_95_percent_and_axes_do_not_magnify_errors(walk: FinishedRecording) -> None:
    angles = joint_angles(walk.main)
    knee = next(plot for plot in angle_section(walk).plots if plot.caption == "Knee flexion")
    (left, right) = [each for each in knee.model.renderers if each.name in ("left", "right")]
    assert (left.name, right.name) == ("left", "right")
    patch = next(each for each in knee.model.renderers if each.name is None)
    low_and_high = np.concatenate(patch.data_source.data["ys"])
    n = len(low_and_high) // 2
    half_deg = (low_and_high[n:][::-1] - low_and_high[:n]) / 2
    # 1.96 sigma: 95 % of a normal distribution. Single precision of angles up to 180 degrees.
    expected_deg = 1.96 * angles.sigma_deg[:, angles.names.index("left_knee_flexion")]
    np.testing.assert_allclose(half_deg, expected_deg, atol=1e-4)
    assert knee.model.yaxis[0].axis_label == "angle / °"
    spans_deg = [plot.model.y_range.end - plot.model.y_range.start for plot in angle_section(walk).plots]
    assert min(spans_deg) >= 20


def pictures_of(recording: FinishedRecording, moments: list[WorstMoment]) -> dict[WorstMoment, tuple[JpegPicture, ...]]:
    assert recording.rig is not None
    assert recording.videos is not None
    sources = open_sources(recording.videos, recording.rig, fps=recording.images_hz)
    return pictures(recording, moments, sources, sources.taken_s())


def filmed(walk: FinishedRecording, folder: Path, n_images: int, first: int = 0) -> None:
    """An image of each camera for each frame, as grey as its number."""
    assert walk.rig is not None
    one, *others = (folder / name for name in walk.rig.names)
    one.mkdir()
    for frame in range(n_images):
        cv2.imwrite(str(one / f"{frame + first:04}.png"), np.full((1000, 1000, 3), frame % 250, np.uint8))
    for other in others:
        shutil.copytree(one, other, copy_function=os.link)


def test_pictures_show_the_images_of_the_moment(walk: FinishedRecording, tmp_path: Path) -> None:
    moments = [WorstMoment(0, frame, frame / FPS, "", ("pelvis",)) for frame in (12, 31)]
    filmed(walk, tmp_path, max(moment.frame for moment in moments) + 1)
    with pytest.raises(ValueError, match="frames per second"):
        pictures_of(replace(walk, videos=tmp_path), moments)
    found = pictures_of(replace(walk, videos=tmp_path, images_hz=FPS), moments)
    assert [len(of_moment) for of_moment in found.values()] == [4, 4]
    for moment in moments:
        content = np.frombuffer(base64.b64decode(found[moment][0].source.partition(",")[2]), np.uint8)
        image = cv2.imdecode(content, cv2.IMREAD_COLOR)
        assert image is not None
        # The corner has no drawing; JPEG moves an even area by no more than this.
        assert abs(int(image[2, 2, 0]) - moment.frame % 250) <= 2


@pytest.mark.parametrize(
    ("first", "said"),
    [
        (0, ""),
        (1, "the result begins and ends 1 image before those of a camera"),
        (1000, "No pictures: the result is from 0 s to"),
    ],
)
def test_pictures_of_other_times_are_told(walk: FinishedRecording, tmp_path: Path, first: int, said: str) -> None:
    filmed(walk, tmp_path, walk.main.n_frames, first)
    section = moment_section(replace(walk, videos=tmp_path, images_hz=FPS))
    notes = [block.text for block in section.blocks if isinstance(block, Note)]
    assert len(notes) == (1 if said else 0)
    assert all(said in note for note in notes)


@pytest.mark.slow
def test_pictures_are_those_of_the_time_in_videos_of_variable_rate(walk: FinishedRecording, tmp_path: Path) -> None:
    assert walk.rig is not None
    # As phones record when the light changes: 30 images per second, then 10, then 60.
    times_ms = np.cumsum([0, *(20 * [33]), *(10 * [100]), *(20 * [17])])
    for name in walk.rig.names:
        write_video_at(tmp_path / f"{name}.mp4", times_ms)
    moments = [WorstMoment(0, round(at_s * FPS), at_s, "", ("pelvis",)) for at_s in (0.3, 1.2, 1.9)]
    late = WorstMoment(0, 100, float(times_ms[-1]) / 1000 + 1, "", ("pelvis",))
    found = pictures_of(replace(walk, videos=tmp_path), [*moments, late])
    for moment in moments:
        content = np.frombuffer(base64.b64decode(found[moment][0].source.partition(",")[2]), np.uint8)
        image = cv2.imdecode(content, cv2.IMREAD_COLOR)
        assert image is not None
        expected = LEVEL_STEP * (int(np.abs(times_ms / 1000 - moment.time_s).argmin()) % LEVELS)
        # Half of the difference between images that follow each other, which is more than the codec changes.
        assert abs(int(image[2, 2, 0]) - expected) < LEVEL_STEP / 2
        assert found[moment][0].alt == (
            f"Image of camera ring_0 at {moment.time_s:.2f} s: the person, with the skeleton of the result over it"
        )
    assert found[late] == ()


LEVELS, LEVEL_STEP = 12, 20


def write_video_at(path: Path, times_ms: np.ndarray) -> None:
    """Images of even grey, which rises from image to image, at these times."""
    import av

    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height, stream.pix_fmt = 1000, 1000, "yuv420p"
        stream.codec_context.time_base = stream.time_base = Fraction(1, 1000)
        for n, time_ms in enumerate(times_ms.tolist()):
            grey = np.full((1000, 1000, 3), LEVEL_STEP * (n % LEVELS), np.uint8)
            frame = av.VideoFrame.from_ndarray(grey, format="rgb24")
            frame.pts, frame.time_base = time_ms, Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


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
    # What fgpose track left beside the result of another command is not taken for it.
    save_trajectory(walk.main, tmp_path / "other_smoothed.parquet", origin=Origin(step="track"))
    save_trajectory(walk.main, tmp_path / "other.npz", origin=Origin(step="smooth"))
    with pytest.raises(ValueError, match=r"other \(fgpose smooth\), other_smoothed \(fgpose track\)"):
        find_result(tmp_path)
    assert find_result(tmp_path, "other").name == "other.npz"
    assert find_result(tmp_path, "other_smoothed").name == "other_smoothed.parquet"
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
