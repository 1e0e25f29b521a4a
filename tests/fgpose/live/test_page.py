"""The status page over real HTTP, with well-meaning clients and with others."""

from __future__ import annotations

import http.client
import json
import os
import signal
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, suppress
from dataclasses import replace
from typing import Any
from unittest.mock import Mock
from urllib.parse import quote, urlsplit

import cv2
import numpy as np
import pytest
from live_frames import live_frame, live_judgement, live_person, standing_m

from fgpose.geometry.camera import CameraRig
from fgpose.live.frame import CameraState, LiveJudgement
from fgpose.live.link_distance import DistanceFault, LinkDistance
from fgpose.live.page.page_state import LATENCY_EDGES_MS, PageState
from fgpose.live.page.status_page import StatusPage
from fgpose.live.processes.parts import Parts
from fgpose.skeleton import Skeleton

NOW_S = 1000.0
NAME = "left/door ü"


@pytest.fixture(scope="module")
def odd_rig(rig: CameraRig) -> CameraRig:
    """The first camera has a name that needs quoting."""
    return CameraRig((replace(rig.cameras[0], name=NAME), *rig.cameras[1:]))


@pytest.fixture(scope="module")
def page(odd_rig: CameraRig, skeleton: Skeleton) -> Iterator[StatusPage]:
    with StatusPage(
        odd_rig, skeleton, port=0, now_s=lambda: NOW_S, faults=lambda: {"zmq": "the port is taken"}
    ) as page:
        yield page


def address(page: StatusPage) -> tuple[str, int]:
    parts = urlsplit(page.url)
    assert parts.hostname
    assert parts.port
    return parts.hostname, parts.port


def ask(page: StatusPage, path: str, method: str = "GET", **headers: str) -> tuple[int, bytes, dict[str, str]]:
    # The server starts within seconds, on a busy computer too.
    with closing(http.client.HTTPConnection(*address(page), timeout=60)) as connection:
        connection.request(method, path, headers=headers)
        response = connection.getresponse()
        return response.status, response.read(), dict(response.getheaders())


def wait_for(page: StatusPage, path: str) -> bytes:
    """Content that changes is renewed every 0.4 s."""
    for _ in range(1200):
        status, body, _ = ask(page, path)
        if status == 200:
            return body
        time.sleep(0.1)
    raise AssertionError(f"{path} never came")


def test_the_page_needs_nothing_from_elsewhere(page: StatusPage) -> None:
    status, body, headers = ask(page, "/")
    assert status == 200
    assert headers["Content-Type"] == "text/html; charset=utf-8"
    assert b"<title>fgpose live</title>" in body
    assert b"//" not in body.replace(b"http://www.w3.org/2000/svg", b"").partition(b"<script>")[0]
    assert b"http" not in body.replace(b"http://www.w3.org/2000/svg", b"")
    assert headers["Content-Security-Policy"].startswith("default-src 'none'")


def test_the_state_is_that_of_the_newest_frame(page: StatusPage, odd_rig: CameraRig, skeleton: Skeleton) -> None:
    person = live_person(standing_m(skeleton, (1.0, 2.0)), 7)
    page.publish(live_frame(skeleton, [person], NOW_S - 0.05, cameras=odd_rig.names, lost=("ring_2",), sequence=3))
    state = json.loads(wait_for(page, "/state.json"))
    assert state["frame"]["sequence"] == 3
    assert [camera["state"] for camera in state["cameras"]] == ["ok", "ok", "lost", "ok"]
    assert state["cameras"][0]["name"] == NAME
    assert state["people"][0]["person"] == 7
    assert state["people"][0]["at_m"] == [1.0, 2.0]
    assert state["outputs"] == [{"name": "zmq", "fault": "the port is taken"}]
    assert state["now_s"] == NOW_S


def test_pictures_are_small_and_of_the_right_camera(page: StatusPage) -> None:
    path = f"/camera/{quote(NAME, safe='')}.jpg"
    red = np.zeros((720, 1280, 3), np.uint8)
    red[..., 0] = 200
    page.show_image(NAME, red)
    body = wait_for(page, path)
    image = cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert image.shape == (270, 480, 3)
    # Of JPEG: a few grey levels. OpenCV has blue first.
    np.testing.assert_allclose(image.mean(axis=(0, 1)), (0, 0, 200), atol=5)
    assert ask(page, "/camera/ring_1.jpg")[0] == 503
    with pytest.raises(ValueError, match="no camera ring_0; the rig has left/door ü, ring_1"):
        page.show_image("ring_0", red)
    with pytest.raises(ValueError, match=r"camera ring_1: a picture is .* got \(720, 1280\)"):
        page.show_image("ring_1", red[..., 0])


def test_what_nobody_asks_for_is_not_made(page: StatusPage, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []
    monkeypatch.setattr("fgpose.live.page.status_page.drawn_jpeg", lambda *picture: made.append(picture) or b"picture")
    picture = np.zeros((4, 4, 3), np.uint8)
    for _ in range(50):
        page.show_image("ring_3", picture)
    assert not made
    began_s = time.monotonic()
    wait_for(page, "/camera/ring_3.jpg")
    assert [ask(page, "/camera/ring_3.jpg")[1] for _ in range(10)] == [b"picture"] * 10
    # One each 0.4 s at most; the first and the last are in no full interval.
    assert 1 <= len(made) <= 2 + (time.monotonic() - began_s) / 0.4


@pytest.mark.parametrize(
    ("path", "method", "headers", "status"),
    [
        ("/nothing", "GET", {}, 404),
        ("/camera/../../etc/passwd", "GET", {}, 404),
        ("/camera/%00.jpg", "GET", {}, 404),
        ("/camera/%ff.jpg", "GET", {}, 404),
        ("/state.json", "POST", {}, 405),
        ("/", "DELETE", {}, 405),
        ("/", "HEAD", {}, 200),
        ("/?x=1", "GET", {}, 200),
        ("/", "GET", {"Host": "localhost:1"}, 200),
        ("/", "GET", {"Host": "[::1]:80"}, 200),
        ("/", "GET", {"Host": "cell-7.local"}, 200),
        ("/", "GET", {"Host": "attacker.example"}, 421),
        ("/", "GET", {"X-Long": 20_000 * "x"}, 431),
    ],
)
def test_odd_requests(page: StatusPage, path: str, method: str, headers: dict[str, str], status: int) -> None:
    assert ask(page, path, method, **headers)[0] == status


def test_a_huge_request_is_refused_before_it_has_come(page: StatusPage) -> None:
    with socket.create_connection(address(page), timeout=60) as client:
        client.sendall(b"POST /state.json HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000000000\r\n\r\n")
        assert client.recv(100).startswith(b"HTTP/1.1 413 ")


def test_slow_clients_leave_room_for_others(page: StatusPage) -> None:
    with ExitStack() as stack:
        for _ in range(60):
            slow = stack.enter_context(socket.create_connection(address(page), timeout=60))
            slow.sendall(b"GET /state.json HTTP/1.1\r\nHost: local")
        assert ask(page, "/")[0] == 200


def test_a_flood_asks_the_live_process_for_no_more_than_a_viewer(
    page: StatusPage, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []
    content = page._content
    monkeypatch.setattr(page, "_content", lambda path: asked.append(path) or content(path))
    began_s = time.monotonic()
    with closing(http.client.HTTPConnection(*address(page), timeout=60)) as client:
        for _ in range(40):
            client.request("GET", "/state.json")
            assert client.getresponse().read()
    # One each 0.4 s at most; the first and the last are in no full interval.
    assert len(asked) <= 2 + (time.monotonic() - began_s) / 0.4


@pytest.mark.slow
def test_a_server_that_is_killed_comes_back(odd_rig: CameraRig, skeleton: Skeleton) -> None:
    parts = Parts()
    with StatusPage(odd_rig, skeleton, port=0, parts=parts) as page:
        wait_for(page, "/state.json")
        page._process.kill()
        page._process.wait()
        # Frames are taken meanwhile, and the socket goes on listening.
        page.publish(live_frame(skeleton, cameras=odd_rig.names))
        state = json.loads(wait_for(page, "/state.json"))
        assert state["frame"]["sequence"] == 0
        assert [(each.part, each.n) for each in parts.so_far()] == [("the status page", 1)]


def test_ctrl_c_does_not_reach_the_server(page: StatusPage) -> None:
    """A terminal sends it to all processes of the group in front."""
    assert os.getpgid(page._process.pid) != os.getpgrp()


def test_a_server_that_is_stopped_is_replaced(odd_rig: CameraRig, skeleton: Skeleton) -> None:
    parts = Parts()
    with StatusPage(odd_rig, skeleton, port=0, parts=parts) as page:
        wait_for(page, "/state.json")
        server = page._process
        server.send_signal(signal.SIGSTOP)
        server.wait(60)
        wait_for(page, "/state.json")
        page._process.send_signal(signal.SIGSTOP)
    assert page._process.returncode is not None
    assert [each.reason for each in parts.so_far()] == ["its server ended with status -9"]


def test_what_cannot_be_shown_does_not_end_the_page(
    odd_rig: CameraRig, skeleton: Skeleton, monkeypatch: pytest.MonkeyPatch
) -> None:
    parts = Parts()
    with StatusPage(odd_rig, skeleton, port=0, parts=parts) as page:
        with monkeypatch.context() as patched:
            patched.setattr(page._state, "to_json", Mock(side_effect=ZeroDivisionError("of nothing")))
            server = page._process
            # It asks when what it has is no longer new.
            while server.poll() is None:
                with suppress(OSError, http.client.HTTPException):
                    ask(page, "/state.json")
        page.publish(live_frame(skeleton, cameras=odd_rig.names))
        assert json.loads(wait_for(page, "/state.json"))["frame"]["sequence"] == 0
    assert [each.reason for each in parts.so_far()] == ["ZeroDivisionError: of nothing"]


def test_it_listens_only_where_it_should_and_says_which_port_is_taken(
    page: StatusPage, odd_rig: CameraRig, skeleton: Skeleton
) -> None:
    host, port = address(page)
    assert host == "127.0.0.1"
    with pytest.raises(OSError, match=f"cannot be served on port {port} of 127.0.0.1: Address already in use"):
        StatusPage(odd_rig, skeleton, port=port)
    with pytest.raises(OSError, match=r"on port 0 of 203.0.113.7"):
        StatusPage(odd_rig, skeleton, port=0, host="203.0.113.7")
    with pytest.raises(OSError, match="port 70000: ports are 0 to 65535"):
        StatusPage(odd_rig, skeleton, port=70_000)


def test_close_ends_the_server_and_frees_the_port(odd_rig: CameraRig, skeleton: Skeleton) -> None:
    page = StatusPage(odd_rig, skeleton, port=0)
    host, port = address(page)
    page.close()
    page.close()
    assert page._process.poll() is not None
    with socket.create_server((host, port)):
        pass


def test_without_waitress_it_says_what_to_install(
    odd_rig: CameraRig, skeleton: Skeleton, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r'needs waitress: pip install "fgpose\[live\]"'):
        StatusPage(odd_rig, skeleton, port=0)


@pytest.fixture
def state(rig: CameraRig, skeleton: Skeleton) -> PageState:
    return PageState(rig, skeleton, "+z")


def shown(state: PageState, now_s: float = NOW_S) -> dict[str, Any]:
    return json.loads(state.to_json(now_s, (), {}))


def test_delays_are_counted_once_for_each_image(state: PageState, rig: CameraRig, skeleton: Skeleton) -> None:
    for delay_s in (0.012, 0.022, 0.024, 0.7, 3.0):
        frame = live_frame(skeleton, (), NOW_S - 5 - delay_s, cameras=rig.names, delay_s=delay_s)
        # Published again without a new image, as always at a steady rate.
        state.add(frame)
        state.add(replace(frame, published_s=frame.published_s + 0.01))
    latency = shown(state)["latency"]
    counts = dict(zip(latency["edges_ms"], latency["counts"], strict=True))
    assert latency["edges_ms"] == list(LATENCY_EDGES_MS)
    assert {edge: count for edge, count in counts.items() if count} == {10: 1, 20: 2, 500: 1, 1000: 1}
    assert latency["median_ms"] == pytest.approx(24.0, abs=0.01)
    assert sum(shown(state, NOW_S + 60)["latency"]["counts"]) == 0


def test_events_tell_what_changed(state: PageState, rig: CameraRig, skeleton: Skeleton) -> None:
    person = live_person(standing_m(skeleton), 4)
    state.add(live_frame(skeleton, (), NOW_S, cameras=rig.names))
    state.add(live_frame(skeleton, [person], NOW_S + 1, cameras=rig.names, lost=("ring_1",)))
    state.add(live_frame(skeleton, [person], NOW_S + 2, cameras=rig.names, lost=("ring_1",)))
    known = replace(person, person=2, former=4)
    state.add(live_frame(skeleton, [known], NOW_S + 2.5, cameras=rig.names))
    state.add(live_frame(skeleton, (), NOW_S + 3, cameras=rig.names))
    fault = DistanceFault("no image has come yet", NOW_S + 4)
    distance = LinkDistance("arm", -np.inf, -np.inf, None, "", "", np.nan, np.inf, np.nan, 0.0, fault)
    state.set_distances([distance])
    state.set_distances([distance])
    events = [(event["text"], event["is_fault"]) for event in shown(state)["events"]]
    assert events == [
        ("camera ring_1 lost: nothing has come for 2.0 s", True),
        ("person 4 is there", False),
        ("camera ring_1 ok", False),
        ("person 4 is recognised as person 2", False),
        ("person 2 is gone", False),
        ("arm: no image has come yet", True),
    ]


def test_what_is_wrong_is_shown_and_when_it_appears_and_goes(
    state: PageState, rig: CameraRig, skeleton: Skeleton
) -> None:
    frame = live_frame(skeleton, (), NOW_S, cameras=rig.names)
    state.add(frame)
    assert shown(state)["diagnosis"] is None
    waits = LiveJudgement(waits_for="nobody was seen to move yet")
    state.add(replace(frame, diagnosis=waits))
    diagnosis = shown(state)["diagnosis"]
    assert (diagnosis["judged_s"], diagnosis["waits_for"]) == (None, "nobody was seen to move yet")
    for _ in range(2):
        state.add(replace(frame, diagnosis=live_judgement("ring_1", NOW_S)))
    diagnosis = shown(state)["diagnosis"]
    assert (diagnosis["from_s"], diagnosis["to_s"], diagnosis["judged_s"]) == (NOW_S - 62.0, NOW_S - 2.0, NOW_S)
    assert [(each["severity"], each["camera"], each["code"]) for each in diagnosis["findings"]] == [
        ("wrong", "ring_1", "mirrored-image"),
        ("doubtful", "", "late-camera"),
    ]
    state.add(replace(frame, diagnosis=replace(live_judgement("ring_1"), findings=())))
    events = [(event["text"], event["is_fault"]) for event in shown(state)["events"]]
    assert events == [
        ("probably wrong: The images of ring_1 are mirrored. Switch mirroring off. [mirrored-image]", True),
        ("doubtful: All are late. Set the clocks. [late-camera]", True),
        ("no longer found: mirrored-image of ring_1", False),
        ("no longer found: late-camera", False),
    ]


def test_what_is_not_a_number_is_null(state: PageState, rig: CameraRig, skeleton: Skeleton) -> None:
    joints_m = np.full((skeleton.n_joints, 3), np.nan)
    frame = live_frame(skeleton, [live_person(joints_m)], NOW_S, cameras=rig.names)
    odd = replace(frame.cameras[0], rate_hz=np.nan, clock_offset_s=np.inf, state=CameraState.DOUBTFUL)
    state.add(replace(frame, cameras=(odd, *frame.cameras[1:])))
    found = shown(state)
    assert found["people"][0]["at_m"] == [None, None]
    assert found["cameras"][0]["rate_hz"] is None
    assert shown(state, NOW_S)["cameras"][0]["clock_offset_s"] is None


def test_from_above_right_is_right(rig: CameraRig, skeleton: Skeleton) -> None:
    at_m = np.array([1.0, 2.0, 3.0])
    found = {}
    for up in ("+x", "-x", "+y", "-y", "+z", "-z", "y"):
        state = PageState(rig, skeleton, up)
        state.add(live_frame(skeleton, [live_person(np.tile(at_m, (skeleton.n_joints, 1)))], NOW_S))
        found[up] = shown(state)["people"][0]["at_m"]
    # Right x ahead = up, as one looks down.
    assert found == {
        "+x": [2.0, 3.0], "-x": [3.0, 2.0], "+y": [3.0, 1.0], "-y": [1.0, 3.0], "+z": [1.0, 2.0], "-z": [2.0, 1.0],
        "y": [3.0, 1.0],
    }  # fmt: skip


def test_ellipses_hold_ninety_percent(state: PageState, skeleton: Skeleton) -> None:
    person = live_person(standing_m(skeleton), sigma_m=np.array([0.3, 0.1, 0.5]))
    state.add(live_frame(skeleton, [person], NOW_S))
    ellipse = shown(state)["people"][0]["ellipse"]
    # sqrt(4.605): the 90 % quantile of chi-square with two degrees of freedom. The hips' deviations are along x.
    np.testing.assert_allclose(ellipse["radii_m"], np.sqrt(4.605) * np.array([0.3, 0.1]), atol=1e-3)
    assert ellipse["turn_deg"] % 180 == pytest.approx(0.0)


def test_cameras_are_drawn_towards_what_they_see(state: PageState, rig: CameraRig) -> None:
    for camera, drawn in zip(rig.cameras, shown(state)["cameras"], strict=True):
        np.testing.assert_allclose(drawn["at_m"], camera.position_m[:2], atol=1e-3)
        middle = np.mean(drawn["sides"], axis=0)
        inwards = -camera.position_m[:2]
        # The ring looks at its middle.
        assert middle @ inwards / np.linalg.norm(middle) / np.linalg.norm(inwards) == pytest.approx(1.0, abs=1e-3)
