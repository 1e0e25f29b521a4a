"""A recording at work: where its files are, whichever steps have been done."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

from fgpose.io.calibration import load_rig
from fgpose.io.keypoints.stated_skeleton import stated_skeleton
from fgpose.io.skeletons import load_skeleton
from fgpose.monocular.network import Network
from fgpose.monocular.networks import open_network
from fgpose.monocular.networks.devices import Device
from fgpose.pipeline import AnySource, load_source
from fgpose.skeleton import Skeleton
from fgpose.study.study import DetectionSettings, StudyDescription, skeleton_of
from fgpose.study.trial import Trial

DETECTED, CAMERAS = "detected.parquet", "cameras.toml"
"""What a network found in videos, and the cameras with the intrinsics of these videos."""
SYNCHRONISED = "synchronised.toml"
"""The cameras whose start is known, with their starts."""
SEEN, CALIBRATION = "seen.parquet", "calibration.toml"
"""The keypoints with the 3D of each view moved with its camera, and the cameras, after a calibration."""
MOTION, ANGLES, REPORT = "motion.parquet", "angles.parquet", "report.html"


def network(study: StudyDescription) -> Network:
    """The network of a study, opened once in a process. Raises ValueError and OSError as open_network."""
    return _network(study.detect, study.detect.device or study.parameters.monocular.device, study.base)


@lru_cache(maxsize=1)
def _network(settings: DetectionSettings, device: Device, base: Path) -> Network:
    file = base / settings.model
    return open_network(
        file if file.is_file() else settings.model,
        kind=settings.network,
        detector=base / settings.detector if settings.detector else None,
        max_people=settings.max_people,
        device=device,
    )


@dataclass(frozen=True)
class Job:
    """The work on one recording, in a folder of its own."""

    study: StudyDescription
    recording: Trial
    folder: Path
    """Where the results are made."""
    row: dict[str, Any] = field(default_factory=dict)
    """What the steps say of the result, for the table of quality."""

    def path(self, name: str) -> Path:
        return self.folder / name

    def first(self, *names: str) -> Path | None:
        """The first of these files that there is."""
        return next((self.path(name) for name in names if self.path(name).exists()), None)

    @property
    def keypoints(self) -> Path:
        return self.first(SEEN, DETECTED) or self.recording.source

    @property
    def calibration(self) -> Path:
        """Raises ValueError if there is none."""
        found = self.first(CALIBRATION, SYNCHRONISED, CAMERAS) or self.recording.calibration
        if found is None:
            raise ValueError("it has no calibration")
        return found

    @cached_property
    def skeleton(self) -> Skeleton:
        """Raises ValueError where neither study nor keypoints say it."""
        if self.recording.kind == "videos":
            return network(self.study).skeleton
        if self.study.data.skeleton:
            return load_skeleton(skeleton_of(self.study))
        try:
            return stated_skeleton(self.keypoints)
        except ValueError as error:
            raise ValueError(f"data.skeleton is missing, and {error}") from None

    def source(self) -> AnySource:
        """Everybody, or one person, as is wanted and as many as there are. Raises ValueError and OSError as
        load_source."""
        given = self.keypoints, self.calibration, self.skeleton
        return load_source(*given, people=self.study.steps.people, **self.reading)

    @property
    def reading(self) -> dict[str, Any]:
        """How keypoints are read."""
        data = self.study.data
        own = self.keypoints.parent == self.folder
        synchronised = self.first(SYNCHRONISED)
        # Calibrations that fgpose has written are in metres.
        in_metres = self.recording.calibrated_on or self.calibration.parent == self.folder
        return {
            "cameras": data.cameras if synchronised is None else load_rig(synchronised).names,
            "fps": data.fps,
            "unit": "auto" if in_metres else data.unit,
            "points3d_frame": "camera" if own else data.points3d_frame,
            "points3d_unit": data.points3d_unit,
            "min_confidence": data.min_confidence,
        }
