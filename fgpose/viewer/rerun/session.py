"""What every recording in Rerun does: a .rrd file, live viewers, or both, and pictures."""

from __future__ import annotations

import os
import socket
import uuid
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float, UInt8

from fgpose.geometry.camera import CameraRig
from fgpose.io.atomic import NotWrittenError, not_written, replacing
from fgpose.skeleton import Skeleton
from fgpose.viewer.pictures import CameraPictures, PictureOptions
from fgpose.viewer.recording import Session
from fgpose.viewer.rerun import paths
from fgpose.viewer.rerun.rows import Rows, TimeKind, set_times
from fgpose.viewer.rerun.rrd_file import RrdFile
from fgpose.viewer.rerun.scene import log_picture_style

_HOST = "127.0.0.1"
_MAX_PORT = 65535  # of TCP
# This many bytes may wait for a slow disk; beyond that, logging waits, so that memory does not fill.
_UNFLUSHED_BYTES = 8e6
_FLUSH_TIMEOUT_S = 10.0  # a disk that takes longer counts as failed
# A viewer that hangs blocks the server for 25 s, until it is dropped.
_LIVE_FLUSH_TIMEOUT_S = 60.0
# Magic bytes of a file, and of its footer with a checksum behind them (Rerun 0.41).
_FILE_START, _FILE_END, _FILE_END_BYTES = b"RRF2", b"RRF2FOOT", 12
_JPEG = "image/jpeg"
INCOMPLETE = "_incomplete"
"""End of the name of an endless recording of which the end is missing."""


@dataclass(frozen=True)
class Target:
    """Where a recording is shown; see open_recording."""

    path: Path | None
    """The file, if there is one."""
    port: int | None
    """Where viewers connect; None: not live."""
    endless: bool
    made_by: str = ""
    """Command of fgpose, which the recording then says."""
    server_mb: float = 256.0
    """Memory for data other than pictures that is kept for viewers who connect late; the oldest frames are dropped
    first."""
    every: int = 1
    """One frame in so many is shown."""


class RerunSession(Session):
    """See Session.

    Args:
        target: where it is shown.
        rig: the cameras.
        skeleton: the joints.
        layout: that it opens with.
        pictures: how large they may be.

    Raises:
        OSError: the file cannot be written, or the port is taken.
    """

    time_kind: ClassVar[TimeKind] = "duration"

    def __init__(
        self, target: Target, rig: CameraRig, skeleton: Skeleton, layout: rrb.Blueprint, pictures: PictureOptions
    ) -> None:
        self._target, self._rig, self._skeleton = target, rig, skeleton
        self._pictures = {camera.name: CameraPictures(camera, pictures, rig.n_cameras) for camera in rig.cameras}
        self._shown: set[str] = set()
        self._unflushed_bytes = 0
        self._replacing = ExitStack()
        self._file: RrdFile | None = None
        self._stream: rr.RecordingStream | None = rr.RecordingStream(
            "fgpose", recording_id=f"made by fgpose {target.made_by} {uuid.uuid4()}" if target.made_by else None
        )
        # Exactly two timelines: frame and time.
        self._stream.set_log_tick_enabled(False)
        self._stream.set_log_time_enabled(False)
        try:
            sinks = self._sinks(target.server_mb + (pictures.image_limit_mb or 0.0))
            with self._naming():
                self._stream.set_sinks(*sinks, default_blueprint=layout)
        except OSError:
            self.discard()
            raise
        finally:
            if self._file is not None:
                self._file.is_opened()
        if target.path is not None:
            thinned = f", one frame in {target.every}" if target.every > 1 else ""
            self._stream.send_recording_name(f"{target.path.stem}{thinned}")

    def _sinks(self, server_mb: float) -> Iterable[rr.FileSink | rr.GrpcServerSink]:
        sinks, target = [], self._target
        if target.port is not None:
            server = rr.GrpcServerSink(_HOST, _free_port(target.port), server_memory_limit=f"{server_mb:.0f}MB")
            self.viewer_url = server.uri
            sinks.append(server)
        if target.path is not None:
            check = partial(_check_whole, with_footer=not target.endless)
            temporary = self._replacing.enter_context(replacing(target.path, check))
            self._file = RrdFile(temporary, with_footer=not target.endless)
            sinks.append(self._file.sink)
        return sinks

    def wants_image(self, camera: str, frame: int) -> bool:
        return self._pictures_of(camera).wants(frame)

    def log_image(self, camera: str, frame: int, time_s: float, image: UInt8[np.ndarray, "height width 3"]) -> None:
        pictures = self._pictures_of(camera)
        pictures.check(frame, image)
        if not pictures.wants(frame):
            return
        if camera not in self._shown:
            log_picture_style(self._open_stream, camera, pictures.scale)
            self._shown.add(camera)
        jpeg = pictures.jpeg(image)
        if pictures.full:
            self.log_no_image(camera, frame, time_s)
        else:
            set_times(self._open_stream, frame, time_s, self.time_kind)
            self._open_stream.log(paths.picture(camera), rr.EncodedImage(contents=jpeg, media_type=_JPEG))
            self._count(len(jpeg))

    def log_no_image(self, camera: str, frame: int, time_s: float) -> None:
        set_times(self._open_stream, frame, time_s, self.time_kind)
        # Rerun 0.41 goes on showing a picture after a Clear.
        self._open_stream.log(paths.picture(camera), rr.EncodedImage.from_fields(clear_unset=True))

    def flush(self) -> None:
        self._flush(self._open_stream)

    def close(self) -> None:
        if self._stream is None:
            return
        stream, self._stream = self._stream, None
        with self._replacing:
            try:
                self._finish(stream)
            except NotWrittenError:
                if self._target.endless:
                    self._keep_incomplete()
                raise
        self.viewer_url = None

    def _keep_incomplete(self) -> None:
        """Hours are worth more than their end."""
        path = self._target.path
        if path is not None and self._file is not None:
            with suppress(OSError, ValueError):
                _check_whole(self._file.path, with_footer=False)
                os.replace(self._file.path, path.with_stem(f"{path.stem}{INCOMPLETE}"))

    def _finish(self, stream: rr.RecordingStream) -> None:
        try:
            self._flush(stream)
        finally:
            stream.disconnect()
        if self._file is not None:
            with self._naming():
                self._file.close(_FLUSH_TIMEOUT_S)

    def discard(self) -> None:
        if self._stream is None:
            return
        stream, self._stream = self._stream, None
        stream.disconnect()
        self.viewer_url = None
        # An exception makes replacing delete its temporary file.
        discarded = RuntimeError("discarded")
        try:
            self._replacing.__exit__(RuntimeError, discarded, None)
        except RuntimeError as error:
            if error is not discarded:
                raise

    @property
    def _open_stream(self) -> rr.RecordingStream:
        if self._stream is None:
            raise ValueError("the recording is closed")
        return self._stream

    def _count(self, n_bytes: int) -> None:
        """Of what has been logged."""
        self._unflushed_bytes += n_bytes
        if self._unflushed_bytes > _UNFLUSHED_BYTES:
            self._flush(self._open_stream)

    def _flush(self, stream: rr.RecordingStream) -> None:
        with self._naming():
            stream.flush(timeout_sec=_FLUSH_TIMEOUT_S if self._target.port is None else _LIVE_FLUSH_TIMEOUT_S)
            if self._file is not None:
                self._file.flush(_FLUSH_TIMEOUT_S)
        self._unflushed_bytes = 0

    @contextmanager
    def _naming(self) -> Iterator[None]:
        """What goes wrong is a NotWrittenError that names the file, or what viewers connect to."""
        try:
            yield
        except (RuntimeError, OSError) as error:
            raise not_written(self._target.path or self.viewer_url, error) from None

    def _send(
        self, rows: Iterable[Rows], time_s: Float[np.ndarray, " frame"], first_frame: int = 0, step: int = 1
    ) -> None:
        frame = first_frame + step * np.arange(len(time_s))
        for of_entity in rows:
            of_entity.send(self._open_stream, frame, time_s, self.time_kind)
            self._count(of_entity.n_bytes)

    def _pictures_of(self, camera: str) -> CameraPictures:
        (known,) = self._rig.subset([camera]).names
        return self._pictures[known]

    def _check_skeleton(self, what: str, skeleton: Skeleton) -> None:
        if skeleton.joints != self._skeleton.joints:
            raise ValueError(
                f"{what} has the joints of skeleton {skeleton.name}, "
                f"the recording was opened with {self._skeleton.name}"
            )


def _check_whole(path: Path, with_footer: bool) -> None:
    """The footer is written when the recording is closed, and Rerun says nothing if that fails."""
    with path.open("rb") as file:
        start = file.read(len(_FILE_START))
        file.seek(-min(_FILE_END_BYTES, path.stat().st_size), os.SEEK_END)
        end = file.read()
    if start != _FILE_START or (with_footer and not end.startswith(_FILE_END)):
        raise ValueError("its beginning or its footer is missing")


def _free_port(port: int) -> int:
    """The port, or a free one for 0. Rerun itself notices a taken port only after the first data."""
    if not 0 <= port <= _MAX_PORT:
        raise ValueError(f"a port is a number from 0 to {_MAX_PORT}, got {port}")
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((_HOST, port))
        except OSError as error:
            raise OSError(f"cannot serve viewers on {_HOST}:{port}: {error.strerror}; choose another port") from None
        return probe.getsockname()[1]
