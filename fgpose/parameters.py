"""The parameters of each part: every number in physical units, with the effect of raising it.

The defaults live here and nowhere else; ``configs/default.toml`` is tested equal to them. The field docstrings are
what ``--help`` prints. Pixels are those of an image with a focal length of 1145 px; in other images they are more or
fewer in proportion to the focal length, so that the resolution does not matter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from fgpose_factors.kernels import Kernel

Device = Literal["auto", "cpu", "cuda", "tensorrt", "openvino", "coreml", "directml"]
"""What a network runs on; auto: the first of cuda, directml, openvino and cpu that this onnxruntime has."""


@dataclass(frozen=True)
class MonocularConfig:
    """From images to the joints that each camera sees (fgpose run, live and study)."""

    device: Device = "auto"
    """Where networks run, as fgpose models list shows; --device, and detect.device of a study, override it. auto: the
    first of cuda, directml, openvino and cpu that this onnxruntime has."""


@dataclass(frozen=True)
class FusionConfig:
    """Fusion of the per-view 3D poses (eq. 1-2), or robust triangulation where there are none."""

    exponent: Literal["squared", "unsquared"] = "squared"
    """Reprojection error in the weights of eq. 2: squared as printed, or un-squared as in the authors' earlier code.
    Squared trusts the best view more."""
    mean: Literal["reprojection", "covariance"] = "reprojection"
    """reprojection: eq. 1-2. covariance: by the covariance that each view states, with a robust kernel; where there is
    none, eq. 1-2."""
    inlier_px: float = 20.0
    """Views whose detection lies farther than this from a triangulated point are outliers, in pixels at a focal length
    of 1145 px. Where no two views agree, it is a length for points nearer than 3 m to a camera: 70 mm, as at 4 m.
    Raising it keeps more views, also worse ones."""
    anchor_sigma_m: float = 0.3
    """Standard deviation of the fused per-view 3D, metres: a joint that cannot be triangulated is held near it. Raising
    it trusts motion and bones more."""


@dataclass(frozen=True)
class ProjectionConfig:
    """Reprojection factors: one per camera, joint and frame."""

    sigma_px: float = 6.0
    """Standard deviation of a good detection, in pixels at a focal length of 1145 px: with visibility.model
    none, before anything is learned from the recording, and when cameras are calibrated. Raising it trusts motion and
    bones more."""
    kernel: Kernel = "cauchy"
    """Robust kernel on the reprojection error."""
    kernel_scale: float = 2.2
    """Error, in sigmas, from which the kernel begins to discount a detection. Raising it trusts outliers more."""
    weighting: Literal["fusion", "confidence", "uniform"] = "fusion"
    """Where the weight of each detection comes from: the views' agreement (eq. 2) and the detector's confidence, the
    confidence alone, or none."""
    confirming_px: float = 20.0
    """Distance between a detection and the nearest candidate of another view at which the agreement makes up for half
    of the missing confidence (weighting = fusion), in pixels at a focal length of 1145 px. Raising it uses the
    detector's confidence less."""
    agreement_px: float = 100.0
    """Distance between a detection and the nearest candidate of another view at which its weight is halved (weighting =
    fusion), in pixels at a focal length of 1145 px. Raising it trusts detections that no other view confirms."""


@dataclass(frozen=True)
class VisibilityConfig:
    """Whether each detection is of its joint or hallucinated: a hidden Markov chain for each joint in each camera."""

    model: Literal["none", "markov"] = "markov"
    """none: every detection keeps the weight of the fusion and projection.sigma_px. markov: detections that are
    probably hallucinated lose weight, and the standard deviation of the others is learned from the recording."""
    visible_s: float = 0.5
    """Mean time for which a joint usually stays visible, seconds; outweighed by what the recording tells. Raising it
    tells short occlusions less."""
    hidden_s: float = 0.25
    """Mean time for which a joint usually stays hidden, seconds; outweighed by what the recording tells. Raising it
    distrusts more of what follows a hallucination."""
    bias: Literal["none", "constant"] = "constant"
    """constant: what the detections of a joint in a camera are off by in all frames is learned from the recording, as
    far as the other cameras show it, and taken from them (with model = markov)."""
    sigma_m: float = 0.018
    """Usual standard deviation of a visible detection along each axis of the image, metres at the joint (measured on
    BlazePose and OpenPose); outweighed by what the recording tells. Raising it trusts the detections less."""
    hallucinated_m: float = 0.1
    """Scale of the errors of hallucinated detections, metres at the joint (half of them are larger by a factor of 1.7).
    Raising it distrusts only larger errors."""


@dataclass(frozen=True)
class DepthConfig:
    """The depth that each view's own 3D gives a joint, as a factor along its ray. Without covariance its standard
    deviation is that against the triangulated joints of the recording, or 4.3 % of the distance.

    Across the ray the factor has no information: the view's 2D detection has it already.
    """

    use: Literal["never", "few_views", "always"] = "few_views"
    """few_views: for joints that at most two cameras detect."""
    correlation_s: float = 0.02
    """Time over which the error of a view's depth is correlated: all frames within twice this count as one measurement,
    seconds. Raising it trusts the depth less. (Measured is about 0.15 s; this value gave the lowest errors where the
    depth is needed.)"""
    kernel: Kernel = "cauchy"
    """Robust kernel; also of the views' 3D in fusion.mean = covariance and in anchors (fusion.anchor_sigma_m)."""
    kernel_scale: float = 1.5
    """Error, in sigmas, from which the kernel begins to discount a depth. Raising it trusts outliers more."""


@dataclass(frozen=True)
class SymmetryConfig:
    """Left and right bones are equally long."""

    form: Literal["none", "frame", "shared_length"] = "shared_length"
    """frame: left minus right limb length within each frame (eq. 4). shared_length: one unknown length per bone pair,
    the same left and right and at all times."""
    sigma_m: float = 0.005
    """Standard deviation of the difference (frame) or of a bone around its length (shared_length), metres. Raising it
    lets bones vary more."""


@dataclass(frozen=True)
class MotionConfig:
    """Smoothness over time."""

    model: Literal["none", "random_walk", "constant_velocity"] = "constant_velocity"
    """constant_velocity: white noise on acceleration. random_walk: white noise on velocity."""
    adaptive: bool = True
    """Let each joint's acceleration density follow its motion (constant_velocity): learned from its accelerations
    around. Otherwise it is acceleration_density at all times."""
    acceleration_density: float = 4.0
    """Power spectral density of the acceleration, m^2/s^3 (constant_velocity); where adaptive, until the motion is
    known. Raising it follows fast motion more closely and smooths less."""
    velocity_density: float = 1.0
    """Power spectral density of the velocity, m^2/s (random_walk). Raising it smooths less."""
    fade_s: float = 0.05
    """Time constant with which the velocity of a joint that no camera sees fades to that of the body, seconds. Raising
    it carries its last movement on for longer."""
    max_unseen_s: float = 3.0
    """A joint that two cameras have not detected, or that probably no camera has seen, for longer than this is given up
    (NaN) until two cameras probably see it again, seconds. One camera is enough if it tells the depth. Of somebody whom
    no camera sees at all, see tracking.coast_s."""


@dataclass(frozen=True)
class SwingConfig:
    """How far a joint that no camera sees may have swung around the joint that holds it; widens its covariance only.

    The defaults fit the error of 60 intervals of 2 s, unseen, on four motion capture clips (CMU): rms 0.18, 0.31, 0.49,
    0.60, 0.59 bone lengths after 0.1, 0.2, 0.4, 1 and 2 s, wrists 0.84 in the end.
    """

    angle_rad: float = 0.85
    """Root mean square angle after a long time, radians. Raising it makes unseen joints less certain."""
    time_s: float = 0.35
    """Time constant with which the angle grows, seconds. Raising it keeps unseen joints certain for longer."""


@dataclass(frozen=True)
class PriorConfig:
    """Weak priors that keep every joint determined. They should not change a result noticeably."""

    position_sigma_m: float = 5.0
    """Standard deviation of a joint around its first guess, metres."""
    velocity_sigma_mps: float = 3.0
    """Standard deviation of a joint's first velocity around zero, m/s."""
    length_sigma_m: float = 0.3
    """Standard deviation of a bone's length around its first guess, metres, where the proportions of the body do not
    tell it: head, hands, feet."""


@dataclass(frozen=True)
class RefinementConfig:
    """The paper's method: each frame alone, eq. 3-5."""

    px_per_mm: float = 1.0
    """Eq. 5 adds squared pixels and squared lengths and leaves the unit of length open: pixels of reprojection error
    that cost as much as one millimetre of asymmetry. Raising it enforces symmetry more."""


@dataclass(frozen=True)
class CalibrationConfig:
    """Calibrating the cameras on the recording itself (refine_rig, estimate_time_offsets, self_calibrate); only done
    when asked for. Of these, the online estimator of time offsets uses those named offset_."""

    rotation_sigma_deg: float = 0.1
    """Standard deviation of the orientation of an untouched camera in the calibration, degrees. Raising it moves
    cameras further."""
    translation_sigma_m: float = 0.005
    """Standard deviation of the position of an untouched camera in the calibration, metres. Raising it moves cameras
    further."""
    bumped_sigmas: float = 1.0
    """Move of a camera, in these standard deviations, from which the prior discounts it as bumped (scale of a Cauchy
    kernel).
    Raising it spreads the move of one camera over all of them, which shifts the world."""
    offset_sigma_s: float = 0.1
    """Standard deviation of the time offsets that the rig has, seconds. Raising it trusts the recording more."""
    offset_memory_s: float = 30.0
    """Time constant with which the online estimate of time offsets forgets, seconds, since clocks drift. Raising it
    makes the offsets less noisy and slower to follow a drift."""
    independent_measurements: float = 50.0
    """How many independent measurements of a camera's pose all its detections of a person are worth: the errors of a
    network on one person in one view are correlated. Raising it trusts the recording more, the calibration less."""
    max_frames: int = 300
    """Frames that are used, spread evenly; of several people, of all together. Raising it takes longer."""
    max_duration_s: float = 30.0
    """Longest part of the recording that time offsets are estimated on, seconds; the part where most is seen. Several
    people share it out among them. Raising it takes longer."""
    max_rounds: int = 8
    """Greatest number of times that the motion is smoothed while time offsets are estimated. Raising it lets difficult
    recordings converge and may take longer."""


@dataclass(frozen=True)
class SolverConfig:
    """Batch optimisation (Levenberg-Marquardt)."""

    backend: Literal["numpy", "gtsam"] = "numpy"
    """What linearises the factors and solves for the step. numpy: all factors of a kind at once, frame after frame in
    LAPACK. gtsam: GTSAM, on a graph of the same factors; several times slower, and the same result."""
    max_iterations: int = 200
    """Upper bound of iterations per window."""
    step_tolerance_m: float = 5e-4
    """Converged when an iteration moves no joint by more than this, metres. Raising it stops earlier."""
    window_s: float = 15.0
    """Longer recordings are solved in windows of this length, seconds. Raising it takes more memory."""
    overlap_s: float = 0.75
    """Each window is extended by this beyond its ends, seconds. Raising it makes seams smaller and takes longer."""
    covariance: bool = True
    """Also compute the marginal covariance of every joint in every frame; adds a quarter to the time."""


@dataclass(frozen=True)
class OnlineConfig:
    """Online estimation: fixed lag, frame by frame."""

    solver: Literal["isam2", "window"] = "isam2"
    """What solves the window of the last lag_s. isam2: GTSAM's iSAM2, which eliminates anew what has changed. window:
    the normal equations of the newest frames, as in batch; the slowest updates take twice as long as the others, not
    three times, hallucinated detections are judged again every 0.1 s, not 0.2 s, and the estimator can be saved and
    continued."""
    lag_s: float = 0.5
    """How far back a new image still changes the past, seconds. Raising it makes the smoothed result better and each
    update slower; inf keeps the whole history (short recordings only: time and memory grow without end)."""
    relinearize_m: float = 0.03
    """A joint is linearised again when it moves by more than this, metres. Raising it is faster and less exact."""
    covariance: bool = True
    """Also give the covariance of the newest joints."""
    smoothed_covariance: bool = False
    """Also give the covariance of the joints that are one lag old. It is that of the whole window: an update takes two
    to three times as long."""
    estimate_time_offsets: bool = False
    """Learn by how much each camera's clock is off from that of the first."""


@dataclass(frozen=True)
class TrackingConfig:
    """Telling several people apart."""

    false_tracks_per_hour: float = 6.0
    """How many people who do not exist may be reported in an hour. Raising it reports newcomers sooner, and more often
    views that agree by chance."""
    coast_s: float = 1.0
    """Somebody whom no camera detects is predicted for this long, then taken to have left, seconds; sooner if cameras
    that should see them show nobody there. Raising it bridges longer occlusions and reports people who have left for
    longer."""
    forget_s: float = 600.0
    """Somebody who is lost may be recognised for this long, seconds."""
    max_processes: int = 4
    """Live, several people are estimated in up to so many processes, no more than there are cores. Each takes about
    150 MB; 1: all in one."""
