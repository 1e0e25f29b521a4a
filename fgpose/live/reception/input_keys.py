"""Who may send at all: those whose public keys are known, over connections that are encrypted (CURVE of ZeroMQ)."""

from __future__ import annotations

import stat
from pathlib import Path
from typing import Any

from fgpose.live.processes.closing import Closing
from fgpose.live.processes.parts import Parts
from fgpose.live.processes.worker import HANGS_S, Worker
from fgpose.live.reception.zmq_sockets import load_zmq
from fgpose.plain_files import naming, read_settings

_SERVER, _CLIENTS = "server.key_secret", "clients"
_DOMAIN = b"fgpose"
# Where ZeroMQ asks, RFC 27 (ZAP).
_ADDRESS, _VERSION = "inproc://zeromq.zap.01", b"1.0"
_POLL_MS = 100


class InputKeys(Closing):
    """Lets nobody connect to some sockets who has none of the known keys. While its thread is not there, nobody can.

    There is one in a process.

    Args:
        folder: has the key of this side, ``server.key_secret``, and the public keys of all who may send,
            ``clients/*.key``, as pyzmq writes them (zmq.auth.create_certificates).
        parts: told when its thread has ended.

    Raises:
        ValueError: a file has no key or others can read the secret one, or there is no client's; the message names it.
        OSError: a file cannot be read, or there is another one in this process.
        ImportError: pyzmq is not installed.
    """

    def __init__(self, folder: Path, parts: Parts | None = None) -> None:
        zmq = load_zmq()
        secret = _key(folder / _SERVER, "secret-key")
        if stat.S_IMODE((folder / _SERVER).stat().st_mode) & 0o077:
            raise ValueError(f"{folder / _SERVER}: others may read this secret; chmod 600 it")
        self._known = {_key(path, "public-key") for path in sorted((folder / _CLIENTS).glob("[!.]*.key"))}
        if not self._known:
            raise ValueError(f"{folder / _CLIENTS}: no public keys (*.key) of those who may send")
        self.options: dict[Any, int | bytes] = {
            zmq.CURVE_SERVER: 1,
            zmq.CURVE_SECRETKEY: secret,
            zmq.ZAP_DOMAIN: _DOMAIN,
        }
        """Of a socket that only they can connect to."""
        self._socket = zmq.Context.instance().socket(zmq.REP)
        try:
            self._socket.bind(_ADDRESS)
        except zmq.ZMQError as error:
            self._socket.close(linger=0)
            raise OSError(error.errno, f"keys of senders are checked elsewhere in this process: {error}") from None
        self._worker = Worker("checking the keys of senders", self._run, parts, hangs_after_s=HANGS_S)
        self._worker.start()

    def close(self) -> None:
        """From now on nobody can connect. Closing again does nothing."""
        self._worker.close()
        if not self._socket.closed:
            self._socket.unbind(_ADDRESS)  # at once: closing does it at some time
        self._socket.close(linger=0)

    def _run(self) -> None:
        while not self._worker.stopped.is_set():
            if self._socket.poll(_POLL_MS):
                self._socket.send_multipart(self._answer(self._socket.recv_multipart()))

    def _answer(self, asked: list[bytes]) -> list[bytes]:
        """Whether somebody may connect: version, request, domain, address, identity, mechanism, credentials."""
        from zmq.utils import z85

        request, mechanism, credentials = asked[1], asked[5], asked[6:]
        is_known = mechanism == b"CURVE" and {z85.encode(each) for each in credentials} <= self._known
        said = [b"200", b"OK"] if is_known else [b"400", b"unknown key"]
        return [_VERSION, request, *said, b"", b""]


def _key(path: Path, name: str) -> bytes:
    """Of a certificate file, in Z85."""
    with naming(path):
        lines = [line.split("=", 1) for line in read_settings(path).splitlines() if not line.lstrip().startswith("#")]
    keys = [value[1].strip(" \t'\"") for value in lines if value[0].strip() == name and len(value) == 2]
    if len(keys) != 1 or len(keys[0]) != 40 or not keys[0].isascii():
        raise ValueError(f"{path}: no {name} of 40 characters, as zmq.auth.create_certificates writes it")
    return keys[0].encode()
