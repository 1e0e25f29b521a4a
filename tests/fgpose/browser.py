"""Chromium for the tests of pages."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import signal
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


class Browser:
    """A page in Chromium, driven through its DevTools protocol over a pipe: messages of JSON, each with a zero byte."""

    def __init__(self, url: str, profile: str) -> None:
        assert BROWSER is not None
        (own_requests, self._requests), (self._answers, own_answers) = os.pipe(), os.pipe()
        # Away from 3 and 4, which they become there.
        requests, answers = (fcntl.fcntl(number, fcntl.F_DUPFD, 20) for number in (own_requests, own_answers))
        # --no-sandbox: tests run as root in containers, and the page is our own.
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars"]
        options += ["--remote-debugging-pipe", f"--user-data-dir={profile}", "about:blank"]
        opened = [(os.POSIX_SPAWN_OPEN, number, os.devnull, os.O_WRONLY, 0) for number in (1, 2)]
        pipe = [(os.POSIX_SPAWN_DUP2, requests, 3), (os.POSIX_SPAWN_DUP2, answers, 4)]
        self._process = os.posix_spawn(BROWSER, [BROWSER, *options], os.environ, file_actions=opened + pipe)
        for number in (own_requests, own_answers, requests, answers):
            os.close(number)
        self._read, self._number, self._session = os.fdopen(self._answers, "rb"), 0, ""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        self.call("Emulation.setDeviceMetricsOverride", width=1280, height=1250, deviceScaleFactor=1, mobile=False)
        self.call("Page.navigate", url=url)

    def call(self, method: str, **params: object) -> dict[str, Any]:
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._requests, json.dumps(message).encode() + b"\0")
        while True:
            text = bytearray()  # A picture of a page is megabytes.
            while not text.endswith(b"\0"):
                byte = self._read.read(1)
                assert byte, "the browser has ended"
                text += byte
            answer = json.loads(text[:-1])
            if answer.get("id") == self._number:
                return answer["result"]

    def value(self, expression: str) -> Any:
        return self.call("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")

    def wait_for(self, expression: str) -> None:
        """Until an expression is true. A busy computer takes seconds to show a page."""
        deadline_s = time.monotonic() + 90
        while not self.value(expression):
            assert time.monotonic() < deadline_s, f"never true: {expression}"
            time.sleep(0.2)

    def close(self) -> None:
        os.kill(self._process, signal.SIGTERM)
        os.waitpid(self._process, 0)
        self._read.close()
        os.close(self._requests)


@contextmanager
def browser(url: str) -> Iterator[Browser]:
    """A page, and a profile that is thrown away."""
    folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
    with folder as profile, closing(Browser(url, profile)) as opened:
        yield opened
