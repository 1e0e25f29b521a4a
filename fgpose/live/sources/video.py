"""Videos as sources: of a device or a network camera, or recorded ones that are played."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

from fgpose.live.cameras.clock_model import Stamp
from fgpose.live.cameras.image import Picture, SourceImage
from fgpose.live.clock import Clock
from fgpose.live.sources.decoded import DecodedPicture
from fgpose.live.sources.decoder import Decoder
from fgpose.live.sources.playback import Playback
from fgpose.live.sources.settings import CameraSource

if TYPE_CHECKING:
    import av

# Stamps of a driver are read this soon; what is further away is of another clock than the monotonic one.
_DRIVER_S = 10.0


class LiveVideo:
    """A device or a network stream."""

    is_recording = False

    def __init__(self, decoder: Decoder, clock: Clock) -> None:
        self._decoder, self._clock = decoder, clock
        self.size_px = decoder.size_px

    def images(self) -> Iterator[SourceImage]:
        for frame in self._decoder.new_frames():
            if frame is None:
                yield SourceImage(is_damaged=True)
            else:
                yield SourceImage(DecodedPicture(frame), self._stamp(frame), is_damaged=frame.is_corrupt)
        raise self._decoder.ended()

    def hurry(self, late_s: float) -> None:
        self._decoder.hurry(late_s)

    def close(self) -> None:
        self._decoder.close()

    def _stamp(self, frame: av.VideoFrame) -> Stamp | None:
        if not self._decoder.has_stamps or frame.pts is None:
            return None
        stamp_s = float(frame.time)
        if self._decoder.format.startswith("video4linux2") and abs(time.monotonic() - stamp_s) < _DRIVER_S:
            return Stamp(stamp_s + self._clock.unix_minus_monotonic_s, is_host_time=True)
        of_sender_s = self._decoder.sender_minus_stamp_s
        return Stamp(stamp_s, None if of_sender_s is None else stamp_s + of_sender_s)


class RecordedVideo:
    """A video file, also one on a server."""

    is_recording = True

    def __init__(self, decoder: Decoder, settings: CameraSource, playback: Playback) -> None:
        self._decoder, self._settings, self._playback = decoder, settings, playback
        self.size_px = decoder.size_px
        playback.join(decoder.duration_s(settings.fps))

    def images(self) -> Iterator[SourceImage]:
        in_real_time = self._settings.pace == "real time"
        return self._playback.play(self._frames, in_real_time=in_real_time, loop=self._settings.loop)

    def hurry(self, late_s: float) -> None:
        self._decoder.hurry(late_s)

    def close(self) -> None:
        self._decoder.close()

    def _frames(self) -> Iterator[tuple[float, Picture | None]]:
        """Seconds since the first image, and the picture."""
        first_s: float | None = None
        since_s = 0.0
        for k, frame in enumerate(self._decoder.frames_from_start()):
            if self._settings.fps:
                since_s = k / self._settings.fps
            elif frame is not None and frame.pts is not None:
                first_s = frame.time if first_s is None else first_s
                since_s = frame.time - first_s
            yield since_s, None if frame is None or frame.is_corrupt else DecodedPicture(frame)
