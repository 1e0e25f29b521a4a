"""What takes messages and images in the storm, as the live system does, but for the sockets."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fgpose.geometry.camera import CameraRig
from fgpose.io.live.recordings import RecordedImage
from fgpose.live.cameras.camera import LiveCamera
from fgpose.live.cameras.clock_model import Stamp
from fgpose.live.cameras.image import SourceImage
from fgpose.live.reception.keypoint_checks import KeypointChecks
from fgpose.live.reception.keypoint_messages import encode_keypoints
from fgpose.live.reception.received import recorded_image
from fgpose.live.reception.rejections import MessageError
from fgpose.people_observations import Detections
from fgpose.robot.robot_poses import MAX_LOOKED_AT, RobotPoses
from fgpose.skeleton import Skeleton
from storm_camera import StormCamera
from storm_plan import StormSession
from timeline import Timeline


@dataclass(frozen=True)
class MessagePart:
    """A frame of ZeroMQ, and the connection by which it came."""

    buffer: memoryview
    connection: int

    def get(self, option: Any) -> int:
        return self.connection


class Reception:
    """Everything that takes messages and images, as the live system does, but for the sockets.

    Args:
        session: what is sent.
        rig, skeleton: of the messages.
        timeline: when.
        late_s: of LiveCamera.
        deliver: takes detections with their times.
        rng: of the cameras.
    """

    def __init__(
        self,
        session: StormSession,
        rig: CameraRig,
        skeleton: Skeleton,
        timeline: Timeline,
        late_s: float,
        deliver: Callable[[RecordedImage], None],
        rng: np.random.Generator,
    ) -> None:
        self._rig, self._skeleton, self._clock, self._late_s = rig, skeleton, timeline.clock, late_s
        self._deliver = deliver
        self.cameras = {
            each.name: StormCamera(each, session.sources[each.name], session.start.get(each.name), rng)
            for each in rig.cameras
        }
        self.live: dict[str, LiveCamera] = {}
        for name in rig.names:
            self.begin(name)
        detectors = [name for name, camera in self.cameras.items() if camera.is_detector]
        synchronised = [name for name in detectors if self.cameras[name].source == "synchronised"]
        self._checks = KeypointChecks(rig.subset(detectors), skeleton, {}, synchronised) if detectors else None
        if self._checks is not None:
            self._checks.senders.on_contested = lambda name: self.live[name].contested()
        self.robot = RobotPoses(["arm"])
        self._waiting: list[MessagePart] = []
        self.n_refused = 0

    def begin(self, name: str) -> None:
        """Open a camera, of which nothing is known."""
        self.live[name] = LiveCamera(name, self.cameras[name].settings(), self._clock, self._late_s)
        self.live[name].connected()

    def body(self, found: Detections, stamp_s: float) -> bytes:
        """A message of a detector."""
        size_px = self._rig.cameras[self._rig.names.index(found.camera)].size_px
        name = self._skeleton.name
        return encode_keypoints(found.camera, stamp_s, size_px, name, found.points2d_px, found.confidence)

    def image(self, camera: StormCamera, found: Detections, stamp_s: float) -> None:
        """Has come to this computer."""
        if camera.is_detector:
            self.message(self.body(found, stamp_s), camera.connection)
            return
        stamp = Stamp(stamp_s, is_host_time=camera.source == "device")
        image = self.live[found.camera].receive(SourceImage(stamp=stamp, detections=found))
        if image is not None and image.detections is not None:
            self._deliver(image.recorded(image.detections))

    def message(self, body: bytes, connection: int) -> None:
        """Has come to the socket of keypoints."""
        if self._checks is None:
            return
        try:
            arrived = self._checks.taken([MessagePart(memoryview(body), connection)], self._clock.now_s())
        except MessageError:
            self.n_refused += 1
            return
        image = recorded_image(self.live[arrived.detections.camera], arrived.detections)
        if image is not None:
            self._deliver(image)

    def robot_message(self, body: bytes, connection: int) -> None:
        """Has come to the socket of poses."""
        self._waiting.append(MessagePart(memoryview(body), connection))

    def read_robot(self) -> None:
        """All that waits, as the reading thread does within milliseconds."""
        waiting = deque(self._waiting, maxlen=MAX_LOOKED_AT)
        self._waiting = []
        for part in waiting:
            try:
                self.robot.take([part], self._clock.now_s())
            except MessageError:
                self.n_refused += 1
