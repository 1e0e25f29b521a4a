"""fgpose: 3D human pose over time from several calibrated cameras, as a GTSAM factor graph.

rig = fgpose.load_rig("Calib.toml")
observations = fgpose.load_observations("pose/", rig, skeleton="body_25b", fps=60)
trajectory = fgpose.smooth(observations, rig)

Here is what everybody uses. The rest is in fgpose.calibration, fgpose.files, fgpose.people, fgpose.config (sections of
the configuration), and fgpose.diagnosis, fgpose.assessment and fgpose.kinematics (what their functions return). What
is in the ``__all__`` of these is stable (docs/reference/stability.md).
"""

import sys as _sys
import typing as _typing

if "".join(_sys.argv[:1]).endswith("/fgpose") or _sys.orig_argv[1:3] == ["-m", "fgpose"]:
    # Ctrl-C ends the command while it loads its modules: there, an interrupt would become any error.
    import signal as _signal

    if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
        _signal.signal(_signal.SIGINT, _signal.SIG_DFL)

from importlib.metadata import version as _version

# Before anything loads OpenCV, whose limit it sets.
import fgpose.plain_files as _plain_files  # noqa: F401
from fgpose import assessment as assessment
from fgpose import calibration as calibration
from fgpose import config as config
from fgpose import diagnosis as diagnosis
from fgpose import files as files
from fgpose import kinematics as kinematics
from fgpose import people as people
from fgpose.assessment import evaluate
from fgpose.config import Config, load_config
from fgpose.diagnosis import Finding, diagnose
from fgpose.estimation.estimator import Estimator
from fgpose.estimation.evidence.fusion import Fusion, fuse
from fgpose.estimation.refinement import refine
from fgpose.estimation.smoother import smooth
from fgpose.files import (
    load_observations,
    load_people,
    load_rig,
    load_skeleton,
    load_trajectory,
    save_rig,
    save_trajectory,
)
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.kinematics import joint_angles
from fgpose.observations import Observations
from fgpose.people import Tracker, smooth_people
from fgpose.skeleton import BodyPart, BoneLengths, Skeleton
from fgpose.trajectory import Convergence, Estimate, Status, Trajectory

if not _typing.TYPE_CHECKING:  # for which a name that has moved is one that is not there
    from fgpose.deprecated import moved as __getattr__  # noqa: F401

__version__ = _version("fgpose")

__all__ = [
    "BodyPart",
    "BoneLengths",
    "Camera",
    "CameraRig",
    "Config",
    "Convergence",
    "Estimate",
    "Estimator",
    "Finding",
    "Fusion",
    "Observations",
    "Skeleton",
    "Status",
    "Tracker",
    "Trajectory",
    "diagnose",
    "evaluate",
    "fuse",
    "joint_angles",
    "load_config",
    "load_observations",
    "load_people",
    "load_rig",
    "load_skeleton",
    "load_trajectory",
    "refine",
    "save_rig",
    "save_trajectory",
    "smooth",
    "smooth_people",
]
