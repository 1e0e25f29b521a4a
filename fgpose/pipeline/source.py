"""A recording in memory."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from fgpose.config import Config
from fgpose.estimation.evidence import Evidence, gather
from fgpose.geometry.camera import CameraRig
from fgpose.io.origin import Origin
from fgpose.observations import Observations


@dataclass(frozen=True, eq=False)
class Source:
    """A recording: its cameras and what they saw."""

    rig: CameraRig
    observations: Observations
    origin: Origin | None = field(default=None, repr=False)
    """Where it is from, if that is known."""
    _evidence: dict[Config, Evidence] = field(default_factory=dict, init=False, repr=False)

    def evidence(self, config: Config) -> Evidence:
        """The evidence of the recording: gathered once, whoever asks for it; that of the newest config is kept.

        Raises:
            ValueError: the cameras of observations and rig differ.
        """
        if config not in self._evidence:
            self._evidence.clear()
            self._evidence[config] = gather(self.observations, self.rig, config)
        return self._evidence[config]

    def confident(self, least: float) -> Source:
        """Without the detections of less confidence. Raises ValueError unless it lies in [0, 1]."""
        return replace(self, observations=self.observations.confident(least))

    def first_frames(self, n_frames: int) -> Source:
        """The beginning of the recording."""
        return replace(self, observations=self.observations.frames(slice(0, n_frames)))

    def subset(self, cameras: tuple[str, ...]) -> Source:
        """Some of the cameras, all if none is named. Raises ValueError for an unknown name."""
        if not cameras:
            return self
        return replace(self, rig=self.rig.subset(cameras), observations=self.observations.subset(cameras))
