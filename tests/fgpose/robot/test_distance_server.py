"""Distances over ZeroMQ: what is measured is published, whatever a robot sends or does not send."""

from __future__ import annotations

import math
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import msgpack
import numpy as np
import pytest
import zmq

from fgpose.geometry.camera import CameraRig
from fgpose.io.live.packing import packed
from fgpose.live.frame import LiveFrame
from fgpose.live.link_distance import DistanceFault, LinkDistance
from fgpose.live.outputs import Output
from fgpose.live.reception.rejections import MessageError
from fgpose.live.tracking.observed import Volume
from fgpose.robot.cell import Capsule, Cell, Limits, Link
from fgpose.robot.distance_messages import (
    MAX_ROBOT_BYTES,
    decode_distances,
    decode_robot,
    encode_distances,
    encode_robot,
)
from fgpose.robot.distance_server import DistanceServer
from fgpose.robot.distances import DistanceMonitor
from fgpose.robot.robot_poses import RobotPoses
from fgpose.skeleton import Skeleton
from tests.fgpose.live.live_frames import live_frame, live_person, standing_m
from tests.fgpose.live.output_frames import wait_until

ARM = Link("arm", (Capsule((0.0, 0.0, 0.0), (0.0, 0.0, 0.4), 0.05),))
POST = Link("post", (Capsule((0.0, 0.0, 0.5), (0.0, 0.0, 1.2), 0.1),), is_fixed=True)
CELL = Cell((ARM, POST), Limits(max_age_s=0.4), Volume((-1.0, -1.0, 0.2), (1.0, 1.0, 1.8)))
WORLD_T_ARM = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.8], [0.0, 0.0, 1.0, 0.8], [0.0, 0.0, 0.0, 1.0]])
WAITS_S = 120.0


class Robot:
    """Sends and hears, as a robot does."""

    def __init__(self, server: DistanceServer) -> None:
        self._context = zmq.Context()
        self.poses, self._distances = self._context.socket(zmq.PUSH), self._context.socket(zmq.SUB)
        self.poses.connect(server.poses_address)
        self._distances.setsockopt(zmq.CONFLATE, 1)
        self._distances.subscribe(b"")
        self._distances.connect(server.address)

    def hear(self) -> dict[str, LinkDistance]:
        assert self._distances.poll(round(1000 * WAITS_S))
        return {distance.link: distance for distance in decode_distances(self._distances.recv())}

    def hear_fault(self, link: str, reason: str) -> LinkDistance:
        """Wait until a link has a fault, empty: until it has none, and return what was heard then."""
        end_s = time.monotonic() + WAITS_S
        while True:
            heard = self.hear()[link]
            fault = heard.fault
            if (fault is None and not reason) or (fault is not None and reason and reason in fault.reason):
                return heard
            assert time.monotonic() < end_s, fault

    def close(self) -> None:
        self._context.destroy(linger=0)


@contextmanager
def serving(rig: CameraRig, skeleton: Skeleton, **options: Any) -> Iterator[tuple[DistanceServer, Robot]]:
    server = DistanceServer(CELL, rig, skeleton, port=0, poses_port=0, **options)
    robot = Robot(server)
    try:
        yield server, robot
    finally:
        robot.close()
        server.close()


@pytest.fixture
def frame(rig: CameraRig, skeleton: Skeleton) -> LiveFrame:
    """Somebody beside the post."""
    return live_frame(skeleton, [live_person(standing_m(skeleton, (1.5, 0.0)), 7)], 1000.0, cameras=rig.names)


def test_what_is_published_is_what_a_monitor_measures(rig: CameraRig, skeleton: Skeleton, frame: LiveFrame) -> None:
    shown = []
    with serving(rig, skeleton, now_s=lambda: 1000.1, show=shown.append) as (server, robot):
        assert isinstance(server, Output)
        server.publish(frame)
        robot.poses.send(encode_robot({"arm": WORLD_T_ARM}, reset=True))
        robot.hear_fault("arm", "")
        heard = robot.hear()
        assert server.state.is_working
        assert server.state.n_published > 1
    monitor = DistanceMonitor(CELL, rig, skeleton)
    monitor.publish(frame)
    expected = {distance.link: distance for distance in monitor.measure({"arm": WORLD_T_ARM}, 1000.1)}
    for link in ("arm", "post"):
        # Compared as text: NaN, of closing speeds that are not known, is no equal of itself.
        assert str(heard[link]) == str(expected[link])
    assert heard["post"].person == 7
    assert [distance.link for distance in shown[-1]] == ["arm", "post"]


def test_a_robot_that_falls_silent_is_a_fault_that_stays(rig: CameraRig, skeleton: Skeleton, frame: LiveFrame) -> None:
    now_s = [1000.1]
    with serving(rig, skeleton, now_s=lambda: now_s[0]) as (server, robot):
        robot.hear_fault("arm", "no image has come yet")
        server.publish(frame)
        # The latched fault is of the frame that was missing.
        assert robot.hear()["arm"].distance_m == -math.inf
        robot.poses.send(encode_robot({"arm": WORLD_T_ARM}, reset=True))
        robot.hear_fault("arm", "")
        now_s[0] += 0.41  # more than max_age_s after the pose
        server.publish(replace(frame, time_s=now_s[0]))
        robot.hear_fault("arm", "its pose is 0.41 s old")
        robot.poses.send(encode_robot({"arm": WORLD_T_ARM}))
        while robot.hear()["arm"].distance_m == -math.inf:
            pass
        assert robot.hear()["arm"].fault is not None


def test_frames_that_stop_are_a_fault(rig: CameraRig, skeleton: Skeleton, frame: LiveFrame) -> None:
    now_s = [1000.1]
    with serving(rig, skeleton, now_s=lambda: now_s[0]) as (server, robot):
        server.publish(frame)
        robot.poses.send(encode_robot({"arm": WORLD_T_ARM}, reset=True))
        fresh = robot.hear_fault("post", "")
        now_s[0] += 1.0
        old = robot.hear_fault("post", "the data are 1.10 s old")
    # Whoever stands beside it may have come nearer meanwhile.
    assert old.age_s == pytest.approx(1.1, abs=1e-6)
    assert old.distance_m < fresh.distance_m


def test_messages_that_are_wrong_are_counted(rig: CameraRig, skeleton: Skeleton, frame: LiveFrame) -> None:
    told = []
    with serving(rig, skeleton, now_s=lambda: 1000.1, tell=told.append) as (server, robot):
        server.publish(frame)
        for _ in range(500):
            robot.poses.send(b"\xc1")
        robot.poses.send_multipart([b"two", b"parts"])
        robot.poses.send(encode_robot({"gripper": WORLD_T_ARM}))
        robot.poses.send(encode_robot({"arm": WORLD_T_ARM}, reset=True))
        robot.hear_fault("arm", "")
        refused = {rejected.kind: rejected.n for rejected in server.rejected}
        # How many wait together is up to the machine; of those only the newest are read.
        assert refused.pop("link") == 1
        assert sum(refused.values()) == 501
        assert refused.keys() <= {"content", "old"}
        assert "refused (content)" in server.state.last_error
    assert len(told) == 2 + ("old" in refused)


def test_garbage_costs_what_it_costs_to_drop_it(rig: CameraRig, skeleton: Skeleton, frame: LiveFrame) -> None:
    """An array in place of a text was compared by element, which failed, once for each message that waited."""
    with serving(rig, skeleton, now_s=lambda: 1000.1) as (server, robot):
        server.publish(frame)
        for _ in range(900):
            robot.poses.send(packed({"format": np.zeros(2, dtype=np.float32), "version": 1}))
        robot.poses.send(encode_robot({"arm": WORLD_T_ARM}, reset=True))
        robot.hear_fault("arm", "")
        n_before = server.state.n_published
        while server.state.n_published <= n_before:
            robot.hear()  # fails if there is silence
        assert "cannot be measured" not in server.state.last_error


def test_a_pose_is_as_old_as_the_robot_says(rig: CameraRig, skeleton: Skeleton, frame: LiveFrame) -> None:
    with serving(rig, skeleton, now_s=lambda: 1000.1) as (server, robot):
        server.publish(frame)
        robot.poses.send(encode_robot({"arm": WORLD_T_ARM}, time_s=1000.0, reset=True))
        assert robot.hear_fault("arm", "").pose_age_s == pytest.approx(0.1, abs=1e-6)
        robot.poses.send(encode_robot({"arm": WORLD_T_ARM}, time_s=1010.0))
        robot.poses.send(encode_robot({"arm": WORLD_T_ARM}, time_s=999.0, reset=True))
        old = robot.hear_fault("arm", "its pose is 1.10 s old")
        assert old.distance_m == -math.inf
        assert {each.kind: each.n for each in server.rejected} == {"time": 1}


def test_where_two_say_where_a_link_is_it_has_no_pose(rig: CameraRig, skeleton: Skeleton, frame: LiveFrame) -> None:
    now_s = [1000.1]
    with serving(rig, skeleton, now_s=lambda: now_s[0]) as (server, robot):
        server.publish(frame)
        robot.poses.send(encode_robot({"arm": WORLD_T_ARM}, reset=True))
        robot.hear_fault("arm", "")
        other = Robot(server)
        try:
            other.poses.send(encode_robot({"arm": np.eye(4)}))
            robot.hear_fault("arm", "it has no pose")
        finally:
            other.close()
        assert "link arm: a second sender" in server.state.last_error
        now_s[0] += 1.1  # the other one is gone
        server.publish(replace(frame, time_s=now_s[0]))
        robot.poses.send(encode_robot({"arm": WORLD_T_ARM}, reset=True))
        assert robot.hear_fault("arm", "").expected_m > 0.5


def test_only_whose_poses_count_may_reset(rig: CameraRig, skeleton: Skeleton, frame: LiveFrame) -> None:
    with serving(rig, skeleton, now_s=lambda: 1000.1) as (server, robot):
        robot.poses.send(encode_robot({"arm": WORLD_T_ARM}))
        robot.hear_fault("arm", "no image has come yet")
        server.publish(frame)
        other = Robot(server)
        try:
            other.poses.send(encode_robot({}, reset=True))
            end_s = time.monotonic() + WAITS_S
            while not server.rejected:
                assert time.monotonic() < end_s
                robot.hear()
        finally:
            other.close()
        assert [(each.kind, each.first) for each in server.rejected] == [
            ("sender", "a reset of a sender whose poses do not count")
        ]
        assert robot.hear()["post"].fault is not None
        robot.poses.send(encode_robot({}, reset=True))
        robot.hear_fault("arm", "")


def test_of_poses_that_wait_only_the_newest_count(
    rig: CameraRig, skeleton: Skeleton, frame: LiveFrame, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They came while nobody read: what the first of them say is not true any more, and takes no time."""
    waits, looked_at = threading.Event(), []
    take = RobotPoses.take

    def noted(self: RobotPoses, parts: list[Any], came_s: float) -> None:
        waits.wait(WAITS_S)
        looked_at.append(parts[0].bytes)
        take(self, parts, came_s)

    monkeypatch.setattr(RobotPoses, "take", noted)
    with serving(rig, skeleton, now_s=lambda: 1000.1) as (server, robot):
        server.publish(frame)
        for k in range(400):
            away = WORLD_T_ARM.copy()
            away[0, 3] = 400.0 - k
            robot.poses.send(encode_robot({"arm": away}, reset=k == 399))
        waits.set()
        heard = robot.hear_fault("arm", "")
        refused = {each.kind: each.n for each in server.rejected}
    assert heard.expected_m == pytest.approx(1.0, abs=1.0)  # of the last, not one of a metre for each before it
    assert len(looked_at) + refused.get("old", 0) == 400


def test_measuring_that_fails_goes_on(
    rig: CameraRig, skeleton: Skeleton, frame: LiveFrame, monkeypatch: pytest.MonkeyPatch
) -> None:
    measure, fails, told = DistanceMonitor.measure, [True], []

    def failing(monitor: DistanceMonitor, *given: Any) -> Any:
        if fails:
            raise RuntimeError("a defect")
        return measure(monitor, *given)

    monkeypatch.setattr(DistanceMonitor, "measure", failing)
    with serving(rig, skeleton, tell=told.append) as (server, robot):
        server.publish(frame)
        wait_until(lambda: not server.state.is_working)
        assert "a defect" in server.state.last_error
        fails.clear()
        robot.hear()
        wait_until(lambda: server.state.is_working)
    assert told == ["distances cannot be measured: RuntimeError: a defect"]


def test_a_port_that_is_taken_is_named(rig: CameraRig, skeleton: Skeleton) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        for own_port, poses_port in ((port, 0), (0, port)):
            with pytest.raises(OSError, match=f"port {port} of 127.0.0.1 is taken"):
                DistanceServer(CELL, rig, skeleton, port=own_port, poses_port=poses_port)


def test_messages_of_distances_come_back() -> None:
    fault = DistanceFault("the data are 0.61 s old", 1000.25)
    distances = (
        LinkDistance("arm", 0.4, 0.5, 3, "left hand", "left_wrist", math.nan, 0.03, 0.01, 0.5, fault),
        LinkDistance("post", math.inf, math.inf, None, "", "", math.nan, 0.03, 0.0, 1.0, None),
    )
    body = encode_distances(distances, 5, 1000.5)
    assert str(decode_distances(body)) == str(distances)
    document = msgpack.unpackb(body)
    assert document["sequence"] == 5
    assert "no safety function" in document["notice"]
    with pytest.raises(ValueError, match="not a message of fgpose/distances"):
        decode_distances(packed({"format": "fgpose/people"}))
    with pytest.raises(ValueError, match="a damaged message of fgpose/distances: KeyError"):
        decode_distances(packed({"format": "fgpose/distances", "version": 1, "links": [{}]}))


def test_poses_may_be_lists() -> None:
    body = packed({"format": "fgpose/robot", "version": 1, "world_T_link": {"arm": WORLD_T_ARM.tolist()}})
    message = decode_robot(body, ["arm"])
    np.testing.assert_array_equal(message.world_T_link["arm"], WORLD_T_ARM)
    assert not message.reset


@pytest.mark.parametrize(
    ("change", "kind", "reason"),
    [
        ({"version": 2}, "content", "not a message of fgpose/robot, version 1"),
        ({"speed": 1.0}, "content", "unknown field `speed`"),
        ({"world_T_link": [1.0]}, "content", "`object`.*world_T_link"),
        ({"reset": 1}, "content", "`bool`.*reset"),
        ({"world_T_link": {"leg": np.eye(4)}}, "link", "links that the cell does not have: .'leg'.; it has .'arm'."),
        ({"world_T_link": {"arm": np.eye(3)}}, "shape", "link arm: a pose is .4, 4. numbers"),
        ({"world_T_link": {"arm": "here"}}, "content", "got `str`.*world_T_link"),
        ({"world_T_link": {"arm": [[1.0], [2.0, 3.0]]}}, "content", "of length 4, got 1"),
        ({"world_T_link": {"arm": "x" * MAX_ROBOT_BYTES}}, "size", "at most 65536 are possible"),
    ],
)
def test_messages_of_robots_are_refused(change: dict[str, Any], kind: str, reason: str) -> None:
    message = {"format": "fgpose/robot", "version": 1, "world_T_link": {"arm": WORLD_T_ARM}}
    with pytest.raises(MessageError, match=reason) as caught:
        decode_robot(packed(message | change), ["arm"])
    assert caught.value.kind == kind


def test_random_bytes_are_refused() -> None:
    rng = np.random.default_rng(0)
    good = encode_robot({"arm": WORLD_T_ARM}, reset=True)
    n_refused = 0
    for _ in range(2000):
        body = bytearray(good)
        for place in rng.integers(0, len(body), 3):
            body[place] = rng.integers(0, 256)
        try:
            decode_robot(bytes(body), ["arm"])
        except MessageError:
            n_refused += 1
    # Changes of the pose's numbers alone are taken; the rest of the message is about half of it.
    assert n_refused > 500
