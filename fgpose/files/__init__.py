"""All files that fgpose reads and writes, whatever their format (docs/reference/formats.md).

- Cameras: load_rig, save_rig; load_intrinsics for lenses alone. load_calibration_origin says how the cameras became
  what they are (CalibrationOrigin, of each MovedCamera, with each Reason of a verdict).
- Keypoints: load_observations, save_observations of one person; load_people, save_people_observations of everybody;
  load_uncalibrated of cameras that are not calibrated.
- Results: load_trajectory, save_trajectory; load_people_trajectories, save_people. Origin is what a result was made
  from, each InputFile of it. What a Tracker leaves to the next one: load_memory, save_memory.
- Joint angles and what goes with them: load_angles, save_kinematics.
- Skeletons and parameters: load_skeleton, builtin_skeletons; load_config.
- The recordings that come with fgpose: recordings, load_recording.
"""

from fgpose.config import load_config
from fgpose.io.calibration import CalibrationOrigin, load_calibration_origin, load_intrinsics, load_rig, save_rig
from fgpose.io.calibration.calibration_origin import MovedCamera, Reason
from fgpose.io.keypoints import (
    load_observations,
    load_people,
    load_uncalibrated,
    save_observations,
    save_people_observations,
)
from fgpose.io.live.tracker_memory import load_memory, save_memory
from fgpose.io.origin import InputFile, Origin
from fgpose.io.recordings import load_recording, recordings
from fgpose.io.skeletons import builtin_skeletons, load_skeleton
from fgpose.io.trajectories import load_people_trajectories, load_trajectory, save_people, save_trajectory
from fgpose.io.trajectories.kinematics import load_angles, save_kinematics

__all__ = [
    "CalibrationOrigin",
    "InputFile",
    "MovedCamera",
    "Origin",
    "Reason",
    "builtin_skeletons",
    "load_angles",
    "load_calibration_origin",
    "load_config",
    "load_intrinsics",
    "load_memory",
    "load_observations",
    "load_people",
    "load_people_trajectories",
    "load_recording",
    "load_rig",
    "load_skeleton",
    "load_trajectory",
    "load_uncalibrated",
    "recordings",
    "save_kinematics",
    "save_memory",
    "save_observations",
    "save_people",
    "save_people_observations",
    "save_rig",
    "save_trajectory",
]
