"""The status page in a real browser, with people walking and a camera lost.

``python tests/fgpose/live/test_page_browser.py docs/live_page.png`` takes the picture of the documentation.
"""

from __future__ import annotations

import base64
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote

import cv2
import numpy as np
import pytest
from live_frames import live_frame, live_judgement, live_person

from fgpose.association.track import TrackState
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.io.skeletons import load_skeleton
from fgpose.live.frame import CameraState, CameraStatus, LiveFrame
from fgpose.live.link_distance import DistanceFault, LinkDistance
from fgpose.live.page.status_page import StatusPage
from fgpose.trajectory import Status
from fgpose_benchmarks.synthetic import ring_rig, walking
from tests.fgpose.browser import BROWSER, browser

SKELETON = load_skeleton("h36m_17")
# A camera whose name would be a program if the page took it for HTML.
NAMES = ("door", "window", "<img src=x onerror=document.title='taken'>", "ceiling/2 ü")


def named_rig(names: tuple[str, ...]) -> CameraRig:
    """The second camera stands on its side."""
    cameras = list(ring_rig(4, 3.4, 2.3, focal_px=700.0, size_px=(1280, 720)).cameras)
    K = cameras[1].K.copy()
    K[:2, 2] = K[1, 2], K[0, 2]
    cameras[1] = replace(cameras[1], K=K, size_px=(720, 1280))
    return CameraRig(tuple(replace(camera, name=name) for camera, name in zip(cameras, names, strict=True)))


def people_m(time_s: float) -> list[np.ndarray]:
    """Two who walk past each other, and one who stands and turns."""
    stride_m = walking(120, 30.0, SKELETON)
    cycle = stride_m - stride_m[:, :1] * (1.0, 1.0, 0.0)
    pose_m = cycle[int(30 * time_s) % 120]
    ways = (
        (0.5 * time_s, np.array([-1.8 + 0.9 * (time_s % 4), 0.6, 0.0])),
        (0.9 * time_s, np.array([1.6 - 0.7 * (time_s % 4), -0.9, 0.0])),
        (0.2 * time_s, np.array([1.3, 1.5, 0.0])),
    )
    turned = []
    for turn, place_m in ways:
        R = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
        turned.append(pose_m @ R.T + place_m)
    return turned


def made_up_frame(rig: CameraRig, sequence: int, now_s: float, rng: np.random.Generator) -> LiveFrame:
    """The third camera is lost after the first frames, the second is late; the third person is coasting."""
    states = [CameraState.OK, CameraState.LATE, CameraState.LOST, CameraState.OK]
    reasons = ["", "images come 140 ms late", "nothing has come for 12.4 s; opened again in 4 s", ""]
    if sequence < 10:
        states, reasons = [CameraState.OK] * 4, [""] * 4
    cameras = tuple(
        CameraStatus(
            name, state, reason, now_s - (12.4 if state is CameraState.LOST else 0.04),
            0.0 if state is CameraState.LOST else 29.97, -0.0123 - 0.004 * number, 0.0011 + 0.0004 * number,
            8000 + sequence, 7950 + sequence, 12 * number,
        )
        for number, (name, state, reason) in enumerate(zip(rig.names, states, reasons, strict=True))
    )  # fmt: skip
    sigma_m = (0.02, 0.03, np.array([0.25, 0.15, 0.05]))
    track = (TrackState.CONFIRMED, TrackState.CONFIRMED, TrackState.COASTING)
    delay_s = float(0.018 + rng.gamma(2.0, 0.004))
    people = [
        live_person(joints_m, number + 1, sigma_m[number], track[number])
        for number, joints_m in enumerate(people_m(now_s - delay_s))
    ]
    people[2] = replace(people[2], status=np.full(SKELETON.n_joints, Status.PREDICTED))
    frame = live_frame(SKELETON, people, now_s - delay_s, sequence=sequence, delay_s=delay_s)
    share = 0.83 if sequence >= 10 else 1.0
    return replace(frame, cameras=cameras, observed_share=share, diagnosis=live_judgement(rig.names[2], now_s))


def picture(camera: Camera, time_s: float) -> np.ndarray:
    """Stick figures on a floor."""
    width, height = camera.size_px
    image = np.full((height, width, 3), (84, 92, 102), np.uint8)
    for at in np.arange(-3.0, 3.5, 0.5):
        for ends_m in (((at, -3.0, 0.0), (at, 3.0, 0.0)), ((-3.0, at, 0.0), (3.0, at, 0.0))):
            line_px = camera.project(np.linspace(*ends_m, 60))
            known = np.isfinite(line_px).all(axis=1) & (np.abs(line_px) < 1e4).all(axis=1)
            cv2.polylines(image, [np.round(line_px[known]).astype(np.int32)], False, (112, 120, 130), 2)
    for colour, joints_m in zip(((120, 180, 255), (255, 190, 110), (150, 230, 160)), people_m(time_s), strict=True):
        joints_px = np.round(camera.project(joints_m)).astype(int)
        for start, end in SKELETON.bones:
            cv2.line(image, joints_px[start].tolist(), joints_px[end].tolist(), colour, 16, cv2.LINE_AA)
    return image


@contextmanager
def served(names: tuple[str, ...]) -> Iterator[StatusPage]:
    """A page that is fed with 30 frames and 2 pictures of each camera a second."""
    rig, rng, over = named_rig(names), np.random.default_rng(0), threading.Event()
    faults = {"zmq tcp://127.0.0.1:5561": "", "recording out/today": "the disk is full"}
    with StatusPage(rig, SKELETON, port=0, faults=lambda: faults) as page:
        fault = DistanceFault("the data are 0.61 s old", time.time() - 300)
        page.show_distances([
            LinkDistance("forearm", 0.412, 0.55, 1, "left hand", "left_wrist", 0.82, 0.03, 0.01, 1.0, None),
            LinkDistance("gripper", 0.63, 0.8, 1, "left hand", "left_wrist", 0.4, 0.03, 0.01, 1.0, fault),
        ])  # fmt: skip

        def feed() -> None:
            for sequence in range(100_000):
                if over.wait(1 / 30):
                    return
                page.publish(made_up_frame(rig, sequence, time.time(), rng))

        def film() -> None:
            shown = rig.cameras
            while not over.wait(0.5):
                for camera in shown:
                    taken_s = time.time()
                    page.show_image(camera.name, picture(camera, taken_s), taken_s)
                shown = (rig.cameras[0], rig.cameras[1], rig.cameras[3])

        threads = [threading.Thread(target=each) for each in (feed, film)]
        for thread in threads:
            thread.start()
        try:
            yield page
        finally:
            over.set()
            for thread in threads:
                thread.join()


# Somebody is coasting, a camera is lost, and the pictures have come.
IS_SHOWN = """document.body.innerText.includes("person 3 coasting") && document.querySelector("article.fault") !== null
    && [...document.images].length === 4
    && [...document.images].every((image) => Math.max(image.naturalWidth, image.naturalHeight) === 480)"""


# Width and height of each picture as it came, and of the box in which it is drawn as large as it can be.
SHAPES = """[...document.images].map((image) => [
    image.naturalWidth, image.naturalHeight, getComputedStyle(image).objectFit,
    image.getBoundingClientRect().height <= image.parentElement.getBoundingClientRect().height])"""


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="no Chromium is installed (apt-get install chromium)")
def test_a_browser_shows_cameras_people_and_faults() -> None:
    with served(NAMES) as page, browser(page.url) as opened:
        opened.wait_for(IS_SHOWN)
        text, title = opened.value("document.body.innerText"), opened.value("document.title")
        pictures = opened.value("[...document.images].map((image) => image.src)")
        shapes = opened.value(SHAPES)
        loaded = opened.value("performance.getEntriesByType('resource').map((entry) => entry.name)")
        page.close()
        # What is shown is said to be old when nobody answers any more.
        opened.wait_for('document.querySelector("#alarm").innerText.startsWith("No answer from fgpose since")')
    assert "✕ lost" in text
    assert "nothing has come for 12.4 s" in text
    assert "▲ late" in text
    assert f"✕ wrong The images of {NAMES[2]} are mirrored. Switch mirroring off. [mirrored-image]" in text
    assert "Not judged: lenses (it is short)." in text
    assert "person 1" in text
    assert "person 3 coasting" in text
    assert "-20.3 ± 1.9 ms" in text
    assert "2 of 4 ok" in text
    assert "✕ the disk is full" in text
    assert "the data are 0.61 s old (since" in text
    # Of every camera, also those whose names need quoting.
    shown = {unquote(picture.partition("?")[0]) for picture in pictures}
    assert shown == {f"{page.url}camera/{name}.jpg" for name in NAMES}
    # All of a picture is shown, also of the camera on its side.
    assert shapes == [[480, 270, "contain", True], [270, 480, "contain", True], *[[480, 270, "contain", True]] * 2]
    # A name is a text, not a program.
    assert NAMES[2] in text
    assert title == "fgpose live"
    # Nothing comes from elsewhere.
    assert loaded
    assert all(address.startswith(page.url) for address in loaded)


if __name__ == "__main__":
    with served(("door", "window", "conveyor", "ceiling")) as shown, browser(shown.url) as opened_page:
        if sys.argv[2:] == ["dark"]:
            dark = [{"name": "prefers-color-scheme", "value": "dark"}]
            opened_page.call("Emulation.setEmulatedMedia", features=dark)
        opened_page.wait_for(IS_SHOWN)
        time.sleep(15)
        Path(sys.argv[1]).write_bytes(base64.b64decode(opened_page.call("Page.captureScreenshot")["data"]))
