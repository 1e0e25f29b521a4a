"""Where images come from."""

from __future__ import annotations

from fgpose.live.clock import Clock
from fgpose.live.sources.address import kind_of
from fgpose.live.sources.decoder import Decoder
from fgpose.live.sources.folder import FolderSource
from fgpose.live.sources.playback import Playback
from fgpose.live.sources.settings import CameraSource as CameraSource
from fgpose.live.sources.source import ImageSource as ImageSource
from fgpose.live.sources.source import SourceError as SourceError
from fgpose.live.sources.video import LiveVideo, RecordedVideo


def open_source(name: str, settings: CameraSource, clock: Clock, playback: Playback) -> ImageSource:
    """Open the source of a camera.

    Args:
        name: of the camera, for messages.
        settings: its table in the rig file.
        clock: of the live system.
        playback: start and period that all recordings of the rig share.

    Raises:
        SourceError: it cannot be opened or decoded, nothing comes in time, or settings lack what it needs; the message
            names the camera and the source, without password.
        ImportError: a library is not installed.
        ValueError: it is ``zmq``: no source is opened for such a camera, its messages go to LiveCamera.receive.
    """
    source, kind = settings.source, kind_of(settings.source)
    if kind == "zmq":
        raise ValueError(f"camera {name}: the keypoints of its detector are received, there is nothing to open")
    if kind == "folder":
        if not settings.fps:
            raise SourceError(name, source, "fps is missing; images in a folder do not say it")
        in_real_time = settings.pace == "real time"
        return FolderSource(name, source, settings.fps, playback, in_real_time=in_real_time, loop=settings.loop)
    decoder = Decoder(name, source, kind, settings)
    if kind == "file" or (kind == "url" and decoder.is_file):
        return RecordedVideo(decoder, settings, playback)
    return LiveVideo(decoder, clock)
