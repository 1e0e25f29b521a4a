"""Reports looked at in a real browser, without a network.

``python tests/fgpose/report/test_report_browser.py REPORT.html PICTURE.png`` takes the picture of the documentation.
"""

from __future__ import annotations

import base64
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgpose.geometry.camera import CameraRig
from fgpose.report import StudyRecording, thumbnail, write_report, write_study_report
from fgpose.skeleton import Skeleton
from tests.fgpose.browser import BROWSER, Browser, browser

# Errors of the page, and whatever it writes to the console as one or as a warning.
_LISTEN = """window.complaints = [];
addEventListener("error", (event) => complaints.push(event.message));
addEventListener("unhandledrejection", (event) => complaints.push(String(event.reason)));
addEventListener("securitypolicyviolation", (event) => complaints.push("blocked " + event.blockedURI));
for (const kind of ["error", "warn"]) console[kind] = (...what) => complaints.push(what.join(" "));"""
_IS_SHOWN = "document.documentElement.dataset.plots !== undefined || (window.complaints ?? []).length > 0"
# Canvases with something on them, of all plots that are shown: they are in shadow roots.
_DRAWN = """(() => {
  const canvases = (node) => [...node.querySelectorAll("*")].flatMap((each) =>
    [...(each.tagName === "CANVAS" ? [each] : []), ...(each.shadowRoot ? canvases(each.shadowRoot) : [])]);
  const isDrawn = (canvas) => canvas.width > 0
    && canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data.some((value) => value > 0);
  const isShown = (plot) => !plot.closest("[hidden], details:not([open])");
  return [...document.querySelectorAll(".plot")].filter(isShown).map((plot) => canvases(plot).some(isDrawn));
})()"""


@contextmanager
def opened(path: Path) -> Iterator[Browser]:
    with browser("about:blank") as page:
        page.call("Page.enable")
        page.call("Network.enable")
        page.call("Network.emulateNetworkConditions", offline=True, latency=0, downloadThroughput=0, uploadThroughput=0)
        page.call("Page.addScriptToEvaluateOnNewDocument", source=_LISTEN)
        page.call("Page.navigate", url=path.as_uri())
        page.wait_for(_IS_SHOWN)
        yield page


needs_browser = pytest.mark.skipif(BROWSER is None, reason="no Chromium is installed (apt-get install chromium)")


@pytest.mark.slow
@needs_browser
def test_a_browser_shows_a_recording(rig: CameraRig, skeleton: Skeleton, tmp_path: Path) -> None:
    from finished_walk import finished_walk

    pytest.importorskip("bokeh")
    write_report(finished_walk(rig, skeleton), tmp_path / "report.html")
    with opened(tmp_path / "report.html") as page:
        complaints, drawn = page.value("complaints"), page.value(_DRAWN)
        loaded = page.value("performance.getEntriesByType('resource').length")
        # As the foot of the page says.
        zooms = page.value("views.every((v) => v.toolbar.tools.some((t) => t.type === 'BoxZoomTool' && t.active))")
        # A zoom in one plot over time is a zoom in all.
        page.value("views.filter((view) => view.tags.includes('time'))[0].x_range.setv({start: 2, end: 3})")
        starts = page.value("views.filter((view) => view.tags.includes('time')).map((view) => view.x_range.start)")
        page.call("Emulation.setDeviceMetricsOverride", width=390, height=800, deviceScaleFactor=1, mobile=True)
        page.wait_for("document.documentElement.scrollWidth <= 390")
        dark = [{"name": "prefers-color-scheme", "value": "dark"}]
        page.call("Emulation.setEmulatedMedia", features=dark)
        page.wait_for("getComputedStyle(document.body).backgroundColor === 'rgb(21, 24, 28)'")
        page.wait_for(
            "views[0].references && [...views[0].references()].some((part) => part.axis_label_text_color === '#9aa5b1')"
        )
    assert complaints == []
    assert len(drawn) > 5
    assert all(drawn)
    assert loaded == 0
    assert len(starts) > 5
    assert set(starts) == {2}
    assert zooms


# 1280 px wide; with everything shown it was more than 13,000 px.
_HIGHEST_PX = 6500


@pytest.mark.slow
@needs_browser
def test_a_page_of_a_minute_is_short_until_it_is_unfolded(rig: CameraRig, skeleton: Skeleton, tmp_path: Path) -> None:
    from finished_walk import changed, finished_walk

    pytest.importorskip("bokeh")
    walk = finished_walk(rig, skeleton)
    over_time = ("positions_m", "status", "covariance_m2", "residual_px", "visibility")
    tiled = {name: np.concatenate(6 * [getattr(walk.main, name)]) for name in over_time}
    minute = changed(replace(walk, observations={}), time_s=np.arange(6 * walk.main.n_frames) / 30, **tiled)
    write_report(minute, tmp_path / "report.html")
    with opened(tmp_path / "report.html") as page:
        height_px, n_first = page.value("document.documentElement.scrollHeight"), page.value("views.length")
        page.value("views.find(isOverTime).x_range.setv({start: 2, end: 3})")
        page.value("document.querySelectorAll('details').forEach((each) => { each.open = true; })")
        n_all = page.value("document.querySelectorAll('.plot').length")
        page.wait_for(f"document.documentElement.dataset.plots === '{n_all}'")
        drawn, complaints = page.value(_DRAWN), page.value("complaints")
        # They show the time that the others show.
        starts = page.value("views.filter(isOverTime).map((view) => view.x_range.start)")
    assert height_px < _HIGHEST_PX
    assert n_first < 12 < n_all
    assert len(drawn) == n_all
    assert all(drawn)
    assert complaints == []
    assert set(starts) == {2}


# Of what is shown: headings in order, pictures with words, and controls with names.
_IS_ACCESSIBLE = """(() => {
  const shown = (each) => !each.closest("[hidden]");
  const levels = [...document.querySelectorAll("h1, h2, h3")].filter(shown).map((each) => Number(each.tagName[1]));
  const skipped = levels.some((level, n) => level > (levels[n - 1] ?? 0) + 1);
  const pictures = [...document.querySelectorAll("img, [role=img]")];
  const nameless = pictures.filter((each) => !(each.alt || each.getAttribute("aria-label"))).length;
  const controls = [...document.querySelectorAll("select, input")].filter((each) => !each.labels.length).length;
  return levels[0] === 1 && !skipped && nameless === 0 && controls === 0;
})()"""


def press(page: Browser, key: str, code: int, text: str = "") -> None:
    for kind in ("keyDown", "keyUp"):
        words = {"text": text} if text and kind == "keyDown" else {}
        page.call("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code, **words)


@pytest.mark.slow
@needs_browser
def test_a_browser_shows_the_person_who_is_chosen(rig: CameraRig, skeleton: Skeleton, tmp_path: Path) -> None:
    from finished_walk import finished_walk

    pytest.importorskip("bokeh")
    walk = finished_walk(rig, skeleton)
    late = replace(walk.main, time_s=walk.main.time_s + 5)
    two = replace(walk, people={3: walk.main, 8: late}, observations={})
    write_report(two, tmp_path / "report.html")
    visible = "[...document.querySelectorAll('.of-person:not([hidden]) > h3')].map((each) => each.innerText)"
    with opened(tmp_path / "report.html") as page:
        n_all = page.value("[...document.querySelectorAll('.plot')].filter((each) => !each.closest('details')).length")
        n_first, first = page.value("views.length"), page.value(visible)
        page.value("views.find(isOverTime).x_range.setv({start: 6, end: 7})")
        page.value("document.getElementById('person').focus()")
        press(page, "ArrowDown", 40)
        page.wait_for(f"views.length === {n_all} && document.documentElement.dataset.plots === '{n_all}'")
        second, drawn, complaints = page.value(visible), page.value(_DRAWN), page.value("complaints")
        # The zoom is kept, and what was printed is said on the paper.
        starts = page.value("views.filter((each) => isOverTime(each) && !isHidden(each)).map((e) => e.x_range.start)")
        printed, is_accessible = page.value("document.getElementById('printed').innerText"), page.value(_IS_ACCESSIBLE)
        page.value(
            "addEventListener('beforeprint', () => { window.wide = [...document.querySelectorAll('.plot')]"
            ".filter((each) => each.clientWidth * each.style.getPropertyValue('--zoom') > 688).length; })"
        )
        paper = page.call("Page.printToPDF", preferCSSPageSize=True)["data"]
        n_wide = page.value("window.wide")
        press(page, "ArrowUp", 38)
        again = page.value(visible)
        page.wait_for(f"{_DRAWN}.every(Boolean)")
    assert set(first) == {"Person 3"}
    assert set(second) == {"Person 8"}
    assert again == first
    assert len(first) == len(second) == 5
    assert n_first < n_all - 3
    assert all(drawn)
    assert complaints == []
    assert set(starts) == {6}
    assert printed == "person 8"
    assert is_accessible
    # As wide as A4 between its margins, at most.
    assert n_wide == 0
    assert base64.b64decode(paper).startswith(b"%PDF")


@pytest.mark.slow
@needs_browser
def test_a_browser_sorts_and_filters_a_study(rig: CameraRig, skeleton: Skeleton, tmp_path: Path) -> None:
    from finished_walk import finished_walk

    pytest.importorskip("bokeh")
    picture = thumbnail(finished_walk(rig, skeleton))
    recordings = [
        StudyRecording(f"S{n:02}/walk", {"reprojection_px": 5.0 + n % 3, "sigma_mm": 9.0 + n}, picture=picture)
        for n in range(9)
    ]
    recordings[4] = replace(recordings[4], reason="camera ring_2 is late")
    recordings.append(StudyRecording("S09/walk", status="failed", reason="empty"))
    write_study_report(recordings, tmp_path / "study.html")
    rows = (
        "[...document.querySelectorAll('tbody tr')].filter((row) => !row.hidden).map((row) => row.cells[0].innerText)"
    )
    with opened(tmp_path / "study.html") as page:
        first = page.value(rows)
        pictures = page.value("[...document.querySelectorAll('td svg')].every((svg) => svg.getBBox().width > 100)")
        is_accessible = page.value(_IS_ACCESSIBLE)
        heading = "[...document.querySelectorAll('th button')].find((button) => button.innerText.startsWith('sigma'))"
        page.value(f"{heading}.click()")
        falling, arrow = page.value(rows), page.value(f"{heading}.closest('th').getAttribute('aria-sort')")
        page.value(f"{heading}.focus()")
        press(page, "Enter", 13, "\r")
        rising = page.value(rows)
        page.value(
            "{const input = document.querySelector('input[type=search]'); input.value = 'LATE ring_2';"
            "input.dispatchEvent(new Event('input'));}"
        )
        filtered, count = page.value(rows), page.value("document.querySelector('output').innerText")
        complaints, drawn = page.value("complaints"), page.value(_DRAWN)
    assert first[0] == "S09/walk"
    assert falling == [f"S{n:02}/walk" for n in (*range(8, -1, -1), 9)]
    assert arrow == "descending"
    assert rising == falling[::-1]
    assert filtered == ["S04/walk"]
    assert count == "1 of 10"
    assert complaints == []
    assert drawn == [True]
    assert pictures
    assert is_accessible


if __name__ == "__main__":
    with opened(Path(sys.argv[1]).resolve()) as shown:
        shown.call("Emulation.setDeviceMetricsOverride", width=1100, height=1250, deviceScaleFactor=1, mobile=False)
        Path(sys.argv[2]).write_bytes(base64.b64decode(shown.call("Page.captureScreenshot")["data"]))
