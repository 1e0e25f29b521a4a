"""Keypoints from detectors elsewhere: what is right arrives, whatever else is sent, and what is wrong is counted."""

from __future__ import annotations

import mmap
import resource
from collections.abc import Iterator
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import zmq

from fgpose.geometry.camera import CameraRig
from fgpose.io.live.packing import packed, unpacked
from fgpose.live.reception import keypoint_checks
from fgpose.live.reception.keypoint_messages import MAX_BODY_BYTES, MAX_PEOPLE, decode_keypoints, encode_keypoints
from fgpose.live.reception.keypoint_socket import KeypointSocket
from fgpose.live.reception.rejections import MessageError
from fgpose_benchmarks.synthetic import ring_rig
from tests.fgpose.live.output_frames import SKELETON, free_port

RIG = ring_rig()
CAMERA = RIG.cameras[1]
RNG = np.random.default_rng(5)
POINTS_PX = RNG.uniform(0, 900, (2, SKELETON.n_joints, 2))
CONFIDENCE = RNG.uniform(0.1, 1.0, (2, SKELETON.n_joints))


def message(stamp_s: float = 10.0, **changes: Any) -> bytes:
    """A sound message, with changes."""
    body = encode_keypoints(CAMERA.name, stamp_s, CAMERA.size_px, SKELETON.name, POINTS_PX, CONFIDENCE)
    document = unpacked(body) | changes
    return packed({key: value for key, value in document.items() if value is not None})


class Clock:
    now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def told() -> list[str]:
    return []


@pytest.fixture
def receiver(clock: Clock, told: list[str]) -> Iterator[KeypointSocket]:
    with KeypointSocket(RIG, SKELETON, port=0, now_s=clock, tell=told.append) as socket:
        yield socket


@pytest.fixture
def detector(receiver: KeypointSocket) -> Iterator[zmq.Socket[bytes]]:
    with zmq.Context.instance().socket(zmq.PUSH) as socket:
        socket.setsockopt(zmq.LINGER, 0)
        socket.connect(receiver.address)
        yield socket


def kinds(receiver: KeypointSocket) -> dict[str, int]:
    return {rejected.kind: rejected.n for rejected in receiver.rejected}


def test_detections_arrive_as_they_were_sent(receiver: KeypointSocket, detector: zmq.Socket[bytes]) -> None:
    detector.send(message())
    arrived = receiver.receive(20.0)
    assert arrived is not None
    seen = arrived.detections
    assert (seen.camera, seen.time_s, arrived.arrived_s, receiver.n_received) == (CAMERA.name, 10.0, 1000.0, 1)
    # Messages have single precision.
    np.testing.assert_allclose(seen.points2d_px, POINTS_PX, rtol=1e-7)
    np.testing.assert_allclose(seen.confidence, CONFIDENCE, rtol=1e-7)
    assert (seen.points3d_m, seen.covariance3d_m2, seen.appearance) == (None, None, None)
    assert receiver.receive(0.0) is None


def test_joints_in_3d_are_taken_from_the_camera_to_the_world() -> None:
    points_m = RNG.normal((0, 0, 4), 1, (2, SKELETON.n_joints, 3))
    root = RNG.normal(size=(2, SKELETON.n_joints, 3, 3))
    covariance_m2 = 0.01 * root @ root.swapaxes(-1, -2) + 0.01 * np.eye(3)
    appearance = RNG.normal(size=(2, 16))
    body = encode_keypoints(
        CAMERA.name,
        3.0,
        CAMERA.size_px,
        SKELETON.name,
        POINTS_PX,
        CONFIDENCE,
        points3d_camera_m=points_m,
        covariance3d_camera_m2=covariance_m2,
        appearance=appearance,
    )
    seen = decode_keypoints(body, RIG, SKELETON)
    assert seen.points3d_m is not None
    assert seen.covariance3d_m2 is not None
    assert seen.appearance is not None
    # Single precision, after a rotation whose terms may cancel.
    np.testing.assert_allclose(CAMERA.to_camera_frame(seen.points3d_m), points_m, atol=1e-5)
    along_ray = points_m / np.linalg.norm(points_m, axis=-1, keepdims=True)
    in_world = along_ray @ CAMERA.world_T_camera[:3, :3].T
    variances = [
        np.einsum("pji,pjik,pjk->pj", ray, matrix, ray)
        for ray, matrix in ((along_ray, covariance_m2), (in_world, seen.covariance3d_m2))
    ]
    np.testing.assert_allclose(*variances, rtol=1e-5)
    np.testing.assert_allclose(seen.appearance, appearance, rtol=1e-7)


def test_an_image_of_nobody_arrives() -> None:
    body = encode_keypoints(
        CAMERA.name, 1.0, CAMERA.size_px, SKELETON.name, np.zeros((0, 4, 2)), np.zeros((0, SKELETON.n_joints))
    )
    assert decode_keypoints(body, RIG, SKELETON).n_people == 0


WRONG = {
    "garbage": (b"\xc1\x00hello", "content", "MessagePack"),
    "empty": (b"", "content", "truncated"),
    "truncated": (message()[:-9], "content", "truncated"),
    "nested": (b"\x91" * 5000, "content", "got `array`"),
    "a number": (packed(3), "content", "fgpose/keypoints"),
    "format": (message(format="fgpose/people"), "content", "fgpose/keypoints"),
    "version": (message(version=2), "content", "version 1"),
    "missing key": (message(confidence=None), "content", "confidence"),
    "unknown key": (message(points3d_m=np.zeros(3)), "content", "points3d_m"),
    "unknown camera": (message(camera="cam_9"), "camera", "cam_9"),
    "camera of another type": (message(camera=[1]), "content", "`str`.*camera"),
    "skeleton": (message(skeleton="coco_17"), "skeleton", "coco_17"),
    "image size": (message(size_px=[640, 480]), "image size", "640"),
    "image size of another type": (message(size_px="large"), "content", "`array`.*size_px"),
    "time": (message(time_s=float("nan")), "time", "nan"),
    "infinite time": (message(time_s=float("inf")), "time", "inf"),
    "time of another type": (message(time_s="now"), "content", "`float`.*time_s"),
    "joints": (message(points2d_px=np.zeros((1, 5, 2))), "shape", r"\(people, 4, 2\), got \(1, 5, 2\)"),
    "a list": (message(points2d_px=[[1.0, 2.0]]), "content", "points2d_px"),
    "confidences": (message(confidence=np.zeros((2, 3))), "shape", r"confidence must be \(2, 4\), got \(2, 3\)"),
    "crowd": (
        message(points2d_px=np.zeros((MAX_PEOPLE + 1, 4, 2)), confidence=np.zeros((MAX_PEOPLE + 1, 4))),
        "shape",
        "at most",
    ),
    "bytes": (message(points2d_px={"shape": [2, 4, 2], "dtype": "<f4", "data": b"123"}), "content", "bytes"),
    "dtype": (message(points2d_px={"shape": [1], "dtype": "|O8", "data": bytes(8)}), "content", "type"),
    "many lengths": (
        message(points2d_px={"shape": [1 << 63] * 10_000, "dtype": "<f4", "data": b""}),
        "content",
        "shape",
    ),
    "an array as the format": (message(format=np.zeros(2)), "content", "`str`.*format"),
    "bytes as a key": (b"\x8b\xc4\x06camera" + message()[1:], "content", "`str`"),
    "text that is none": (message().replace(b"version", b"versio\xff"), "content", "utf-8"),
    "negative": (message(points2d_px={"shape": [-1], "dtype": "<f4", "data": b""}), "content", "shape"),
    "confidence": (message(confidence=np.full((2, 4), 1.5)), "values", r"outside \[0, 1\]"),
    "infinite pixel": (message(points2d_px=np.full((2, 4, 2), np.inf)), "values", "infinite"),
    "millimetres": (message(points3d_camera_m=np.full((2, 4, 3), 4000.0)), "values", "millimetres"),
    "covariance": (
        message(points3d_camera_m=np.ones((2, 4, 3)), covariance3d_camera_m2=np.zeros((2, 4, 3, 3))),
        "values",
        "positive definite",
    ),
    "covariance alone": (message(covariance3d_camera_m2=np.zeros((2, 4, 3, 3))), "content", "without 3D"),
    "appearance": (message(appearance=np.zeros((3, 8))), "shape", "appearance"),
    "large": (message() + bytes(MAX_BODY_BYTES), "size", "bytes"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_message_is_refused_with_its_reason(name: str) -> None:
    body, kind, reason = WRONG[name]
    with pytest.raises(MessageError, match=reason) as caught:
        decode_keypoints(body, RIG, SKELETON)
    assert caught.value.kind == kind
    assert kind != "values" or caught.value.camera == CAMERA.name
    # However much was sent, what is shown of it is short.
    assert len(str(caught.value)) < 500


def test_random_bytes_and_damaged_messages_raise_nothing_else() -> None:
    rng = np.random.default_rng(0)
    sound, n_refused = message(), 0
    for _ in range(2000):
        body = bytearray(sound)
        for place in rng.integers(len(body), size=rng.integers(1, 4)):
            body[place] = rng.integers(256)
        try:
            decode_keypoints(bytes(body), RIG, SKELETON)
        except MessageError:
            n_refused += 1
    assert 200 < n_refused < 2000


def test_wrong_messages_are_counted_and_told_once_per_kind(
    receiver: KeypointSocket, detector: zmq.Socket[bytes], told: list[str]
) -> None:
    for _ in range(3):
        detector.send(WRONG["garbage"][0])
        detector.send(WRONG["unknown camera"][0])
    detector.send_multipart([message(), message()])
    detector.send(message())
    assert receiver.receive(20.0) is not None
    assert kinds(receiver) == {"content": 4, "camera": 3}
    assert len(told) == 2
    assert all(receiver.address in line for line in told)


def test_an_error_that_nobody_has_thought_of_refuses_one_message(
    receiver: KeypointSocket, detector: zmq.Socket[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(keypoint_checks, "decode_keypoints", Mock(side_effect=TypeError("of the library")))
        detector.send(message())
        while not receiver.rejected:
            assert receiver.receive(0.01) is None
    assert [(each.kind, each.first) for each in receiver.rejected] == [("unexpected", "TypeError: of the library")]
    detector.send(message())
    assert receiver.receive(20.0) is not None


def test_a_flood_of_garbage_does_not_keep_the_reader(receiver: KeypointSocket, detector: zmq.Socket[bytes]) -> None:
    for _ in range(200):
        detector.send(b"garbage")
    detector.send(message())
    assert receiver.receive(20.0) is not None
    assert kinds(receiver) == {"content": 200}


@pytest.mark.parametrize(("unit", "words"), [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")])
def test_stamps_in_another_unit_are_named(unit: float, words: str) -> None:
    checks, said = keypoint_checks.KeypointChecks(RIG, SKELETON), []
    arrives_s = 1000.0 + np.cumsum(np.random.default_rng(0).uniform(0.01, 0.06, 30))  # 30 Hz, with jitter
    for number, arrived_s in enumerate(arrives_s.tolist()):
        try:
            checks.taken([zmq.Frame(message(unit * (1000.0 + number / 30)))], arrived_s)
        except MessageError as error:
            said.append((error.kind, error.reason))
    assert [kind for kind, _ in said] == ["time", *["unit"] * 28]
    assert {reason for kind, reason in said if kind == "unit"} == {said[-1][1]}  # no numbers that grow
    assert f"time_s is in seconds: are these in {words}" in said[-1][1]


def test_stamps_that_repeat_or_jump_are_refused_and_a_clock_that_was_set_is_followed(
    receiver: KeypointSocket, detector: zmq.Socket[bytes], clock: Clock
) -> None:
    taken = []
    # The stamp of each message, and when it comes.
    for stamp_s, arrived_s in (
        (10.0, 1000.0),
        (10.1, 1000.1),
        (10.1, 1000.2),  # again
        (10.05, 1000.2),  # backwards
        (10.2, 1000.2),
        (99.0, 1000.3),  # a jump, and back
        (10.4, 1000.4),
        (-50.0, 1000.5),  # a clock that is set
        (-49.9, 1000.6),
        (-49.8, 1000.7),
        (-9.8, 1040.8),  # nothing for a while
    ):
        clock.now_s = arrived_s
        detector.send(message(stamp_s))
        n_before, arrived = sum(kinds(receiver).values()), None
        while arrived is None and sum(kinds(receiver).values()) == n_before:
            arrived = receiver.receive(0.01)
        taken += [] if arrived is None else [arrived.detections.time_s]
    assert taken == [10.0, 10.1, 10.2, 10.4, -49.9, -49.8, -9.8]
    assert kinds(receiver) == {"time": 4}


def test_a_body_of_a_gigabyte_is_not_read(
    receiver: KeypointSocket, detector: zmq.Socket[bytes], told: list[str]
) -> None:
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # Pages of zeros that take no memory here; were they received, they would.
    body = mmap.mmap(-1, 1 << 30, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS, prot=mmap.PROT_READ)
    with zmq.Context.instance().socket(zmq.PUSH) as hostile:
        hostile.setsockopt(zmq.LINGER, 0)
        hostile.setsockopt(zmq.RECONNECT_IVL, -1)
        hostile.connect(receiver.address)
        hostile.send(body, copy=False)
        for _ in range(100):
            assert receiver.receive(0.2) is None
            if kinds(receiver):
                break
    assert kinds(receiver) == {"connection": 1}
    assert "16 MB" in told[0]
    detector.send(message())
    assert receiver.receive(20.0) is not None
    # The largest that is taken from the network are 16 MB; of the rest of the process a margin.
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 200_000


def test_a_publisher_can_be_subscribed_to(clock: Clock) -> None:
    port = free_port()
    with (
        zmq.Context.instance().socket(zmq.PUB) as publisher,
        KeypointSocket(RIG, SKELETON, publisher=f"tcp://127.0.0.1:{port}", now_s=clock) as receiver,
    ):
        # The publisher comes later than who subscribes.
        publisher.bind(f"tcp://127.0.0.1:{port}")
        arrived, stamp_s = None, 0.0
        while arrived is None:
            assert stamp_s < 20
            stamp_s, clock.now_s = stamp_s + 0.01, clock.now_s + 0.01
            publisher.send(message(stamp_s))
            arrived = receiver.receive(0.01)
    assert arrived.detections.camera == CAMERA.name


def test_a_port_that_is_taken_and_a_wrong_address_are_named(receiver: KeypointSocket) -> None:
    port = int(receiver.address.rpartition(":")[2])
    with pytest.raises(OSError, match=f"port {port} of 127.0.0.1 is taken"):
        KeypointSocket(RIG, SKELETON, port=port)
    with pytest.raises(ValueError, match="'nonsense' is no address"):
        KeypointSocket(RIG, SKELETON, publisher="nonsense")


def test_one_camera_alone_can_be_received() -> None:
    rig = CameraRig(RIG.cameras[1:2])
    assert decode_keypoints(message(), rig, SKELETON).camera == CAMERA.name


@pytest.mark.slow
def test_a_second_sender_under_the_name_of_a_camera_is_refused(
    receiver: KeypointSocket, detector: zmq.Socket[bytes], clock: Clock
) -> None:
    """With a stamp ahead of those of the first, which were taken for too old after it."""
    contested: list[str] = []
    receiver.senders.on_contested = contested.append
    detector.send(message(time_s=10.0))
    assert receiver.receive(20.0) is not None
    with zmq.Context.instance().socket(zmq.PUSH) as other:
        other.setsockopt(zmq.LINGER, 0)
        other.connect(receiver.address)
        other.send(message(time_s=10.4))
        clock.now_s += 0.1
        assert receiver.receive(5.0) is None
        assert (kinds(receiver), contested) == ({"sender": 1}, [CAMERA.name])
        detector.send(message(time_s=10.1))
        taken = receiver.receive(20.0)
    assert taken is not None
    assert taken.detections.time_s == 10.1


def test_a_camera_with_a_key_takes_messages_that_have_it() -> None:
    for key, is_taken in (("secret", True), ("Secret", False), ("", False)):
        body = message(key=key)
        if is_taken:
            assert decode_keypoints(body, RIG, SKELETON, {CAMERA.name: "secret"}).camera == CAMERA.name
        else:
            with pytest.raises(MessageError, match="without the key of the rig file") as raised:
                decode_keypoints(body, RIG, SKELETON, {CAMERA.name: "secret"})
            assert raised.value.kind == "key"
            assert "secret" not in str(raised.value)


def test_what_is_ahead_of_a_synchronised_clock_is_refused_and_nothing_after_it(clock: Clock) -> None:
    with (
        KeypointSocket(RIG, SKELETON, port=0, now_s=clock, synchronised=[CAMERA.name]) as receiver,
        zmq.Context.instance().socket(zmq.PUSH) as detector,
    ):
        detector.setsockopt(zmq.LINGER, 0)
        detector.connect(receiver.address)
        for time_s, is_taken in ((999.9, True), (1000.4, False), (999.95, True)):
            detector.send(message(time_s=time_s))
            assert (receiver.receive(20.0 if is_taken else 1.0) is not None) is is_taken
        assert kinds(receiver) == {"time": 1}
