"""Which messages of keypoints are taken: right by their schema, of the camera's own sender, with a possible stamp."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fgpose.geometry.camera import CameraRig
from fgpose.live.clock import FUTURE_S
from fgpose.live.reception.keypoint_messages import decode_keypoints
from fgpose.live.reception.rejections import MessageError
from fgpose.live.reception.senders import Senders
from fgpose.people_observations import Detections
from fgpose.sampling import is_of_a_camera, other_unit
from fgpose.skeleton import Skeleton

# The stamps of a camera must advance as the clock does, but for the jitter of network and detector.
_MAX_JUMP_S = 1.0
# In milliseconds stamps advance a thousand times as fast; jitter apart.
_RUNS = 100.0


@dataclass(frozen=True, eq=False)
class ArrivedDetections:
    """The detections of an image, at the time that its sender says, and when they arrived (Unix time)."""

    detections: Detections
    arrived_s: float


class KeypointChecks:
    """Remembers the sender and the last stamp of each camera.

    Args:
        rig: the cameras that may send, and their image sizes.
        skeleton: of the joints.
        keys: of cameras whose messages must have one.
        synchronised: cameras whose clock is that of this computer; what is ahead of it is refused.
    """

    def __init__(
        self,
        rig: CameraRig,
        skeleton: Skeleton,
        keys: Mapping[str, str] | None = None,
        synchronised: Collection[str] = (),
    ) -> None:
        self._rig, self._skeleton = rig, skeleton
        self._keys, self._synchronised = dict(keys or {}), frozenset(synchronised)
        self.senders = Senders()
        self._stamps: dict[str, _Stamps] = {}

    def taken(self, parts: Sequence[Any], arrived_s: float) -> ArrivedDetections:
        """A message, as it has come.

        Args:
            parts: frames of ZeroMQ.
            arrived_s: Unix time.

        Raises:
            MessageError: it is refused.
        """
        connection, body = self.senders.body(parts, arrived_s)
        detections = decode_keypoints(body, self._rig, self._skeleton, self._keys)
        self.senders.take(detections.camera, connection, arrived_s)
        if detections.camera in self._synchronised and detections.time_s > arrived_s + FUTURE_S:
            ahead_s = detections.time_s - arrived_s
            raise MessageError("time", f"an image {ahead_s:.2f} s ahead of the clock", detections.camera)
        self._stamps.setdefault(detections.camera, _Stamps()).check(detections, arrived_s)
        return ArrivedDetections(detections, arrived_s)


class _Stamps:
    """Whether the stamps of a camera advance as the clock does.

    A stamp that jumps is refused, unless the next agrees with it: then it was the clock of the camera that was set.
    """

    def __init__(self) -> None:
        self._taken: tuple[float, float] | None = None
        self._refused: tuple[float, float] | None = None
        self._runs = False
        """Whether the stamp of the message before was as far ahead as those in another unit are."""

    def check(self, detections: Detections, arrived_s: float) -> None:
        new = detections.time_s, arrived_s
        if self._taken is None or _follows(self._taken, new) or (self._refused and _follows(self._refused, new)):
            self._taken, self._refused, self._runs = new, None, False
            return
        before = self._refused or self._taken
        step_s, ran = new[0] - before[0], self._runs
        self._runs = not is_of_a_camera(step_s) and step_s > _RUNS * (new[1] - before[1])
        self._refused = new
        if ran and self._runs:
            raise MessageError(
                "unit",
                f"the stamps of its images follow each other by {step_s:.3g} s: no camera films like that. time_s is "
                f"in seconds: are these in {other_unit(step_s)}?",
                detections.camera,
            )
        advance_s, elapsed_s = new[0] - self._taken[0], new[1] - self._taken[1]
        why = ": had the one before waited, or was the clock set?" if advance_s > elapsed_s else ""
        raise MessageError(
            "time",
            f"the stamp of an image is {advance_s:.3f} s after the one before, which came {elapsed_s:.3f} s ago{why}",
            detections.camera,
        )


def _follows(before: tuple[float, float], after: tuple[float, float]) -> bool:
    advance_s, elapsed_s = after[0] - before[0], after[1] - before[1]
    return advance_s > 0 and abs(advance_s - elapsed_s) <= _MAX_JUMP_S
