"""A recording in memory."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from fgpose.association.chosen_person import Chosen
from fgpose.association.successive import Succession
from fgpose.config import Config
from fgpose.diagnosis.diagnose import Diagnosis
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
    chosen: Chosen | None = field(default=None, repr=False)
    """Who it is of how many, where somebody was chosen."""
    succession: Succession | None = field(default=None, repr=False)
    """Who comes after whom, where it was looked whether it is one person throughout."""
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


def with_findings(origin: Origin | None, diagnosis: Diagnosis | None) -> Origin | None:
    """The origin with what was found, if anybody has looked."""
    if origin is None or diagnosis is None:
        return origin
    return replace(origin, findings=diagnosis.findings)
