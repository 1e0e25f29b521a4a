"""fgpose: 3D human pose over time from several calibrated cameras, as a GTSAM factor graph.

rig = fgpose.load_rig("Calib.toml")
observations = fgpose.load_observations("pose/", rig, skeleton="body_25b", fps=60)
trajectory = fgpose.smooth(observations, rig)
"""

import sys as _sys

if "".join(_sys.argv[:1]).endswith("/fgpose") or _sys.orig_argv[1:3] == ["-m", "fgpose"]:
    # Ctrl-C ends the command while it loads its modules: there, an interrupt would become any error.
    import signal as _signal

    if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
        _signal.signal(_signal.SIGINT, _signal.SIG_DFL)

from importlib.metadata import version as _version

# Before anything loads OpenCV, whose limit it sets.
import fgpose.plain_files as _plain_files  # noqa: F401
from fgpose.assessment.evaluation import Evaluation, evaluate
from fgpose.assessment.people import PeopleEvaluation, evaluate_people
from fgpose.association.common_clock import on_common_clock
from fgpose.calibration.bumped import BumpedRig, refine_bumped
from fgpose.calibration.from_people.calibrate import calibrate
from fgpose.calibration.from_people.calibrated import CalibratedFromPeople
from fgpose.calibration.rig_refinement import RigRefinement, refine_rig
from fgpose.calibration.self_calibration import SelfCalibration, self_calibrate
from fgpose.calibration.synchronisation import Synchronised, synchronise
from fgpose.calibration.time_offsets import TimeOffsets, estimate_time_offsets
from fgpose.config import Config, load_config
from fgpose.diagnosis.diagnose import Diagnosis, diagnose
from fgpose.estimation.estimator import Estimator
from fgpose.estimation.evidence.fusion import Fusion, fuse
from fgpose.estimation.refinement import refine
from fgpose.estimation.smoother import smooth
from fgpose.finding import Code, Finding, Severity
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.intrinsics import guessed_intrinsics
from fgpose.geometry.turned_images import turn_images
from fgpose.io.calibration import load_intrinsics, load_rig, save_rig
from fgpose.io.keypoints import (
    load_observations,
    load_people,
    load_uncalibrated,
    save_observations,
    save_people_observations,
)
from fgpose.io.recordings import load_recording, recordings
from fgpose.io.skeletons import builtin_skeletons, load_skeleton
from fgpose.io.trajectories import load_people_trajectories, load_trajectory, save_people, save_trajectory
from fgpose.io.trajectories.kinematics import load_angles, save_kinematics
from fgpose.kinematics.angles import JointAngles, joint_angles
from fgpose.observations import Observations
from fgpose.people_observations import Detections, PeopleObservations
from fgpose.skeleton import Skeleton
from fgpose.tracking import SmoothedPeople, Tracked, Tracker, smooth_people
from fgpose.trajectory import Convergence, Estimate, Status, Trajectory

__version__ = _version("fgpose")

__all__ = [
    "BumpedRig",
    "CalibratedFromPeople",
    "Camera",
    "CameraRig",
    "Code",
    "Config",
    "Convergence",
    "Detections",
    "Diagnosis",
    "Estimate",
    "Estimator",
    "Evaluation",
    "Finding",
    "Fusion",
    "JointAngles",
    "Observations",
    "PeopleEvaluation",
    "PeopleObservations",
    "RigRefinement",
    "SelfCalibration",
    "Severity",
    "Skeleton",
    "SmoothedPeople",
    "Status",
    "Synchronised",
    "TimeOffsets",
    "Tracked",
    "Tracker",
    "Trajectory",
    "builtin_skeletons",
    "calibrate",
    "diagnose",
    "estimate_time_offsets",
    "evaluate",
    "evaluate_people",
    "fuse",
    "guessed_intrinsics",
    "joint_angles",
    "load_angles",
    "load_config",
    "load_intrinsics",
    "load_observations",
    "load_people",
    "load_people_trajectories",
    "load_recording",
    "load_rig",
    "load_skeleton",
    "load_trajectory",
    "load_uncalibrated",
    "on_common_clock",
    "recordings",
    "refine",
    "refine_bumped",
    "refine_rig",
    "save_kinematics",
    "save_observations",
    "save_people",
    "save_people_observations",
    "save_rig",
    "save_trajectory",
    "self_calibrate",
    "smooth",
    "smooth_people",
    "synchronise",
    "turn_images",
]
