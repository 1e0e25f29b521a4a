"""The web server of the status page: a program of its own, which knows nothing of fgpose.

It is started with the number of the socket on which it listens and that of the connection to the live process. It
serves, to any number of clients, the newest content of each path, and asks the live process for a newer one at most
every 0.4 s. So whatever clients do costs the live process no more than one attentive viewer does. It ends with the
live process.
"""

from __future__ import annotations

import ipaddress
import logging
import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterable
from multiprocessing.connection import Connection
from typing import Any

from fgpose.live.processes.priority import session_gives_way

STATIC = "/"
"""The path whose content never gets old."""

_FRESH_S = 0.4
_ANSWER_S = 2.0  # for which a client waits for the live process
_STALE_S = 3.0  # what is older is not shown any more
_ASK_AGAIN_S = 5.0  # if there is no answer
_LIMITS: dict[str, Any] = {
    "threads": 4,
    "connection_limit": 100,
    "channel_timeout": 10,  # s of silence after which a client is dropped
    "cleanup_interval": 5,
    "max_request_header_size": 8192,
    "max_request_body_size": 1024,
}
_HEADERS = [
    ("Cache-Control", "no-store"),
    ("Content-Security-Policy", "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
     "img-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"),
    ("Cross-Origin-Resource-Policy", "same-origin"),
    ("X-Content-Type-Options", "nosniff"),
]  # fmt: skip
_KINDS = {".json": "application/json", ".jpg": "image/jpeg"}


class Contents:
    """The newest content of each path, as the live process sends it: the path, a zero byte, the content."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._bodies: dict[str, bytes] = {}
        self._received_s: dict[str, float] = {}
        self._asked_s: dict[str, float] = {}
        self._changed = threading.Condition()

    def receive(self) -> None:
        """Take what comes until the live process has ended, and end then, or when anything is wrong."""
        try:
            while True:
                path, _, body = self._connection.recv_bytes().partition(b"\0")
                with self._changed:
                    self._bodies[path.decode()] = body
                    self._received_s[path.decode()] = time.monotonic()
                    self._changed.notify_all()
        finally:
            os._exit(0)

    def newest(self, path: str) -> bytes | None:
        """The content of a path, 0.4 s old, or a little more if the live process is slow to answer; empty if there is
        none now, None if there never is one."""
        with self._changed:
            if path not in self._bodies:
                return None
            if path != STATIC and self._age_s(path) > _FRESH_S:
                self._ask(path)
                self._changed.wait_for(lambda: self._age_s(path) < _FRESH_S, _ANSWER_S)
            return self._bodies[path] if path == STATIC or self._age_s(path) < _STALE_S else b""

    def _age_s(self, path: str) -> float:
        return time.monotonic() - self._received_s[path]

    def _ask(self, path: str) -> None:
        now_s, asked_s = time.monotonic(), self._asked_s.get(path, float("-inf"))
        if asked_s <= self._received_s[path] or now_s - asked_s > _ASK_AGAIN_S:
            self._asked_s[path] = now_s
            self._connection.send_bytes(path.encode())


def application(contents: Contents) -> Callable[[dict[str, Any], Callable[..., Any]], Iterable[bytes]]:
    """The WSGI application that serves contents."""

    def answer(environ: dict[str, Any], start_response: Callable[..., Any]) -> Iterable[bytes]:
        status, kind, body = _answer(environ, contents)
        start_response(status, [("Content-Type", kind), ("Content-Length", str(len(body))), *_HEADERS])
        return [] if environ["REQUEST_METHOD"] == "HEAD" else [body]

    return answer


def _answer(environ: dict[str, Any], contents: Contents) -> tuple[str, str, bytes]:
    text = "text/plain; charset=utf-8"
    if environ["REQUEST_METHOD"] not in ("GET", "HEAD"):
        return "405 Method Not Allowed", text, b"only GET and HEAD\n"
    if not _is_ours(environ.get("HTTP_HOST", "")):
        return "421 Misdirected Request", text, b"this host name is not served\n"
    path = environ["PATH_INFO"].encode("latin-1").decode("utf-8", "replace")
    body = contents.newest(path)
    if body is None:
        return "404 Not Found", text, b"there is no such page\n"
    if not body:
        return "503 Service Unavailable", text, b"there is nothing to show yet\n"
    return "200 OK", _KINDS.get(os.path.splitext(path)[1], "text/html; charset=utf-8"), body


def _is_ours(host: str) -> bool:
    """Whether a request was meant for this computer.

    A page elsewhere could let its own name lead here (DNS rebinding) and read the pictures with the browser of somebody
    who may; for numbers and names without a domain it cannot.
    """
    name = host.rpartition(":")[0] if host.rpartition(":")[2].isdigit() else host
    name = name.strip("[]").lower()
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return "." not in name or name.endswith(".local") or name == socket.gethostname().lower()
    return True


def main() -> None:
    from waitress.server import create_server

    listening, connected = map(int, sys.argv[1:])
    # The cameras come first.
    session_gives_way(5)
    logging.getLogger("waitress").setLevel(logging.ERROR)
    contents = Contents(Connection(connected))
    threading.Thread(target=contents.receive, daemon=True).start()
    server = create_server(application(contents), sockets=[socket.socket(fileno=listening)], ident=None, **_LIMITS)
    server.run()


if __name__ == "__main__":
    main()
