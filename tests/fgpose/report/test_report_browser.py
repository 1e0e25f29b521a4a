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
# Canvases with something on them, of all plots: they are in shadow roots.
_DRAWN = """(() => {
  const canvases = (node) => [...node.querySelectorAll("*")].flatMap((each) =>
    [...(each.tagName === "CANVAS" ? [each] : []), ...(each.shadowRoot ? canvases(each.shadowRoot) : [])]);
  const isDrawn = (canvas) => canvas.width > 0
    && canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data.some((value) => value > 0);
  return [...document.querySelectorAll(".plot")].map((plot) => canvases(plot).some(isDrawn));
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
    assert len(drawn) > 10
    assert all(drawn)
    assert loaded == 0
    assert len(starts) > 5
    assert set(starts) == {2}


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
        heading = "[...document.querySelectorAll('th button')].find((button) => button.innerText.startsWith('sigma'))"
        page.value(f"{heading}.click()")
        falling, arrow = page.value(rows), page.value(f"{heading}.closest('th').getAttribute('aria-sort')")
        page.value(f"{heading}.click()")
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


if __name__ == "__main__":
    with opened(Path(sys.argv[1]).resolve()) as shown:
        shown.call("Emulation.setDeviceMetricsOverride", width=1100, height=1250, deviceScaleFactor=1, mobile=False)
        Path(sys.argv[2]).write_bytes(base64.b64decode(shown.call("Page.captureScreenshot")["data"]))
