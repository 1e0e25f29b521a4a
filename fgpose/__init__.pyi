"""What is loaded when it is asked for (``fgpose/__init__.py``)."""

from . import assessment as assessment
from . import calibration as calibration
from . import config as config
from . import diagnosis as diagnosis
from . import files as files
from . import kinematics as kinematics
from . import people as people
from .assessment import evaluate as evaluate
from .config import Config as Config
from .config import load_config as load_config
from .diagnosis import Finding as Finding
from .diagnosis import diagnose as diagnose
from .estimation.estimator import Estimator as Estimator
from .estimation.evidence.fusion import Fusion as Fusion
from .estimation.evidence.fusion import fuse as fuse
from .estimation.refinement import refine as refine
from .estimation.smoother import smooth as smooth
from .files import load_observations as load_observations
from .files import load_people as load_people
from .files import load_rig as load_rig
from .files import load_skeleton as load_skeleton
from .files import load_trajectory as load_trajectory
from .files import save_rig as save_rig
from .files import save_trajectory as save_trajectory
from .geometry.camera import Camera as Camera
from .geometry.camera import CameraRig as CameraRig
from .kinematics import joint_angles as joint_angles
from .observations import Observations as Observations
from .people import Tracker as Tracker
from .people import smooth_people as smooth_people
from .skeleton import BodyPart as BodyPart
from .skeleton import BoneLengths as BoneLengths
from .skeleton import Skeleton as Skeleton
from .trajectory import Convergence as Convergence
from .trajectory import Estimate as Estimate
from .trajectory import Status as Status
from .trajectory import Trajectory as Trajectory

__all__: list[str]
__version__: str
