"""What is looked at: a recording, its rig and, if there is one, a result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.assessment.recording_info import RecordingInfo, recording_info
from fgpose.association.chosen_person import unfollowed
from fgpose.association.recording import Association
from fgpose.calibration.everybody import each_person
from fgpose.config import Config
from fgpose.diagnosis.finished import FinishedRecording
from fgpose.diagnosis.hypotheses.consistency import consistency
from fgpose.diagnosis.hypotheses.geometry import Geometry, examine
from fgpose.diagnosis.hypotheses.scene import SynchronousViews, limb_joints
from fgpose.diagnosis.steps import Steps
from fgpose.estimation.evidence.image_checks.followed import views_gone_over
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import usual_parallax_deg
from fgpose.geometry.up_axis import UpChoice, WorldUp
from fgpose.observations import Observations
from fgpose.sampling import fair_limits, spread_evenly

_BODY_FRAMES = 120  # lengths and directions of a body are medians
_MAX_FRAMES = 2000  # of everybody, spread over the whole recording: bounds the time; medians need no more
# Of two cameras, as seen from the person: where depth errs eleven times as much as the rest, correlated errors of both
# move it by more than is claimed (two at 5 degrees: half of all joints by 107 mm, 87 % within the 99 % ellipsoid).
SIDE_BY_SIDE_DEG = 10.0
# Of a camera's median confidence. Below, joints are hallucinated rather than seen: legs under a table.
_SURE = 0.25


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
    world_up: UpChoice | WorldUp = "auto"
    """Which axis of the world is said to point up; auto: as body and cameras stand."""
    with_unfollowed: Observations | None = None
    """Of one person who was chosen among several: see Source.with_unfollowed."""
    steps: Steps = field(default_factory=Steps)
    """How far the diagnosis is."""

    @staticmethod
    def of(
        recording: Observations | Association,
        rig: CameraRig,
        config: Config | None = None,
        result: FinishedRecording | None = None,
        world_up: UpChoice | WorldUp = "auto",
    ) -> Examined:
        """Of one person, or of everybody who was told apart.

        Raises:
            ValueError: the cameras of the recording and of the rig differ.
        """
        config = config or Config()
        if isinstance(recording, Observations):
            recording.check_cameras(rig.names)
            return Examined(rig, {0: recording}, config, None, result, recording.remarks, world_up)
        recording.observations.check_cameras(rig.names)
        remarks = recording.observations.remarks
        everybody = each_person(recording.observations, recording)
        people = dict(zip(recording.people, everybody, strict=True))
        return Examined(rig, people, config, recording, result, remarks, world_up)

    def with_cameras(self, names: list[str]) -> Examined:
        """Some of the cameras."""
        people = {person: seen.subset(names) for person, seen in self.people.items()}
        return replace(self, rig=self.rig.subset(names), people=people, association=None, with_unfollowed=None)

    def number(self, person: int) -> int | None:
        """Of a person, where there are several: Finding.person."""
        return person if len(self.people) > 1 else None

    @property
    def longest_s(self) -> float:
        """For how long whoever is there longest is there."""
        return max(float(np.ptp(seen.frame_time_s)) for seen in self.people.values())

    @cached_property
    def main(self) -> Observations:
        """Of the main person."""
        return self.people[self.main_person]

    @cached_property
    def main_person(self) -> int:
        """Who is seen most."""
        return max(self.people, key=lambda person: int(self.people[person].seen.sum()))

    @cached_property
    def unfollowed(self) -> list[str]:
        """Cameras in most of whose images nobody is followed although they show people, where several were told
        apart."""
        return [] if self.association is None else [self.rig.names[c] for c in unfollowed(self.association)]

    def in_words(self, cameras: Sequence[str]) -> str:
        """These cameras, at least one."""
        return "all cameras" if len(cameras) == self.rig.n_cameras else ", ".join(cameras)

    @cached_property
    def info(self) -> RecordingInfo:
        """What is seen of the main person, and how well the cameras agree: several checks ask."""
        return recording_info(self.main, self.rig)

    @cached_property
    def sampled(self) -> Mapping[int, Observations]:
        """Frames of each person, spread evenly over the whole time in which they are there."""
        limits = fair_limits([seen.n_frames for seen in self.people.values()], _MAX_FRAMES)
        return {
            person: seen.frames(spread_evenly(seen.n_frames, max(int(limit), 1)))
            for (person, seen), limit in zip(self.people.items(), limits, strict=True)
        }

    @cached_property
    def _least_sure(self) -> Float[np.ndarray, " camera"]:
        """The confidence below which a camera is unsure."""
        of_cameras = self.main.confidence.swapaxes(0, 1)
        return _SURE * np.array([np.median(own[own > 0]) if (own > 0).any() else 0.0 for own in of_cameras])

    def scene(self, frames: Int[np.ndarray, " frame"]) -> SynchronousViews:
        """What was seen of the main person in some frames: all joints, without what its camera is unsure of."""
        seen = self.main.frames(frames)
        sure = seen.confidence >= self._least_sure[:, None]
        points_px = np.where(sure[..., None], seen.points2d_px, np.nan)
        return SynchronousViews.of(self.rig, points_px, seen.skeleton, seen.frame_time_s)

    @cached_property
    def geometry(self) -> Geometry:
        """Whether the cameras agree on it; and if not, why."""
        limbs = limb_joints(self.main.skeleton)
        return examine(lambda frames: self.scene(frames).joints(limbs), self.main.frame_time_s)

    @cached_property
    def gone_over(self) -> Bool[np.ndarray, "frame camera"]:
        """In which images of the main person the detector has gone over to somebody else. In none where several were
        told apart, as each has their own; nor with a calibration that does not fit, where nobody can be told from
        somebody else."""
        if self.association is not None or self.rig.n_cameras < 2 or self.geometry.explanation is not None:
            return np.zeros((self.main.n_frames, self.rig.n_cameras), dtype=bool)
        return views_gone_over(self.main, self.rig)

    @cached_property
    def body_m(self) -> Float[np.ndarray, "frame joint 3"]:
        """Joints of the main person in some frames; see agreed_m."""
        return self.agreed_m(spread_evenly(self.main.n_frames, _BODY_FRAMES))

    @cached_property
    def side_by_side(self) -> bool:
        """Whether two cameras see the main person from nearly the same side: distances, and with them the lengths of
        bones, err so much that they tell nothing of the body or of lenses. Raises NotJudgedError as agreed_m."""
        return self.rig.n_cameras == 2 and usual_parallax_deg(self.body_m, self.rig) < SIDE_BY_SIDE_DEG

    def refuse_side_by_side(self) -> None:
        """Raises NotJudgedError if two cameras are side by side, or as agreed_m."""
        if self.side_by_side:
            raise NotJudgedError("the two cameras look from nearly the same side")

    def frames_in_words(self) -> str:
        """How many there are of the main person: why lengths are not judged where there are few."""
        return "it has one frame" if self.main.n_frames == 1 else f"it has {self.main.n_frames} frames"

    def agreed_m(self, frames: Int[np.ndarray, " frame"]) -> Float[np.ndarray, "frame joint 3"]:
        """Joints of the main person as the cameras agree; raises NotJudgedError if they do not."""
        if self.rig.n_cameras < 2:
            raise NotJudgedError("one camera")
        if not self.geometry.usable:
            raise NotJudgedError("the cameras do not agree where the body is")
        return consistency(self.scene(frames)).positions_m

    @cached_property
    def undistorted_px(self) -> Float[np.ndarray, "frame camera joint 2"]:
        """Of the sampled frames of everybody, one after the other; NaN = missing."""
        return np.concatenate([self.rig.undistort(seen.points2d_px) for seen in self.sampled.values()])

    @cached_property
    def confidence(self) -> Float[np.ndarray, "frame camera joint"]:
        return np.concatenate([seen.confidence for seen in self.sampled.values()])

    @cached_property
    def seen(self) -> Bool[np.ndarray, "frame camera joint"]:
        """Whether each camera detected each joint, in the sampled frames."""
        return np.asarray(np.isfinite(self.undistorted_px).all(axis=-1))
