"""A small page in the browser that says how a live system is doing: cameras, people from above, delays, faults.

    with StatusPage(rig, skeleton, port=8099) as page:
        print(page.url)
        page.publish(frame)  # an output like the others
        page.show_image("cam01", image_rgb, time_s)

A program of its own serves it (page_server), which asks for what its clients want to see, each thing at most every
0.4 s. While nobody looks nothing is encoded; and whatever clients do, they cannot ask for more.
"""

from __future__ import annotations

import importlib.util
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from fgpose.child_process import StoppedTwice, is_stopped
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.up_axis import UpAxis
from fgpose.live.frame import LiveFrame
from fgpose.live.link_distance import LinkDistance
from fgpose.live.page.page_server import STATIC
from fgpose.live.page.page_state import PageState
from fgpose.live.pictures_with_people import PicturesWithPeople, PictureWithPeople, small_picture
from fgpose.live.processes.closing import Closing
from fgpose.live.processes.parts import Parts
from fgpose.live.processes.worker import PartEndedError, Worker
from fgpose.overlay.drawing import Drawing, Pose
from fgpose.skeleton import Skeleton

_STATE = "/state.json"
_JPEG_QUALITY = 70
_ENDS_WITHIN_S = 2.0
# Whether the server is stopped is looked at so often.
_LOOKS_S = 0.2


class StatusPage(Closing):
    """The page, served until it is closed.

    Args:
        rig: the cameras.
        skeleton: of the people in the frames.
        port: on which it is served; 0 takes a free one.
        host: the address of this computer on which it is served; "0.0.0.0" lets everybody in the network look at the
            pictures. There is no password.
        up: the axis of the world that points up.
        now_s: the clock, Unix time: of a recording that is run again, that of the recording.
        faults: of inputs and outputs by name, empty where there is none; asked whenever somebody looks.
        parts: told when the server or the thread that feeds it has ended.
        replay: the name of the recording that is run again, which the page then says; empty if this is live.

    Raises:
        ImportError: waitress is not installed.
        OSError: the port is taken, or the host is not an address of this computer; the message names them.
    """

    def __init__(
        self,
        rig: CameraRig,
        skeleton: Skeleton,
        port: int = 8099,
        host: str = "127.0.0.1",
        *,
        up: UpAxis = "+z",
        now_s: Callable[[], float] = time.time,
        faults: Callable[[], Mapping[str, str]] = dict,
        parts: Parts | None = None,
        replay: str = "",
    ) -> None:
        if importlib.util.find_spec("waitress") is None:
            raise ImportError('the status page needs waitress: pip install "fgpose[live]"')
        self._now_s, self._faults = now_s, faults
        self._state = PageState(rig, skeleton, up, replay)
        self._cameras = {camera.name: camera for camera in rig.cameras}
        self._pictures = PicturesWithPeople(rig)
        self._drawing = Drawing(skeleton, ellipses=False, numbers=True)
        self._html = resources.files("fgpose.live.page").joinpath("page.html").read_bytes()
        self._listening = _listen(host, port)
        self._address = host, int(self._listening.getsockname()[1])
        self._process, self._connection = self._start()
        self._worker = Worker("the status page", self._serve, parts)
        self._worker.start()

    @property
    def url(self) -> str:
        """Where a browser of this computer finds the page."""
        host, port = self._address
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
        return f"http://{f'[{host}]' if ':' in host else host}:{port}/"

    def publish(self, frame: LiveFrame) -> None:
        """Show a frame, from now on. Never blocks."""
        self._state.add(frame)
        self._pictures.add_frame(frame)

    def show_image(self, camera: str, image_rgb: np.ndarray, time_s: float = np.nan) -> None:
        """Show a picture of a camera, with the people in it as soon as they are known. Never blocks.

        Args:
            camera: its name in the rig.
            image_rgb: (height, width, 3) bytes RGB, as the camera took it but for its scale. It is kept, not copied: do
                not change it afterwards.
            time_s: when it was taken, Unix time; NaN: nobody knows, and nobody is drawn.

        Raises:
            ValueError: the camera is unknown, or this is no picture.
        """
        if camera not in self._cameras:
            raise ValueError(f"no camera {camera}; the rig has {', '.join(self._cameras)}")
        if image_rgb.dtype != np.uint8 or image_rgb.ndim != 3 or image_rgb.shape[2] != 3 or not image_rgb.size:
            raise ValueError(f"camera {camera}: a picture is (height, width, 3) of bytes, got {image_rgb.shape}")
        self._pictures.add_picture(camera, image_rgb, time_s)

    def show_distances(self, distances: Sequence[LinkDistance]) -> None:
        """Show the distances of people from the links of a robot."""
        self._state.set_distances(distances)

    def note(self, text: str, *, is_fault: bool = False) -> None:
        """Show that something has happened, now."""
        self._state.note(self._now_s(), text, is_fault=is_fault)

    def close(self) -> None:
        """End the server. Closing again does nothing."""
        self._worker.stopped.set()
        self._process.terminate()
        self._worker.close(_ENDS_WITHIN_S)
        # It is stopped, or another one has just been started.
        while self._worker.is_alive:
            self._process.kill()
            self._worker.close(0.1)
        self._listening.close()

    def _start(self) -> tuple[subprocess.Popen[bytes], Connection]:
        own, other = socket.socketpair()
        numbers = self._listening.fileno(), other.fileno()
        # -P: beside the program lie modules whose names may be those of the standard library.
        command = [sys.executable, "-P", str(Path(__file__).with_name("page_server.py")), *map(str, numbers)]
        with other:
            # Ctrl-C is for this process: the page is there until it is closed, and ends with its connection.
            process = subprocess.Popen(command, pass_fds=numbers, stdin=subprocess.DEVNULL, start_new_session=True)
        return process, Connection(own.detach())

    def _serve(self) -> None:
        """Answer the server until it is closed or has ended; begun again, with another one."""
        if self._connection.closed:
            self._process, self._connection = self._start()
        try:
            self._answer(self._connection)
        except (EOFError, OSError):
            if not self._worker.stopped.is_set():
                raise PartEndedError(f"its server ended with status {self._ended()}") from None
        finally:
            # The server ends when the connection does.
            self._connection.close()
            self._ended()

    def _ended(self) -> int:
        """The status with which the server has ended, if need be because it is killed."""
        try:
            return self._process.wait(_ENDS_WITHIN_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()

    def _answer(self, connection: Connection) -> None:
        """First which paths there are, then the newest content of those that are asked for."""
        _send(connection, STATIC, self._html)
        for path in (_STATE, *map(_picture_path, self._cameras)):
            _send(connection, path, b"")
        looks = StoppedTwice()
        while True:
            if connection.poll(_LOOKS_S):
                path = connection.recv_bytes().decode()
                _send(connection, path, self._content(path))
            if looks.again(is_stopped(self._process.pid)):
                self._process.kill()

    def _content(self, path: str) -> bytes:
        if path == _STATE:
            return self._state.to_json(self._now_s(), self._pictures.cameras, self._faults())
        camera = next(camera for name, camera in self._cameras.items() if _picture_path(name) == path)
        picture = self._pictures.newest(camera.name)
        return b"" if picture is None else drawn_jpeg(picture, camera, self._drawing)


def _send(connection: Connection, path: str, body: bytes) -> None:
    connection.send_bytes(path.encode() + b"\0" + body)


def _picture_path(camera: str) -> str:
    return f"/camera/{camera}.jpg"


def drawn_jpeg(picture: PictureWithPeople, camera: Camera, drawing: Drawing) -> bytes:
    """A JPEG of a picture, at most 480 pixels wide and high, with its people."""
    import cv2

    small = small_picture(picture.image_rgb)
    for person in picture.people:
        pose = Pose(person.person, person.positions_m, person.status, None)
        drawing.add(small, camera, pose, small.shape[1] / camera.size_px[0])
    bgr = cv2.cvtColor(small, cv2.COLOR_RGB2BGR)
    return cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()


def _listen(host: str, port: int) -> socket.socket:
    if not 0 <= port <= 65535:
        raise OSError(f"the status page cannot be served on port {port}: ports are 0 to 65535")
    try:
        return socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except OSError as error:
        why = error.strerror or str(error)
        raise OSError(error.errno, f"the status page cannot be served on port {port} of {host}: {why}") from None
