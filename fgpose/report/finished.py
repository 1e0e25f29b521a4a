"""A finished recording: what the estimator made of it, and what is still known of what it was made from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class FinishedRecording:
    """The results of one recording. All that is not a trajectory may be missing: what rests on it is then not judged.

    Raises:
        ValueError: there is nobody, or people differ in skeleton or cameras, or the rig lacks a camera.
    """

    name: str
    people: Mapping[int, Trajectory]
    """By the number of the person."""
    rig: CameraRig | None = None
    """The cameras of the trajectories, in their order."""
    observations: Mapping[int, Observations] = field(default_factory=dict)
    """What the cameras saw of each person, in the frames of the trajectory; of those for whom it is known."""

    def __post_init__(self) -> None:
        if not self.people:
            raise ValueError(f"recording {self.name}: there is nobody in it")
        first = next(iter(self.people.values()))
        for person, trajectory in self.people.items():
            if (trajectory.skeleton, trajectory.camera_names) != (first.skeleton, first.camera_names):
                raise ValueError(f"recording {self.name}: person {person} has another skeleton or other cameras")
            seen = self.observations.get(person)
            if seen is not None and seen.points2d_px.shape[:3] != self._shape(trajectory):
                raise ValueError(
                    f"recording {self.name}: the observations of person {person} have frames, cameras, joints "
                    f"{seen.points2d_px.shape[:3]}, the trajectory {self._shape(trajectory)}"
                )
        if self.rig is not None and first.camera_names:
            object.__setattr__(self, "rig", self.rig.subset(first.camera_names))

    @staticmethod
    def _shape(trajectory: Trajectory) -> tuple[int, int, int]:
        return trajectory.n_frames, len(trajectory.camera_names), trajectory.skeleton.n_joints

    @property
    def main(self) -> Trajectory:
        """Of the person of whom most is seen by two cameras."""
        return max(self.people.values(), key=lambda trajectory: int(trajectory.observed.sum()))

    @property
    def camera_names(self) -> tuple[str, ...]:
        return self.main.camera_names or (self.rig.names if self.rig is not None else ())
