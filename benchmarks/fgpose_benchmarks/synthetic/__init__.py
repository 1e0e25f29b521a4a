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

from fgpose_benchmarks.synthetic.answering_network import AnsweringNetwork as AnsweringNetwork
from fgpose_benchmarks.synthetic.crowd.bodies import Furniture as Furniture
from fgpose_benchmarks.synthetic.crowd.errors import NO_CROWD_ERRORS as NO_CROWD_ERRORS
from fgpose_benchmarks.synthetic.crowd.errors import CameraTimes as CameraTimes
from fgpose_benchmarks.synthetic.crowd.errors import CrowdErrors as CrowdErrors
from fgpose_benchmarks.synthetic.crowd.motion import CrowdMotion as CrowdMotion
from fgpose_benchmarks.synthetic.crowd.motion import crowd_motion as crowd_motion
from fgpose_benchmarks.synthetic.crowd.routes import CrowdPlan as CrowdPlan
from fgpose_benchmarks.synthetic.crowd.scene import CrowdScene as CrowdScene
from fgpose_benchmarks.synthetic.crowd.scene import positions_at as positions_at
from fgpose_benchmarks.synthetic.crowd.scene import simulate_crowd as simulate_crowd
from fgpose_benchmarks.synthetic.crowd.sitting import Seat as Seat
from fgpose_benchmarks.synthetic.crowd.walkers import stature_m as stature_m
from fgpose_benchmarks.synthetic.crowd.walkers import walkers as walkers
from fgpose_benchmarks.synthetic.motion import embedded_motion as embedded_motion
from fgpose_benchmarks.synthetic.motion import motion_from_npz as motion_from_npz
from fgpose_benchmarks.synthetic.motion import walking as walking
from fgpose_benchmarks.synthetic.noise import NO_NOISE as NO_NOISE
from fgpose_benchmarks.synthetic.noise import DetectionNoise as DetectionNoise
from fgpose_benchmarks.synthetic.occlusion import NO_OCCLUSION as NO_OCCLUSION
from fgpose_benchmarks.synthetic.occlusion import Occlusion as Occlusion
from fgpose_benchmarks.synthetic.real_errors import RealErrors as RealErrors
from fgpose_benchmarks.synthetic.real_errors import real_errors as real_errors
from fgpose_benchmarks.synthetic.rig import ring_rig as ring_rig
from fgpose_benchmarks.synthetic.scene import Scene as Scene
from fgpose_benchmarks.synthetic.scene import simulate as simulate
from fgpose_benchmarks.synthetic.studios import STUDIOS as STUDIOS
from fgpose_benchmarks.synthetic.studios import Studio as Studio
from fgpose_benchmarks.synthetic.studios import find_studio as find_studio
from fgpose_benchmarks.synthetic.uncalibrated import SimulatedClocks as SimulatedClocks
from fgpose_benchmarks.synthetic.uncalibrated import SimulatedNetwork as SimulatedNetwork
from fgpose_benchmarks.synthetic.uncalibrated import WalkScene as WalkScene
from fgpose_benchmarks.synthetic.uncalibrated import film as film
