"""A camera of a live system: its newest image, its clock and its state."""

from __future__ import annotations

import dataclasses
import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fgpose.finding import Code
from fgpose.live.cameras.backlog import Backlog
from fgpose.live.cameras.clock_model import ClockModel, Stamp
from fgpose.live.cameras.frozen_keypoints import REASON, FrozenKeypoints
from fgpose.live.cameras.health import CameraVerdict, Health
from fgpose.live.cameras.image import Image, SourceImage
from fgpose.live.cameras.picture_faults import PictureFaults
from fgpose.live.clock import FUTURE_S, Clock
from fgpose.live.frame import CameraState, CameraStatus
from fgpose.live.sources import CameraSource

_LOG = logging.getLogger("fgpose.live")
_CONNECTING = CameraVerdict(CameraState.RECONNECTING, "connecting")


@dataclass(frozen=True)
class CameraEvent:
    """The state of a camera has changed, or what it is in that state for."""

    time_s: float
    """Unix time."""
    camera: str
    state: CameraState
    reason: str

    def __str__(self) -> str:
        return f"camera {self.camera}: {self.state.value}{': ' if self.reason else ''}{self.reason}"


class LiveCamera:
    """What is known of a camera. Any thread may use it.

    Args:
        name: as in the rig.
        settings: of its source.
        clock: of the live system.
        late_s: an image that arrives this long after it was taken is late; the lag of the estimator.
        on_event: called once for every change of its state, in whatever thread notices it.
    """

    def __init__(
        self,
        name: str,
        settings: CameraSource,
        clock: Clock,
        late_s: float,
        on_event: Callable[[CameraEvent], None] | None = None,
    ) -> None:
        self.name, self.settings, self.clock = name, settings, clock
        self._on_event = on_event
        self._model = ClockModel(settings.latency_s, settings.clock)
        self._backlog = Backlog()
        self._health = Health(settings.fps, late_s if settings.pace == "real time" else np.inf)
        self._picture_faults = PictureFaults()
        self._keypoints = FrozenKeypoints()
        self._lock = threading.Lock()
        self._said = _CONNECTING
        self._n_images = self._n_refused = 0
        self._image_s: float | None = None

    def connected(self) -> None:
        """Its source was opened: stamps may begin anew."""
        with self._lock:
            self._model.restart()
            self._backlog = Backlog()
            self._picture_faults.restart()
            self._keypoints = FrozenKeypoints()
            self._health.connected(self.clock.now_s())

    def failed(self, reason: str) -> None:
        """Its source failed and will be opened again."""
        with self._lock:
            self._health.failed(reason)
        self.look()

    def ended(self, reason: str) -> None:
        """Nothing more will come."""
        with self._lock:
            self._health.ended(reason)
        self.look()

    def contested(self) -> None:
        """A second sender has sent under its name: which of both is right nobody can tell."""
        with self._lock:
            self._health.saw("contested", "two senders send under its name", self.clock.now_s())

    def refused(self, reason: str) -> None:
        """A message that may be its is refused: where no other comes, that is the reason."""
        with self._lock:
            self._health.refused(reason, self.clock.now_s())

    def receive(self, image: SourceImage) -> Image | None:
        """Take an image that has just arrived; it is given back with its time, which is after that of the one before.
        None: it is damaged, or its clock says that it was taken no later than the one before, or is yet to be taken; or
        it may have waited for the connection."""
        arrived_s = self.clock.now_s()
        with self._lock:
            if self._had_waited(image.stamp, arrived_s):
                self._n_images, self._n_refused = self._n_images + 1, self._n_refused + 1
                return None
            n_jumps = self._model.n_jumps
            captured_s = self._model.captured_s(image.stamp, arrived_s)
            time_sigma_s = self._model.time_sigma_s
            picture_faults: dict[str, str] = {}
            if image.picture is not None and not image.is_damaged:
                picture_faults = self._picture_faults.add(image.picture, arrived_s)
            if image.detections is not None and self._keypoints.add(image.detections, arrived_s):
                picture_faults["frozen"] = REASON
            faults = dict(picture_faults)
            if self._model.n_jumps > n_jumps:
                faults["clock"] = f"its clock has jumped by {self._model.jump_s:+.2f} s [{Code.LATE_CAMERA}]"
            # One that is ahead would make those that are right look old, and people new.
            is_ahead = self.settings.pace == "real time" and bool(captured_s > arrived_s + FUTURE_S)
            if is_ahead:
                faults["clock"] = (
                    f"its stamps are {captured_s - arrived_s:.2f} s ahead of the clock [{Code.LATE_CAMERA}]"
                )
            self._health.add(arrived_s, captured_s, faults, is_damaged=image.is_damaged)
            number, self._n_images = self._n_images, self._n_images + 1
            is_again = self._image_s is not None and bool(captured_s <= self._image_s)
            self._n_refused += is_again or is_ahead
            if image.is_damaged or is_again or is_ahead:
                return None
            self._image_s = captured_s
        if image.detections is not None:
            image = dataclasses.replace(image, detections=image.detections.at(captured_s))
        is_trusted = not picture_faults
        return Image(self.name, number, captured_s, arrived_s, image, time_sigma_s, is_trusted=is_trusted)

    def _had_waited(self, stamp: Stamp | None, arrived_s: float) -> bool:
        """Or may have, for all that is known of a new connection."""
        backlog = self._backlog
        if stamp is None or stamp.is_host_time or backlog.is_over:
            return False
        backlog.add(stamp.stamp_s, arrived_s)
        if backlog.waited_s:
            self._health.failed("old images come, which had waited for the connection")
        if backlog.is_over and backlog.waited_s:
            _LOG.info(
                "camera %s: old images had waited, for up to %.1f s: %d are not used",
                self.name,
                backlog.waited_s,
                backlog.n_images,
            )
        return not backlog.is_over

    def status(self, now_s: float) -> CameraStatus:
        """The camera at a time, which is now."""
        with self._lock:
            verdict = self._health.verdict(now_s)
            return CameraStatus(
                name=self.name,
                state=verdict.state,
                reason=verdict.reason,
                image_s=self._image_s,
                rate_hz=self._health.rate_hz(now_s),
                clock_offset_s=self._model.offset_s,
                clock_sigma_s=self._model.sigma_s,
                n_images=self._n_images,
                unproven_s=self._model.unproven_s,
                n_lost=self._n_refused,
            )

    def look(self) -> None:
        """Say it, once, if the state has changed. To be called several times a second."""
        now_s = self.clock.now_s()
        with self._lock:
            self._health.look(now_s)
            verdict, said = self._health.verdict(now_s), self._said
            # Reasons of other faults have numbers that change.
            is_new = verdict.fault != said.fault or (verdict.fault == "failed" and verdict.reason != said.reason)
            if not is_new:
                return
            self._said = verdict
        event = CameraEvent(now_s, self.name, verdict.state, verdict.reason)
        _LOG.log(logging.INFO if verdict.state is CameraState.OK else logging.WARNING, "%s", event)
        if self._on_event is None:
            return
        try:
            self._on_event(event)
        except Exception:
            _LOG.exception("whoever is told of events has failed")
