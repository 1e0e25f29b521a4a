"""What a live system is fed with: detections as they come, and how the cameras are."""

from __future__ import annotations

from collections.abc import Collection
from typing import Protocol, runtime_checkable

from fgpose.io.live.recordings import RecordedImage
from fgpose.live.frame import CameraStatus


@runtime_checkable
class Feed(Protocol):
    """Cameras whose detections come by themselves, whatever happens to a camera."""

    def take(self, timeout_s: float) -> list[RecordedImage]:
        """Detections that have come and nobody has taken, in the order in which their images were taken. If there are
        none it waits for some, but not longer than this."""
        ...

    def go_on(self, camera_names: Collection[str]) -> None:
        """What came of these cameras is about to be used, or lost: whoever looks at their images may look at the
        next."""
        ...

    def statuses(self) -> tuple[CameraStatus, ...]:
        """Of all cameras now, in the order of the rig. Images that were used are not counted here."""
        ...
