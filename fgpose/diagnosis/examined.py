"""What is looked at: a recording, its rig and, if there is one, a result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from fgpose.association.recording import Association
from fgpose.calibration.everybody import each_person
from fgpose.config import Config
from fgpose.diagnosis.finished import FinishedRecording
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import Triangulation, triangulate_robust
from fgpose.observations import Observations
from fgpose.sampling import fair_limits, spread_evenly

_MAX_FRAMES = 2000  # of everybody, spread over the whole recording: bounds the time; medians need no more


class NotJudgedError(Exception):
    """A check cannot tell anything of this recording; its text says why, as "fewer than three cameras"."""


@dataclass(frozen=True, eq=False)
class Examined:
    """A recording on the clock of its rig."""

    rig: CameraRig
    people: Mapping[int, Observations]
    """What the cameras saw of each person, by number; there is at least one."""
    config: Config = field(default_factory=Config)
    association: Association | None = None
    """Who was told apart, where there are several."""
    result: FinishedRecording | None = None
    remarks: tuple[str, ...] = ()
    """What readers of files had to repair or to leave out."""

    @staticmethod
    def of(
        recording: Observations | Association,
        rig: CameraRig,
        config: Config | None = None,
        result: FinishedRecording | None = None,
    ) -> Examined:
        """Of one person, or of everybody who was told apart.

        Raises:
            ValueError: the cameras of the recording and of the rig differ.
        """
        config = config or Config()
        if isinstance(recording, Observations):
            recording.check_cameras(rig.names)
            return Examined(rig, {0: recording}, config, None, result, recording.remarks)
        recording.observations.check_cameras(rig.names)
        remarks = recording.observations.remarks
        everybody = each_person(recording.observations, recording)
        return Examined(rig, dict(zip(recording.people, everybody, strict=True)), config, recording, result, remarks)

    def number(self, person: int) -> int | None:
        """Of a person, where there are several: Finding.person."""
        return person if len(self.people) > 1 else None

    @cached_property
    def main(self) -> Observations:
        """Of the person who is seen most."""
        return max(self.people.values(), key=lambda seen: int(seen.seen.sum()))

    @cached_property
    def sampled(self) -> Mapping[int, Observations]:
        """Frames of each person, spread evenly over the whole time in which they are there."""
        limits = fair_limits([seen.n_frames for seen in self.people.values()], _MAX_FRAMES)
        return {
            person: seen.frames(spread_evenly(seen.n_frames, max(int(limit), 1)))
            for (person, seen), limit in zip(self.people.items(), limits, strict=True)
        }

    @cached_property
    def undistorted_px(self) -> Float[np.ndarray, "frame camera joint 2"]:
        """Of the sampled frames of everybody, one after the other; NaN = missing."""
        return np.concatenate([self.rig.undistort(seen.points2d_px) for seen in self.sampled.values()])

    @cached_property
    def confidence(self) -> Float[np.ndarray, "frame camera joint"]:
        return np.concatenate([seen.confidence for seen in self.sampled.values()])

    @cached_property
    def triangulated(self) -> Triangulation:
        """Of the sampled frames, from the views that agree."""
        return triangulate_robust(self.undistorted_px, self.confidence, self.rig, self.config.fusion.inlier_px)

    @cached_property
    def seen(self) -> Bool[np.ndarray, "frame camera joint"]:
        """Whether each camera detected each joint, in the sampled frames."""
        return np.asarray(np.isfinite(self.undistorted_px).all(axis=-1))
