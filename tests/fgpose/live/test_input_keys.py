"""Only those whose keys are known can send, where keys are asked for."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
import zmq
import zmq.auth

from fgpose.geometry.camera import CameraRig
from fgpose.live.reception.input_keys import InputKeys
from fgpose.live.reception.keypoint_socket import KeypointSocket
from fgpose.robot.distance_server import DistanceServer
from fgpose.skeleton import Skeleton
from tests.fgpose.live.output_frames import SKELETON, wait_until
from tests.fgpose.live.test_keypoint_socket import RIG, message
from tests.fgpose.robot.test_distance_server import CELL

WAITS_S = 120.0


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Of the server, with one known client; another one made keys of its own."""
    before = os.umask(0o077)
    try:
        (tmp_path / "clients").mkdir()
        zmq.auth.create_certificates(tmp_path, "server")
        zmq.auth.create_certificates(tmp_path / "clients", "camera")
        zmq.auth.create_certificates(tmp_path, "stranger")
    finally:
        os.umask(before)
    return tmp_path


@pytest.fixture
def receiver(folder: Path) -> Iterator[KeypointSocket]:
    with InputKeys(folder) as who, KeypointSocket(RIG, SKELETON, port=0, who=who, now_s=lambda: 1000.0) as socket:
        yield socket


def connected(address: str, folder: Path, certificate: str | None) -> zmq.Socket[bytes]:
    socket = zmq.Context.instance().socket(zmq.PUSH)
    socket.setsockopt(zmq.LINGER, 0)
    if certificate is not None:
        socket.curve_publickey, secret = zmq.auth.load_certificate(folder / f"{certificate}.key_secret")
        socket.curve_secretkey = secret or b""
        socket.curve_serverkey, _ = zmq.auth.load_certificate(folder / "server.key")
    socket.connect(address)
    return socket


def sent_or_refused(sender: zmq.Socket[bytes], body: bytes) -> None:
    """Whose key was refused may have no connection at the moment: then sending waits for one, for ever at worst."""
    with suppress(zmq.Again):
        sender.send(body, zmq.NOBLOCK)


def test_who_has_a_known_key_may_send(receiver: KeypointSocket, folder: Path) -> None:
    with connected(receiver.address, folder, "clients/camera") as detector:
        detector.send(message())
        assert receiver.receive(WAITS_S) is not None


@pytest.mark.parametrize("certificate", ["stranger", None])
def test_nobody_else_may(receiver: KeypointSocket, folder: Path, certificate: str | None) -> None:
    with (
        connected(receiver.address, folder, certificate) as stranger,
        connected(receiver.address, folder, "clients/camera") as camera,
    ):
        sent_or_refused(stranger, message(5.0))
        end_s = time.monotonic() + WAITS_S
        while "key" not in {each.kind for each in receiver.rejected}:
            assert time.monotonic() < end_s
            assert receiver.receive(0.02) is None
        camera.send(message())
        arrived = receiver.receive(WAITS_S)
        assert arrived is not None
        assert arrived.detections.time_s == 10.0
    assert receiver.n_received == 1


def test_the_robot_needs_one_too(folder: Path, rig: CameraRig, skeleton: Skeleton) -> None:
    with InputKeys(folder) as who:
        server = DistanceServer(CELL, rig, skeleton, port=0, poses_port=0, who=who)
        try:
            robot = connected(server.poses_address, folder, "clients/camera")
            with robot, connected(server.poses_address, folder, None) as stranger:
                sent_or_refused(stranger, b"from a stranger")
                robot.send(b"from the robot")
                wait_until(lambda: server.rejected)
                assert [each.n for each in server.rejected] == [1]
        finally:
            server.close()


def test_what_is_missing_is_named(folder: Path) -> None:
    secret = folder / "server.key_secret"
    secret.chmod(0o644)
    with pytest.raises(ValueError, match="others may read this secret"):
        InputKeys(folder)
    secret.chmod(0o600)
    (folder / "clients" / "camera.key").write_text("metadata\n")
    with pytest.raises(ValueError, match=r"camera.key: no public-key of 40 characters"):
        InputKeys(folder)
    (folder / "clients" / "camera.key").unlink()
    with pytest.raises(ValueError, match="clients: no public keys"):
        InputKeys(folder)
    secret.unlink()
    with pytest.raises(FileNotFoundError, match=r"server\.key_secret"):
        InputKeys(folder)
