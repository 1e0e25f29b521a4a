"""An RTSP server that plays H.264 files as cameras that have run all along, again and again and in step.

A program of its own for the Python of the system, which has GStreamer's bindings; nothing of fgpose is imported.

    python3 rtsp_program.py FILE... prints its port; the address of cam01.mp4 is rtsp://127.0.0.1:PORT/cam01
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import gi

gi.require_version("Gst", "1.0")
gi.require_version("GstRtspServer", "1.0")
from gi.repository import GLib, Gst, GstRtspServer  # noqa: E402

_UNITS = "video/x-h264,stream-format=byte-stream,alignment=au"
_LOOKS_MS = 2


class PlayedVideo:
    """Sends the encoded images of a file to whoever watches, each when it is due."""

    def __init__(self, path: Path) -> None:
        self.name = path.stem
        self._images, self._interval_s = _encoded_images(path)
        self._n_sent = 0
        self._source = None

    def factory(self) -> GstRtspServer.RTSPMediaFactory:
        """Makes what is sent; all who watch get the same."""
        factory = GstRtspServer.RTSPMediaFactory.new()
        factory.set_shared(True)
        source = f"appsrc name=source is-live=true format=time caps={_UNITS}"
        factory.set_launch(f"( {source} ! rtph264pay name=pay0 pt=96 )")
        factory.connect("media-configure", self._begin)
        return factory

    def send_until(self, now_s: float, start_s: float) -> None:
        """Send what is due, by the monotonic clock, which is that of GStreamer too."""
        n_due, source = int((now_s - start_s) / self._interval_s), self._source
        began_ns = 0 if source is None else source.get_base_time()
        while self._n_sent < n_due:
            image = Gst.Buffer.new_wrapped(self._images[self._n_sent % len(self._images)])
            self._n_sent += 1
            # Stamped when it is due, as a camera does, however late this busy computer sends it. What was due before
            # whoever watches came, nobody sees.
            image.pts = max(int(1e9 * (start_s + self._n_sent * self._interval_s)) - began_ns, 0)
            if source is not None and began_ns and image.pts:
                source.emit("push-buffer", image)

    def _begin(self, _: GstRtspServer.RTSPMediaFactory, media: GstRtspServer.RTSPMedia) -> None:
        self._source = media.get_element().get_by_name_recurse_up("source")


def _encoded_images(path: Path) -> tuple[list[bytes], float]:
    """Of a file, and the seconds from one to the next."""
    pipeline = Gst.parse_launch(
        f"filesrc name=file ! qtdemux ! h264parse config-interval=-1 ! {_UNITS} ! appsink name=sink sync=false"
    )
    pipeline.get_by_name("file").set_property("location", str(path))
    sink = pipeline.get_by_name("sink")
    pipeline.set_state(Gst.State.PLAYING)
    images, duration_ns = [], 0
    while (sample := sink.emit("pull-sample")) is not None:
        buffer = sample.get_buffer()
        images.append(buffer.extract_dup(0, buffer.get_size()))
        duration_ns += buffer.duration
    pipeline.set_state(Gst.State.NULL)
    return images, 1e-9 * duration_ns / len(images)


def main(*paths: str) -> None:
    """Serve until the process is ended."""
    Gst.init(None)
    cameras = [PlayedVideo(Path(path)) for path in paths]
    server = GstRtspServer.RTSPServer.new()
    server.set_address("127.0.0.1")
    server.set_service("0")
    for camera in cameras:
        server.get_mount_points().add_factory(f"/{camera.name}", camera.factory())
    server.attach(None)
    start_s = time.monotonic()

    def send() -> bool:
        for camera in cameras:
            camera.send_until(time.monotonic(), start_s)
        return True

    GLib.timeout_add(_LOOKS_MS, send)
    sys.stdout.write(f"{server.get_bound_port()}\n")
    sys.stdout.flush()
    GLib.MainLoop().run()


main(*sys.argv[1:])
