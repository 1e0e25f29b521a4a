"""Frames over ZeroMQ, with real sockets of this computer."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest
import zmq

from fgpose.live.frame import CameraState, CameraStatus, LiveFrame
from fgpose.live.outputs import open_zmq_output
from fgpose.live.outputs.frame_messages import decode_frame
from fgpose.live.outputs.output import BackgroundOutput
from fgpose.live.outputs.zmq_output import ZmqSink
from tests.fgpose.live.output_frames import SKELETON, assert_same_frame, frame, free_port

# Enough for a loaded computer; what is not there by then does not come.
TIMEOUT_MS = 120_000


@contextmanager
def published() -> Iterator[tuple[BackgroundOutput, int]]:
    port = free_port()
    output = open_zmq_output(port)
    try:
        yield output, port
    finally:
        output.close()


@contextmanager
def consumer(port: int, *, newest_only: bool = True) -> Iterator[zmq.Socket[bytes]]:
    with zmq.Context.instance().socket(zmq.SUB) as subscriber:
        subscriber.setsockopt(zmq.CONFLATE, newest_only)
        subscriber.setsockopt(zmq.RCVTIMEO, TIMEOUT_MS)
        subscriber.setsockopt(zmq.LINGER, 0)
        subscriber.subscribe(b"")
        subscriber.connect(f"tcp://127.0.0.1:{port}")
        yield subscriber


def publish_until_received(output: BackgroundOutput, subscribers: list[zmq.Socket[bytes]], first: int = 0) -> int:
    """Publish until all have had a frame: who has just connected gets the next one. Returns the next number."""
    sequence, waiting = first, list(subscribers)
    while waiting:
        output.publish(frame(sequence))
        sequence += 1
        waiting = [each for each in waiting if not each.poll(10)]
        assert sequence < first + 2000
    return sequence


def received(subscriber: zmq.Socket[bytes]) -> LiveFrame:
    return decode_frame(subscriber.recv(), SKELETON)


def test_every_consumer_gets_the_frame_also_one_that_comes_late() -> None:
    with published() as (output, port), consumer(port) as early, consumer(port) as other:
        sequence = publish_until_received(output, [early, other])
        with consumer(port) as late:
            publish_until_received(output, [late], sequence)
            for subscriber in (early, other, late):
                got = received(subscriber)
                assert_same_frame(got, frame(got.sequence))


def test_a_frame_of_nobody_says_so() -> None:
    with published() as (output, port), consumer(port) as subscriber:
        while not subscriber.poll(10):
            output.publish(frame(5, people=()))
        got = received(subscriber)
    assert (got.people, got.observed_share, got.sequence) == ((), 0.75, 5)
    assert [camera.state.value for camera in got.cameras] == ["ok", "lost"]


def last_received(subscriber: zmq.Socket[bytes], last: int) -> int:
    """Receive until the last frame has come; how many frames that were."""
    numbers = [received(subscriber).sequence]
    while numbers[-1] != last:
        numbers.append(received(subscriber).sequence)
    return len(numbers)


def test_a_consumer_that_is_slow_gets_the_newest_frame() -> None:
    sink = ZmqSink("127.0.0.1", port := free_port())
    with consumer(port) as slow:
        while not slow.poll(10):
            sink.send(frame(0))
        for n in range(1, 501):
            sink.send(frame(n))
        # It has not read since. What came last is there, and hardly anything that came before.
        assert last_received(slow, 500) < 10
    sink.close()


def test_a_consumer_that_never_reads_and_one_that_dies_cost_nothing() -> None:
    sink = ZmqSink("127.0.0.1", port := free_port())
    # A ZeroMQ peer by hand, which subscribes to everything and then reads nothing any more.
    with consumer(port) as alive, socket.create_connection(("127.0.0.1", port)) as stuck:
        stuck.sendall(_GREETING + _READY_SUB + _SUBSCRIBE)
        with consumer(port) as dying:
            while not (alive.poll(10) and dying.poll(10)):
                sink.send(frame(0))
        # 20 MB: more than the buffers of the operating system take for the one that does not read.
        long = replace(frame(1), cameras=(CameraStatus("cam_1", CameraState.LOST, 100_000 * "x"),))
        for n in range(1, 201):
            sink.send(replace(long, sequence=n))
        assert last_received(alive, 200) >= 1
    sink.close()


def test_a_port_that_is_taken_is_named() -> None:
    with published() as (_, port), pytest.raises(OSError, match=f"port {port} of 127.0.0.1 is taken"):
        open_zmq_output(port)


def test_only_this_computer_is_served_by_default() -> None:
    with published() as (_, port):
        others = [info[4][0] for info in socket.getaddrinfo(socket.gethostname(), port, socket.AF_INET)]
        for address in {str(address) for address in others} - {"127.0.0.1", "127.0.1.1"}:
            with pytest.raises(ConnectionRefusedError):
                socket.create_connection((address, port), 5).close()


def test_garbage_from_a_client_stops_nothing() -> None:
    with published() as (output, port):
        for garbage in (b"GET / HTTP/1.1\r\n\r\n", b"\xff" * 4096, _GREETING + _READY_SUB + _HUGE_HEAD + b"x" * 4096):
            with socket.create_connection(("127.0.0.1", port)) as client:
                client.sendall(garbage)
        with consumer(port) as subscriber:
            publish_until_received(output, [subscriber])
            assert received(subscriber).people
        assert output.state.is_working


_GREETING = b"\xff" + bytes(8) + b"\x7f\x03\x00" + b"NULL".ljust(20, b"\0") + bytes(32)


def _command(name: bytes, body: bytes) -> bytes:
    content = bytes([len(name)]) + name + body
    return b"\x04" + bytes([len(content)]) + content


_READY_SUB = _command(b"READY", b"\x0bSocket-Type" + struct.pack(">I", 3) + b"SUB")
_SUBSCRIBE = b"\x00\x01\x01"
_HUGE_HEAD = b"\x02" + struct.pack(">Q", 1 << 30)
