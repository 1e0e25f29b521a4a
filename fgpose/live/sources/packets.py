"""From packets of a video to frames, with less work where the computer does not keep up."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Literal

from fgpose.live.sources.frame_dropping import Dropping, Lateness

if TYPE_CHECKING:
    import av
    from av.video.codeccontext import VideoCodecContext
    from av.video.stream import VideoStream

_LOG = logging.getLogger("fgpose.live")
# What FFmpeg leaves out. After any but key frames, the next that can be decoded is a key frame.
_SKIPS: dict[Dropping, Literal["DEFAULT", "NONREF", "NONKEY"]] = {
    Dropping.NONE: "DEFAULT",
    Dropping.SOME: "NONREF",
    Dropping.MOST: "NONKEY",
}


class PacketDecoder:
    """Decodes a stream in one thread and without waiting for frames that are shown earlier: both hold images back.

    When images stay late, frames that no other depends on are skipped, and from the next key frame on the edges of
    blocks are not smoothed any more: of H.264 that saves a fifth of the time and costs about two grey levels. If that
    is not enough, only key frames are decoded until it is in time again.

    Args:
        camera: its name.
        stream: whose packets are decoded.
        is_live: of a camera, which sends frames in the order in which they were taken.
    """

    def __init__(self, camera: str, stream: VideoStream, *, is_live: bool) -> None:
        self._camera, self._stream, self._is_live = camera, stream, is_live
        self._lateness = Lateness()
        self._is_light = False
        self._codec = self._prepared(stream.codec_context)

    def decode(self, packet: av.Packet) -> list[av.VideoFrame]:
        """Raises av.error.InvalidDataError where it cannot be decoded."""
        if self._is_light and packet.is_keyframe and self._codec is self._stream.codec_context:
            self._codec = self._light_codec()
        return self._codec.decode(packet)

    def restart(self) -> None:
        """What follows is from another place in the stream."""
        self._codec.flush_buffers()

    def hurry(self, late_s: float) -> None:
        """See Source."""
        dropping = self._lateness.dropping(late_s)
        if dropping is not Dropping.NONE and not self._is_light:
            self._is_light = True
            _LOG.warning("camera %s: the computer is too slow to decode it with full quality", self._camera)
        self._codec.skip_frame = _SKIPS[dropping]

    def _light_codec(self) -> VideoCodecContext:
        """FFmpeg takes this option only where a codec is opened."""
        import av

        codec = av.CodecContext.create(self._stream.codec_context.name, "r")
        assert isinstance(codec, av.VideoCodecContext)
        codec.extradata = self._stream.codec_context.extradata
        codec.options = {"skip_loop_filter": "all"}
        return self._prepared(codec)

    def _prepared(self, codec: VideoCodecContext) -> VideoCodecContext:
        from av.codec.context import Flags

        codec.thread_count = 1
        if self._is_live:
            codec.flags |= Flags.low_delay
        return codec
