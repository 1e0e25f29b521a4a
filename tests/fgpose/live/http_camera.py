"""A network camera on this computer: MJPEG or a file over HTTP, with the faults of network cameras."""

from __future__ import annotations

import base64
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import count

import cv2
import numpy as np


class HttpCamera(ThreadingHTTPServer):
    """Serves pictures as MJPEG. What it does can be changed while it runs."""

    daemon_threads = True

    def __init__(self, frames: list[np.ndarray], fps: float = 50.0, port: int = 0) -> None:
        super().__init__(("127.0.0.1", port), _Handler)
        self.set_frames(frames)
        self.fps = fps
        self.password: str | None = None
        """Needed by the user viewer."""
        self.mode = "plays"
        """plays, hangs (nothing more is sent), or hangs up."""
        self.n_connections = 0
        self.closed = threading.Event()

    def set_frames(self, frames: list[np.ndarray]) -> None:
        self.jpegs = [cv2.imencode(".jpg", frame)[1].tobytes() for frame in frames]

    def url(self, user: str = "") -> str:
        return f"http://{user}127.0.0.1:{self.server_address[1]}/video.mjpg"

    def handle_error(self, request: object, client_address: object) -> None:
        """A client that has gone is no error."""


class _Handler(BaseHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        pass

    def do_GET(self) -> None:
        camera = self.server
        assert isinstance(camera, HttpCamera)
        camera.n_connections += 1
        if camera.password is not None:
            wanted = base64.b64encode(f"viewer:{camera.password}".encode()).decode()
            if self.headers.get("Authorization") != f"Basic {wanted}":
                self.send_response(401)
                self.send_header("WWW-Authenticate", 'Basic realm="camera"')
                self.end_headers()
                return
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace;boundary=picture")
        self.end_headers()
        for k in count():
            while camera.mode == "hangs" and not camera.closed.is_set():
                time.sleep(0.01)
            if camera.mode == "hangs up" or camera.closed.is_set():
                return
            jpeg = camera.jpegs[k % len(camera.jpegs)]
            head = f"--picture\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
            self.wfile.write(head.encode() + jpeg + b"\r\n")
            time.sleep(1 / camera.fps)


@contextmanager
def http_camera(frames: list[np.ndarray], fps: float = 50.0, port: int = 0) -> Iterator[HttpCamera]:
    """A camera that is there for a while."""
    with HttpCamera(frames, fps, port) as camera:
        thread = threading.Thread(target=camera.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        try:
            yield camera
        finally:
            camera.closed.set()
            camera.shutdown()
            thread.join()
