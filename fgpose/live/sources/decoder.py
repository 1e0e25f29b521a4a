"""Devices, network streams and video files, opened and decoded by PyAV (FFmpeg)."""

from __future__ import annotations

import errno
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from fgpose.live.sources.address import Kind, without_password
from fgpose.live.sources.decoded import DecodedPicture, sender_s
from fgpose.live.sources.packets import PacketDecoder
from fgpose.live.sources.settings import CameraSource
from fgpose.live.sources.source import SourceError
from fgpose.plain_files import check_plain

if TYPE_CHECKING:
    import av
    from av.container import InputContainer

# Enough to find the size; more of a live stream would only be late.
_PROBE_US = 1_000_000


class Decoder:
    """An opened video. Its first image is decoded at once, so that its size is known and its codec works.

    Raises:
        SourceError: it cannot be opened, nothing comes in time, or it is no video that can be decoded.
        ImportError: PyAV is not installed.
    """

    def __init__(self, name: str, source: str, kind: Kind, settings: CameraSource) -> None:
        self._name, self._timeout_s = name, settings.timeout_s
        self._source = f"/dev/video{source}" if source.isdecimal() else source
        self.sender_minus_stamp_s: float | None = None
        """Unix time by the sender's clock minus the stamp of a frame; None: it has not said."""
        self._container = self._open(kind, settings)
        try:
            self._prepare(is_live=kind != "file" and not self.is_file)
        except BaseException:
            self.close()
            raise

    def _open(self, kind: Kind, settings: CameraSource) -> InputContainer:
        try:
            import av.error
        except ImportError:
            raise ImportError('video sources need PyAV: pip install "fgpose[live]"') from None
        began_s = time.monotonic()
        try:
            if kind == "file":
                check_plain(Path(self._source))
            return av.open(
                self._source,
                format="video4linux2" if kind == "device" else None,
                options=_options(self._source, kind, settings),
                timeout=None if kind == "file" else settings.timeout_s,
            )
        except (av.error.FFmpegError, OSError, ValueError) as error:
            if kind != "file" and time.monotonic() - began_s >= settings.timeout_s:
                # What FFmpeg says of an interrupted handshake depends on the protocol.
                raise self._error(_nothing_came(settings.timeout_s)) from None
            raise self._problem(error) from None

    def _prepare(self, *, is_live: bool) -> None:
        if not self._container.streams.video:
            raise self._error("there is no video in it")
        self._stream = self._container.streams.video[0]
        if self._stream.codec_context is None:
            raise self._error("its codec is not known")
        self._packets = PacketDecoder(self._name, self._stream, is_live=is_live)
        self._frames = self._decoded()
        first = next((frame for frame in self._frames if frame is not None), None)
        if first is None:
            raise self._error("there is no image in it that can be decoded")
        self._first: av.VideoFrame | None = first
        self.size_px = DecodedPicture(first).size_px

    @property
    def is_file(self) -> bool:
        """It has a length, as a file on a server has, and a camera has not."""
        return not self._source.startswith("rtsp") and self._container.duration is not None

    @property
    def format(self) -> str:
        """FFmpeg's name of the container, device or protocol."""
        return self._container.format.name

    @property
    def has_stamps(self) -> bool:
        """FFmpeg makes stamps up for formats without."""
        from av.format import Flags

        return not Flags.no_timestamps.value & self._container.format.flags

    def new_frames(self) -> Iterator[av.VideoFrame | None]:
        """Frames from now on; None where a packet cannot be decoded. Raises SourceError if it cannot go on."""
        return self._frames

    def frames_from_start(self) -> Iterator[av.VideoFrame | None]:
        """All frames of a file; None where a packet cannot be decoded. Raises SourceError if it cannot go on."""
        first, self._first = self._first, None
        if first is None:
            self._container.seek(0)
            self._packets.restart()
            self._frames = self._decoded()
        else:
            yield first
        yield from self._frames

    def duration_s(self, fps: float) -> float:
        """Length of a file, played at this rate or, where that is 0, at its own."""
        if fps and self._stream.frames:
            return self._stream.frames / fps
        if self._stream.duration is not None and self._stream.time_base is not None:
            return float(self._stream.duration * self._stream.time_base)
        return (self._container.duration or 0) / 1e6

    def ended(self) -> SourceError:
        """For a stream that should not end."""
        return self._error("the stream has ended")

    def hurry(self, late_s: float) -> None:
        """See Source. Called between two frames, when the one before is known to be decoded."""
        self._packets.hurry(late_s)

    def close(self) -> None:
        self._container.close()

    def _decoded(self) -> Iterator[av.VideoFrame | None]:
        import av.error

        try:
            for packet in self._container.demux(self._stream):
                of_sender_s = sender_s(packet)
                if of_sender_s is not None and packet.pts is not None:
                    self.sender_minus_stamp_s = of_sender_s - float(packet.pts * packet.time_base)
                try:
                    yield from self._packets.decode(packet)
                except av.error.InvalidDataError:
                    yield None
        except (av.error.FFmpegError, OSError) as error:
            raise self._problem(error) from None

    def _error(self, reason: str) -> SourceError:
        return SourceError(self._name, without_password(self._source), reason)

    def _problem(self, error: Exception) -> SourceError:
        """One error for whatever PyAV raises. Its own messages have the URL with the password."""
        return self._error(_reason(error, self._timeout_s))


def _options(source: str, kind: Kind, settings: CameraSource) -> dict[str, str]:
    """Options of FFmpeg's demuxers."""
    if kind == "device":
        wanted = {
            "video_size": settings.video_size,
            "input_format": settings.pixel_format,
            "framerate": f"{settings.fps:g}" if settings.fps else "",
        }
        return {key: value for key, value in wanted.items() if value}
    options = {"analyzeduration": str(_PROBE_US), "fflags": "nobuffer"}
    if source.startswith("rtsp"):
        return options | {"rtsp_transport": settings.transport}
    return options if kind == "url" else {}


def _nothing_came(timeout_s: float) -> str:
    return f"nothing came for {timeout_s:g} s"


def _reason(error: Exception, timeout_s: float) -> str:
    """What went wrong, in words without the URL."""
    import av.error

    if isinstance(error, av.error.HTTPUnauthorizedError | av.error.HTTPForbiddenError):
        return "the user name or the password is wrong"
    if isinstance(error, av.error.ExitError | TimeoutError):
        return _nothing_came(timeout_s)
    if isinstance(error, av.error.HTTPNotFoundError | FileNotFoundError):
        return "there is no such thing"
    if isinstance(error, ConnectionRefusedError):
        return "nothing answers there"
    if getattr(error, "errno", None) == errno.EBUSY:
        return "another program uses it"
    if getattr(error, "errno", None) == errno.EIO:
        return "it cannot be reached, or the connection broke off"
    if isinstance(error, PermissionError):
        return "this user may not open it"
    if isinstance(error, av.error.InvalidDataError):
        return "not a video, or a damaged or truncated one"
    if isinstance(error, av.error.DecoderNotFoundError | NotImplementedError):
        return "its codec is not known"
    return getattr(error, "strerror", None) or type(error).__name__
