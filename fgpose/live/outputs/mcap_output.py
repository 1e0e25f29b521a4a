"""Frames in MCAP files with ROS 2 messages, which Foxglove, rosbags and ``ros2 bag play`` read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

from fgpose.live.frame import LiveFrame
from fgpose.live.outputs import ros_messages
from fgpose.live.outputs.output import BackgroundOutput
from fgpose.live.processes.parts import Parts
from fgpose.plain_files import open_plain

LOST = "fgpose lost"
"""Name of the metadata with ``n_frames``: so many are missing, in this file and those before."""
# What a kill may cost.
_FLUSH_S = 0.5
# A disk may hold the file up for two seconds at 30 Hz.
_MAX_WAITING = 60
# The index of a file is kept in memory, 600 bytes for each time it is flushed.
_MAX_FILE_S = 1800.0


class McapSink:
    """Writes frames, to a new file each half hour: ``NAME.mcap``, ``NAME_1.mcap``, ... No file is ever overwritten.

    Raises:
        FileExistsError: the first file is there already.
        OSError: it cannot be written.
        ImportError: mcap or rosbags is not installed.
    """

    def __init__(self, path: Path, *, may_exist: bool = False) -> None:
        _mcap_writer()
        self._path, self._may_exist = path, may_exist
        self._file: BinaryIO | None = None
        self._n_held = 0
        self._open(path)

    def send(self, frame: LiveFrame) -> None:
        published_s = frame.published_s
        if self._file is None or published_s > self._started_s + _MAX_FILE_S:
            self.close()
            self._may_exist = True
            self._open(self._path)
        self._started_s = min(self._started_s, published_s)
        time_ns = ros_messages.nanoseconds(published_s)
        for topic, body in ros_messages.messages(frame).items():
            self._writer.add_message(self._channels[topic], time_ns, body, time_ns, frame.sequence % (1 << 32))
        if abs(published_s - self._flushed_s) >= _FLUSH_S:
            self._writer.flush()
            self._flushed_s, self._n_held, self._is_empty = published_s, 0, False
        else:
            self._n_held += 1

    @property
    def n_held(self) -> int:
        return self._n_held

    def note_lost(self, n_frames: int) -> None:
        self._writer.add_metadata(LOST, {"n_frames": str(n_frames)})

    def close(self) -> None:
        file, self._file = self._file, None
        if file is None:
            return
        try:
            with file:
                self._writer.finish()
        except BaseException:
            if self._is_empty:
                # On a disk that stays full there would be one after the other.
                Path(file.name).unlink(missing_ok=True)
            raise
        self._n_held = 0

    def _open(self, path: Path) -> None:
        """Open the file, or the next of its name that is not there yet."""
        number = 0
        while self._may_exist and path.exists():
            number += 1
            path = self._path.with_name(f"{self._path.stem}_{number}{self._path.suffix}")
        self._file = path.open("xb")
        self._started_s, self._flushed_s, self._is_empty = float("inf"), float("-inf"), True
        self._writer = _started_writer(self._file)
        self._channels = {}
        for topic, kind in ros_messages.TOPICS.items():
            schema = self._writer.register_schema(kind, "ros2msg", ros_messages.definition(topic).encode())
            self._channels[topic] = self._writer.register_channel(topic, "cdr", schema)


def _mcap_writer() -> Any:
    try:
        from mcap import writer
    except ImportError:
        raise ImportError("MCAP files need mcap: pip install 'fgpose[live]'") from None
    return writer


def _started_writer(file: BinaryIO) -> Any:
    mcap = _mcap_writer()
    writer = mcap.Writer(file)
    writer.start(profile="ros2")
    return writer


def open_mcap_output(
    path: str | Path, *, tell: Callable[[str], None] | None = None, parts: Parts | None = None
) -> BackgroundOutput:
    """Frames in a file as PoseArray on ``/poses``, MarkerArray on ``/markers`` and fgpose_msgs/People on ``/people``.

    Each half hour begins a new file. It is flushed each half second: a kill costs no more. A file whose writer was
    killed, or whose disk was full, lacks its end: see recover_mcap. When there is space again another file is begun,
    with the metadata LOST.

    Args:
        path: of the first file; the folder must exist.
        tell, parts: see BackgroundOutput.

    Raises:
        FileExistsError: the file is there already.
        OSError: it cannot be written.
        ImportError: mcap or rosbags is not installed.
    """
    opened = []

    def open_sink() -> McapSink:
        # After a failure another file is begun; the first must be new.
        sink = McapSink(Path(path), may_exist=bool(opened))
        opened.append(True)
        return sink

    return BackgroundOutput(f"MCAP file {path}", open_sink, n_waiting=_MAX_WAITING, tell=tell, parts=parts)


def recover_mcap(damaged: str | Path, recovered: str | Path) -> int:
    """Copy all that is whole in a file whose writer was killed into one that every program reads.

    Returns:
        How many messages were copied.

    Raises:
        ValueError: the file has no messages, or is no MCAP file; the message names it.
        FileExistsError: the other file is there already.
        OSError: a file cannot be read or written.
        ImportError: mcap is not installed.
    """
    _mcap_writer()
    from mcap.records import Channel, Message, Schema
    from mcap.stream_reader import StreamReader

    n_messages = 0
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    with open_plain(Path(damaged)) as source, Path(recovered).open("xb") as target:
        writer = _started_writer(target)
        try:
            for record in StreamReader(source, validate_crcs=True).records:
                if isinstance(record, Schema):
                    schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
                elif isinstance(record, Channel):
                    schema = schemas[record.schema_id]
                    channels[record.id] = writer.register_channel(
                        record.topic, record.message_encoding, schema, record.metadata
                    )
                elif isinstance(record, Message):
                    channel, times = channels[record.channel_id], (record.log_time, record.publish_time)
                    writer.add_message(channel, times[0], record.data, times[1], record.sequence)
                    n_messages += 1
        # Where the file ends in the middle of a record, mcap raises one of several kinds.
        except Exception as error:
            if not n_messages:
                raise ValueError(f"{damaged}: no messages of an MCAP file: {error}") from None
        writer.finish()
    return n_messages
