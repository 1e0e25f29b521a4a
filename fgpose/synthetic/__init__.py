"""Synthetic scenes: the truth first, then what a monocular estimator detects, then occlusion.

The default error structure is that of BlazePose GHUM measured on four calibrated views: depth much worse than lateral,
partly shared by the whole body, correlated in time, with a bias of its own in every camera. Outliers, confidence and
hallucinations behind occluders were not measured: their defaults are assumptions. RealErrors are those of detectors on
real recordings instead. Occluders follow the rule of
Human3.6M-Occluded, but stay for a while and move with the person, as a table or a robot does.

In scenes of several people it is people and furniture that hide joints, each camera has its own times, and a detector
also misses, doubles, invents, turns and mixes up people.

Where the cameras are not calibrated (uncalibrated), each has a clock of its own, per-view 3D joints are in its frame,
and the joints have a bias that depends on the side from which the body is seen.
"""

from fgpose.synthetic.bodies import Box as Box
from fgpose.synthetic.crowd import CrowdScene as CrowdScene
from fgpose.synthetic.crowd import positions_at as positions_at
from fgpose.synthetic.crowd import simulate_crowd as simulate_crowd
from fgpose.synthetic.crowd_errors import NO_CROWD_ERRORS as NO_CROWD_ERRORS
from fgpose.synthetic.crowd_errors import CameraTimes as CameraTimes
from fgpose.synthetic.crowd_errors import CrowdErrors as CrowdErrors
from fgpose.synthetic.crowd_motion import CrowdMotion as CrowdMotion
from fgpose.synthetic.crowd_motion import crowd_motion as crowd_motion
from fgpose.synthetic.motion import embedded_motion as embedded_motion
from fgpose.synthetic.motion import motion_from_npz as motion_from_npz
from fgpose.synthetic.motion import walking as walking
from fgpose.synthetic.noise import NO_NOISE as NO_NOISE
from fgpose.synthetic.noise import DetectionNoise as DetectionNoise
from fgpose.synthetic.occlusion import NO_OCCLUSION as NO_OCCLUSION
from fgpose.synthetic.occlusion import Occlusion as Occlusion
from fgpose.synthetic.real_errors import RealErrors as RealErrors
from fgpose.synthetic.real_errors import real_errors as real_errors
from fgpose.synthetic.rig import ring_rig as ring_rig
from fgpose.synthetic.routes import CrowdPlan as CrowdPlan
from fgpose.synthetic.scene import Scene as Scene
from fgpose.synthetic.scene import simulate as simulate
from fgpose.synthetic.sitting import Seat as Seat
from fgpose.synthetic.studios import STUDIOS as STUDIOS
from fgpose.synthetic.studios import Studio as Studio
from fgpose.synthetic.studios import find_studio as find_studio
from fgpose.synthetic.uncalibrated import Clocks as Clocks
from fgpose.synthetic.uncalibrated import Network as Network
from fgpose.synthetic.uncalibrated import WalkScene as WalkScene
from fgpose.synthetic.uncalibrated import film as film
from fgpose.synthetic.walkers import stature_m as stature_m
from fgpose.synthetic.walkers import walkers as walkers
