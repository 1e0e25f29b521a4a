"""Reading cameras: a thread each, which never ends because of what a source does."""

from __future__ import annotations

import threading
from collections.abc import Callable

from fgpose.live.cameras.camera import LiveCamera
from fgpose.live.cameras.image import Image, SourceImage
from fgpose.live.cameras.mailbox import Mailbox
from fgpose.live.processes.parts import Parts
from fgpose.live.sources import ImageSource, SourceError
from fgpose.live.sources.address import without_password

# Between attempts to open a source again: doubled from the first to the last.
_FIRST_WAIT_S, _LAST_WAIT_S = 0.5, 10.0
# A source that was good for so long begins with the first again.
_WORKS_S = 15.0
# A source gives up after one time-out each for the connection, its description and the first image; a thread that is
# silent for longer hangs.
HANGS = 4.0
_LOOKS_S = 0.2


class CameraReader:
    """Reads every image of a camera's source into its mailbox, and opens the source again whenever it fails.

    Args:
        camera: that takes the images.
        mailbox: where they go then.
        open_source: opens its source anew; SourceError says why it could not.
        first: the source, if it is open already.
        size_px: width and height that its images must have.
        parts: told when its thread has ended.
    """

    def __init__(
        self,
        camera: LiveCamera,
        mailbox: Mailbox[Image],
        open_source: Callable[[], ImageSource],
        size_px: tuple[int, int],
        first: ImageSource | None = None,
        parts: Parts | None = None,
    ) -> None:
        self._parts = parts or Parts(camera.clock.now_s)
        self._camera, self._mailbox, self._open, self._size_px = camera, mailbox, open_source, size_px
        self._clock = camera.clock
        self._first = first
        self._stopped = threading.Event()
        self._ended = False
        self._thread: threading.Thread | None = None
        self._alive_s = self._clock.now_s()

    def start(self) -> None:
        """Begin to read; also takes the place of a thread that hangs, which ends when its read returns."""
        self._alive_s = self._clock.now_s()
        self._thread = threading.Thread(target=self._run, name=f"camera {self._camera.name}", daemon=True)
        self._thread.start()

    def watch(self) -> None:
        """Replace a thread that hangs or has ended, and say what has changed. To be called several times a second."""
        silent_s = self._clock.now_s() - self._alive_s
        is_to_read = not self._ended and not self._stopped.is_set()
        if is_to_read and self._thread is not None and not self._thread.is_alive():
            self._parts.restarted(f"reading {self._camera.name}", "its thread ended")
            self.start()
        elif is_to_read and silent_s > HANGS * self._camera.settings.timeout_s:
            self._camera.failed(f"its source hangs for {silent_s:.0f} s; it is opened anew")
            self.start()
        self._camera.look()

    def stop(self, timeout_s: float = 1.0) -> None:
        """End reading; a read that hangs is left behind."""
        self._stopped.set()
        if self._thread is not None:
            self._thread.join(timeout_s)

    def _run(self) -> None:
        wait_s = _FIRST_WAIT_S
        while self._is_mine():
            began_s = self._clock.now_s()
            try:
                self._read()
            except SourceError as error:
                reason = error.reason
            except Exception as error:
                # Its message may hold anything, a password too.
                reason = f"its source has failed with {type(error).__name__}"
            else:
                return
            if not self._is_mine():
                return
            self._camera.failed(reason)
            wait_s = _FIRST_WAIT_S if self._clock.now_s() - began_s > _WORKS_S else wait_s
            self._alive_s = self._clock.now_s() + wait_s
            self._stopped.wait(wait_s)
            wait_s = min(2 * wait_s, _LAST_WAIT_S)

    def _read(self) -> None:
        """Read until there is nothing more to read. Raises whatever the source raises."""
        first, self._first = self._first, None
        source = first or self._open()
        try:
            self._camera.connected()
            for image in source.images():
                self._alive_s = self._clock.now_s()
                if not self._is_mine():
                    return
                self._check_size(image)
                if self._camera.settings.pace == "fast":
                    self._wait_for_taker()
                received = self._camera.receive(image)
                if received is not None:
                    self._mailbox.put(received)
                    if self._camera.settings.pace == "real time":
                        source.hurry(received.arrived_s - received.captured_s)
        finally:
            source.close()
        self._ended = True
        self._camera.ended("the recording has ended")

    def _check_size(self, image: SourceImage) -> None:
        if image.picture is not None and image.picture.size_px != self._size_px:
            sizes = "{} x {} px instead of {} x {} px".format(*image.picture.size_px, *self._size_px)
            raise SourceError(
                self._camera.name, without_password(self._camera.settings.source), f"its images are now {sizes}"
            )

    def _wait_for_taker(self) -> None:
        """Played as fast as possible, no image is left out."""
        while self._is_mine() and not self._mailbox.wait_until_empty(_LOOKS_S):
            self._alive_s = self._clock.now_s()

    def _is_mine(self) -> bool:
        """Whether this thread is the one that should read."""
        return not self._stopped.is_set() and threading.current_thread() is self._thread
