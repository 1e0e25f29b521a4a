"""A recording of a live system, read back: the same detections in the same order, and what was published."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fgpose.config import Config
from fgpose.geometry.camera import CameraRig
from fgpose.io.calibration import load_rig
from fgpose.io.keypoints import load_people
from fgpose.io.live.recordings import LiveRecordingFile, RecordedImage
from fgpose.live.frame import LiveFrame
from fgpose.live.outputs.frame_messages import frame_of_document
from fgpose.people_observations import PeopleObservations
from fgpose.plain_files import naming
from fgpose.skeleton import Skeleton


class LiveRecording:
    """The recording of a live system.

    Raises:
        ValueError: the file is no such recording, or its first record is damaged; the message names it.
        OSError: it cannot be read.
        ImportError: MessagePack is not installed.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._file = LiveRecordingFile(path)
        self.rig: CameraRig = load_rig(path)
        self.skeleton: Skeleton = self._file.start.skeleton
        self.config: Config = self._file.start.config
        self.started_s: float = self._file.start.started_s
        """Unix time."""

    def observations(self) -> PeopleObservations:
        """All that was detected, also what was not used for the live estimate; times count from started_s.

        Raises:
            ValueError: the file is damaged other than by being cut off, or there is no image; the message names it.

        Warns:
            UserWarning: the recording was not closed, was cut off, or lacks records.
        """
        return load_people(self.path, self.rig, self.skeleton)

    def updates(self) -> Iterator[list[RecordedImage]]:
        """Images as they were recorded together, in their order. To run the tracker again as it ran, give it those
        that are used::

            for images in recording.updates():
                tracker.update([image.detections for image in images if image.is_used])
                tracker.tidy()

        Errors and warnings as of observations.
        """
        return self._file.updates()

    def steps(self) -> Iterator[list[RecordedImage] | LiveFrame]:
        """What updates and frames give, in the order in which it was recorded. Errors and warnings as of
        observations."""
        for document in self._file:
            if document.get("kind") == "images":
                yield self._file.images(document)
            elif document.get("kind") == "frame":
                yield self._frame(document)

    def frames(self) -> Iterator[LiveFrame]:
        """What was published; positions are rounded to single precision. Errors and warnings as of observations."""
        for document in self._file:
            if document.get("kind") == "frame":
                yield self._frame(document)

    def _frame(self, document: dict[str, Any]) -> LiveFrame:
        with naming(self.path):
            return frame_of_document(document, self.skeleton)


def load_live_recording(path: str | Path) -> LiveRecording:
    """Open the recording of a live system; what is read, and what is raised, see LiveRecording."""
    return LiveRecording(path)
