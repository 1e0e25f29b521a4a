"""The state of a frame in the window of the online estimator."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from fgpose.estimation.evidence.delays import image_shift_px
from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.keys import position_key, velocity_key
from fgpose.estimation.segment import FrameTime
from fgpose.frozen import changed
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.trajectory import joint_status


@dataclass(frozen=True, eq=False)
class FrameState:
    """A frame in the window: its observations, and the pose as it was last read from the solver."""

    at: FrameTime
    step_s: float
    """Time since the frame before; inf for the first."""
    observations: Observations
    """Of this frame, all cameras of the rig; an image that has not come yet shows nothing."""
    image_time_s: Float[np.ndarray, " camera"]
    """When each camera took its image; NaN if it has not come yet."""
    gathered: Evidence
    """Of this frame, its detections moved to the time of the frame."""
    evidence: Evidence
    """The same as it is in the graph: weighted by the probability that each detection is of its joint."""
    positions_m: Float[np.ndarray, "joint 3"]
    velocities_mps: Float[np.ndarray, "joint 3"]
    lengths_m: Float[np.ndarray, " length"]
    """Of its bones in the graph."""
    active: Bool[np.ndarray, " joint"]
    """Which joints are estimated."""
    linked: Bool[np.ndarray, " joint"]
    """Which of them a motion factor joins to the frame before; the others enter the graph here."""
    process_density: Float[np.ndarray, " joint"]
    """Power spectral density of the noise of the motion that leads to this frame; see Segment."""
    filtered: Float[np.ndarray, "camera joint"]
    """Probability that each joint is visible to each camera, by this frame and those before it."""
    unseen_before_s: Float[np.ndarray, " joint"]
    """Time since any camera probably saw each joint, if none does in this frame."""

    @property
    def status(self) -> np.ndarray:
        """Of each joint; see Trajectory."""
        return joint_status(self.active, self.evidence.observed[0])

    @property
    def unseen_s(self) -> Float[np.ndarray, " joint"]:
        """Time since any camera probably saw each joint."""
        return np.where(self.evidence.seen[0], 0.0, self.unseen_before_s)

    @property
    def as_gathered(self) -> Evidence:
        """With the weights as gathered, and the standard deviations and probabilities of the graph."""
        return changed(self.gathered, sigma_px=self.evidence.sigma_px, visibility=self.evidence.visibility)

    def weighted(self, evidence: Evidence, frame: slice, joints: Bool[np.ndarray, " joint"]) -> Evidence:
        """Its evidence with the visibility of this frame of another, and the weights and standard deviations there for
        some joints."""
        values: dict[str, np.ndarray] = {}
        for name in ("weights", "sigma_px", "depth_sigma_m"):
            own = getattr(self.evidence, name)
            of_other = getattr(evidence, name)[frame, : own.shape[1]]  # nothing where this frame has no depths
            values[name] = np.where(joints, of_other, own)
        return changed(self.evidence, **values, visibility=evidence.visibility[frame])

    def judged(self, visibility: Float[np.ndarray, "camera joint"]) -> FrameState:
        """The newest frame with the probability that each of its detections is of its joint."""
        evidence = changed(self.evidence, visibility=visibility[None])
        return changed(self, evidence=evidence, filtered=visibility)

    @cached_property
    def joints(self) -> list[int]:
        """The joints that are estimated."""
        return np.flatnonzero(self.active).tolist()

    @cached_property
    def position_keys(self) -> list[int]:
        return [position_key(joint, self.at.frame) for joint in self.joints]

    @cached_property
    def velocity_keys(self) -> list[int]:
        return [velocity_key(joint, self.at.frame) for joint in self.joints]

    def on_time_px(self, rig: CameraRig) -> Float[np.ndarray, "camera joint 2"]:
        """The detections, undistorted and with their bias, where they would be if this were the motion and all cameras
        were synchronous but for the offsets of this rig."""
        delay_s = np.nan_to_num(self.image_time_s - self.at.time_s) + rig.time_offsets_s
        moved_px = image_shift_px(self.positions_m, self.velocities_mps * delay_s[:, None, None], rig)
        return rig.undistort(self.observations.points2d_px)[0] - moved_px

    def carried_on_m(self, step_s: float) -> Float[np.ndarray, "joint 3"]:
        """Predicted positions after this time, by the velocities."""
        return self.positions_m + self.velocities_mps * step_s

    def since_seen_s(self, time_s: float) -> Float[np.ndarray, " joint"]:
        """Time from then to this frame for the joints that a camera probably sees in it; inf for the others."""
        return np.where(self.evidence.seen[0], self.at.time_s - time_s, np.inf)

    def joined(
        self,
        observations: Observations,
        image_time_s: Float[np.ndarray, " camera"],
        gathered: Evidence,
        evidence: Evidence,
        entering: Bool[np.ndarray, " joint"],
    ) -> FrameState:
        """The frame with another image, by which these joints are triangulated for the first time."""
        return changed(
            self,
            observations=observations,
            image_time_s=image_time_s,
            gathered=gathered,
            evidence=evidence,
            positions_m=np.where(entering[:, None], evidence.guess_m[0], self.positions_m),
            velocities_mps=np.where(entering[:, None], 0.0, self.velocities_mps),
            active=self.active | entering,
        )
